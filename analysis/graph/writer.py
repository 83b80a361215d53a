"""Writes ONNX graphs: a node a call, operators from an allow-list, a trial session at the end.

The allow-list is what the vehicle accepts: no Loop, Scan, If, functions, external data or custom operators.
"""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

from faultline.service.core.residuals.generators import Graph
from faultline.service.core.residuals.graph_file import IR_VERSIONS, OPERATORS, OPSETS

Array = npt.NDArray[np.float64]

BY_ROW = "row"
"""Names of constants that differ between the rows of a batch begin with this."""


class Writer:
    """A graph under construction. A value is the name of a tensor; every method returns the name of its result."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: dict[tuple[bytes, tuple[int, ...], str, bool], str] = {}
        self._initializers: list[onnx.TensorProto] = []
        self._inputs: list[onnx.ValueInfoProto] = []
        self._outputs: list[onnx.ValueInfoProto] = []

    def input(self, name: str, shape: Sequence[str | int]) -> str:
        """A float64 input of the graph."""
        self._inputs.append(helper.make_tensor_value_info(name, TensorProto.DOUBLE, list(shape)))
        return name

    def output(self, name: str, value: str, shape: Sequence[str | int]) -> None:
        """Gives a value out under a name of its own."""
        self._nodes.append(helper.make_node("Identity", [value], [name]))
        self._outputs.append(helper.make_tensor_value_info(name, TensorProto.DOUBLE, list(shape)))

    def constant(self, value: npt.ArrayLike, dtype: type[np.generic] = np.float64, *, by_row: bool = False) -> str:
        """A constant; the same one is stored once. One `by_row` has a number for every row of a batch, last."""
        array = np.ascontiguousarray(value, dtype=dtype)
        key = (array.tobytes(), array.shape, array.dtype.str, by_row)
        if key not in self._constants:
            name = f"{BY_ROW if by_row else 'c'}{len(self._constants)}"
            self._constants[key] = name
            self._initializers.append(numpy_helper.from_array(array, name))
        return self._constants[key]

    def __call__(self, operator: str, *values: str, **attributes: int) -> str:
        """A node."""
        assert operator in OPERATORS, operator
        name = f"v{len(self._nodes)}"
        self._nodes.append(helper.make_node(operator, list(values), [name], **cast(dict[str, Any], attributes)))
        return name

    def slice(self, value: str, axis: int, start: int, stop: int) -> str:
        """value[..., start:stop, ...] along an axis."""
        bounds = (self.constant([number], np.int64) for number in (start, stop, axis))
        return self("Slice", value, *bounds)

    def reshape(self, value: str, shape: Sequence[int]) -> str:
        """Another shape for the same numbers; -1 is the batch."""
        return self("Reshape", value, self.constant(shape, np.int64))

    def concat(self, values: Sequence[str], axis: int) -> str:
        """Tensors joined along an axis."""
        return self("Concat", *values, axis=axis)

    def gather(self, value: str, places: npt.ArrayLike, axis: int) -> str:
        """These places along an axis."""
        return self("Gather", value, self.constant(places, np.int64), axis=axis)

    def cast(self, value: str, dtype: type[np.generic]) -> str:
        """The same numbers in another precision."""
        return self("Cast", value, to=int(helper.np_dtype_to_tensor_dtype(np.dtype(dtype))))

    def total(self, value: str, *axes: int) -> str:
        """The sum along axes, which are gone."""
        return self("ReduceSum", value, self.constant(axes, np.int64), keepdims=0)

    def model(self, name: str) -> bytes:
        """The finished model's bytes, checked by onnx and opened by onnxruntime; the same graph, the same bytes."""
        graph = helper.make_graph(self._nodes, name, self._inputs, self._outputs, self._initializers)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSETS[0])], producer_name="faultline")
        model.ir_version = IR_VERSIONS[0]
        onnx.checker.check_model(model, full_check=True)
        raw: bytes = model.SerializeToString(deterministic=True)
        Graph(raw)
        return raw


def with_metadata(raw: bytes, entries: Mapping[str, str]) -> bytes:
    """Return the model with these ONNX metadata (`metadata_props`); the same entries, the same bytes."""
    model = onnx.load_model_from_string(raw)
    helper.set_model_props(model, dict(entries))
    described: bytes = model.SerializeToString(deterministic=True)
    return described
