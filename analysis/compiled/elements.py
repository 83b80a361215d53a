"""An ONNX graph as scalar expressions: one for every element of its outputs, with what is zero left out.

The fused graphs multiply padded matrices, as few wide operations are what a runtime is good at. Of a graph's constants
most are zeros and ones. Element by element they fold away:

    0 * a = 0,   1 * a = a,   a + 0 = a,   the same operation of the same operands once

The batch is the last axis inside a graph, the row of a hypothesis. A constant that differs from row to row, as its
name says, is a column of a table.
"""

import operator
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import onnx
from onnx import numpy_helper

from faultline.analysis.graph.writer import BY_ROW
from faultline.service.core.errors import InputError

Tensor = npt.NDArray[Any]
"""Of expressions (indices into `Program.nodes`), or of plain integers where it says a shape."""


class Node(NamedTuple):
    """One scalar: `operator` of the operands (indices of nodes), or what the `value` says of a leaf.

    Leaves: "constant" (a number), "row" (a number for each row), "input" (name and column of an input).
    """

    operator: str
    operands: tuple[int, ...] = ()
    value: Any = None


class Program(NamedTuple):
    """The scalars in an order in which each comes after its operands, and those of each output by name."""

    nodes: list[Node]
    outputs: dict[str, list[int]]


class NotCompiledError(InputError):
    """A graph that has an operation which is not made into native code."""


@lru_cache(maxsize=2)  # a bundle's graphs, of which drives that are left out share one
def program_of(raw: bytes, rows: int) -> Program:
    """The graph of which inputs and outputs are (rows, n), as scalars of a row.

    Raises:
        NotCompiledError: the graph does not compute in float64, or has an operation that is not known here.
    """
    graph = onnx.load_model_from_string(raw).graph
    return _Reading(rows).program(graph)


class _Scalars:
    """The nodes made so far. Folds what constants make needless."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[Node, int] = {}

    def leaf(self, kind: str, value: Any) -> int:
        return self._node(Node(kind, (), value))

    def _node(self, node: Node) -> int:
        if node not in self._known:
            self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return self._known[node]

    def number(self, index: int) -> float | None:
        """The number that a node is in every row; None if it is none."""
        node = self.nodes[index]
        return node.value if node.operator == "constant" else None

    def of(self, name: str, *operands: int) -> int:
        """The node of an operation."""
        simpler = _SIMPLER.get(name, _as_it_is)(self, *operands)
        if simpler is not None:  # nearly always: of constants most are zero
            return simpler
        given = [self.nodes[each] for each in operands]
        if all(each.operator in ("constant", "row") for each in given):
            return self._folded(name, given)
        return self._node(Node(name, operands))

    def _folded(self, name: str, given: Sequence[Node]) -> int:
        with np.errstate(all="ignore"):
            value = _NUMPY[name](*(np.asarray(each.value, dtype=np.float64) for each in given))
        return self.constant(np.atleast_1d(value))

    def constant(self, by_row: npt.NDArray[np.float64]) -> int:
        """The node of a constant: a number, or one for each row."""
        values = [float(each) for each in by_row]
        same = all(each == values[0] for each in values)
        return self.leaf("constant", values[0]) if same else self.leaf("row", tuple(values))


def _as_it_is(_: _Scalars, *__: int) -> None:
    return None


def _sum(scalars: _Scalars, a: int, b: int) -> int | None:
    return b if scalars.number(a) == 0.0 else a if scalars.number(b) == 0.0 else None


def _difference(scalars: _Scalars, a: int, b: int) -> int | None:
    if scalars.number(b) == 0.0:
        return a
    return scalars.of("neg", b) if scalars.number(a) == 0.0 else None


def _product(scalars: _Scalars, a: int, b: int) -> int | None:
    for number, other in ((scalars.number(a), b), (scalars.number(b), a)):
        if number == 0.0:
            return scalars.leaf("constant", 0.0)
        if number == 1.0:
            return other
        if number == -1.0:
            return scalars.of("neg", other)
    return None


def _quotient(scalars: _Scalars, a: int, b: int) -> int | None:
    return a if scalars.number(b) == 1.0 or scalars.number(a) == 0.0 else None


_SIMPLER: Mapping[str, Callable[..., int | None]] = {
    "add": _sum,
    "sub": _difference,
    "mul": _product,
    "div": _quotient,
}
_NUMPY: Mapping[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "max": np.maximum,
    "neg": operator.neg,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "tanh": np.tanh,
}
_BY_ELEMENT = {
    "Abs": "abs",
    "Add": "add",
    "Div": "div",
    "Exp": "exp",
    "Log": "log",
    "Max": "max",
    "Mul": "mul",
    "Sqrt": "sqrt",
    "Sub": "sub",
    "Tanh": "tanh",
}


def _slice(tensor: Tensor, starts: Tensor, ends: Tensor, axes: Tensor, steps: Tensor | None = None) -> Tensor:
    by = [1] * len(starts) if steps is None else steps
    where = [slice(None)] * tensor.ndim
    for start, end, axis, step in zip(starts, ends, axes, by, strict=True):
        where[int(axis)] = slice(int(start), int(end), int(step))
    return tensor[tuple(where)]


_OF_SHAPE: Mapping[str, Callable[..., Tensor]] = {
    "Identity": lambda tensor: tensor,
    "Reshape": lambda tensor, shape: tensor.reshape([int(each) for each in shape]),
    "Slice": _slice,
    "Shape": lambda tensor: np.array(tensor.shape),
    "Expand": lambda tensor, shape: np.broadcast_to(tensor, np.broadcast_shapes(tensor.shape, tuple(shape))),
    "Transpose": np.transpose,
}


class _Reading:
    """Reads a graph node by node. State: the tensors known so far, by name."""

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self._scalars = _Scalars()
        self._tensors: dict[str, Tensor] = {}

    def program(self, graph: onnx.GraphProto) -> Program:
        for constant in graph.initializer:
            self._tensors[constant.name] = self._constant(constant)
        for given in graph.input:
            kind = given.type.tensor_type
            if kind.elem_type != onnx.TensorProto.DOUBLE:
                raise NotCompiledError(f"input {given.name} is not float64")
            columns = kind.shape.dim[1].dim_value
            leaves = [self._scalars.leaf("input", (given.name, k)) for k in range(columns)]
            self._tensors[given.name] = np.array([leaves], dtype=object)
        for node in graph.node:
            self._tensors[node.output[0]] = self._result(node)
        outputs = {each.name: self._tensors[each.name] for each in graph.output}
        if wrong := [name for name, tensor in outputs.items() if tensor.ndim != 2 or len(tensor) != 1]:
            raise NotCompiledError(f"{wrong[0]} is not a row")
        return _needed(Program(self._scalars.nodes, {name: list(tensor[0]) for name, tensor in outputs.items()}))

    def _constant(self, proto: onnx.TensorProto) -> Tensor:
        value = numpy_helper.to_array(proto)
        if value.dtype == np.int64:
            return value
        if value.dtype != np.float64:
            raise NotCompiledError(f"constant {proto.name} is {value.dtype}, not float64")
        by_row = proto.name.startswith(BY_ROW)
        if by_row and value.shape[-1] != self._rows:
            raise NotCompiledError(f"constant {proto.name} is of {value.shape[-1]} rows, not of {self._rows}")
        table = value.reshape(-1, self._rows) if by_row else value.reshape(-1, 1)
        found = np.empty(len(table), dtype=object)
        found[:] = [self._scalars.constant(each) for each in table]
        return found.reshape((*value.shape[:-1], 1) if by_row else value.shape)

    def _result(self, node: onnx.NodeProto) -> Tensor:
        given = [self._tensors[name] for name in node.input]
        kind = node.op_type
        if kind in _BY_ELEMENT:
            return self._each(_BY_ELEMENT[kind], *given)
        if kind in _OF_SHAPE:
            return _OF_SHAPE[kind](*given)
        match kind:
            case "Reciprocal":
                return self._each("div", self._number(1.0), *given)
            case "Relu":
                return self._each("max", *given, self._number(0.0))
            case "MatMul":
                return self._product(*given)
            case "Concat":
                return np.concatenate(given, axis=onnx.helper.get_node_attr_value(node, "axis"))
            case "Gather":
                tensor, places = given
                axis = onnx.helper.get_node_attr_value(node, "axis")
                return np.asarray(np.take(tensor, places.astype(np.int64), axis=axis))
            case "ReduceSum":
                return self._total(*given)
        raise NotCompiledError(f"operator {kind} is not compiled")

    def _total(self, tensor: Tensor, axes: Tensor) -> Tensor:
        """The sum along an axis, which is gone."""
        if len(axes) > 1:
            raise NotCompiledError("a sum along several axes is not compiled")
        terms = np.moveaxis(tensor, int(axes[0]), 0)
        total: Tensor = terms[0]
        for term in terms[1:]:
            total = self._each("add", total, term)
        return total

    def _number(self, value: float) -> Tensor:
        return np.array(self._scalars.leaf("constant", value), dtype=object)

    def _each(self, name: str, *tensors: Tensor) -> Tensor:
        """The operation, element by element, broadcast."""
        found = np.frompyfunc(lambda *operands: self._scalars.of(name, *operands), len(tensors), 1)(*tensors)
        return np.asarray(found, dtype=object)

    def _product(self, a: Tensor, b: Tensor) -> Tensor:
        """The matrix product over the last two axes."""
        if not a.shape[-1]:  # a system without roots has no flows
            shape = *np.broadcast_shapes(a.shape[:-2], b.shape[:-2]), a.shape[-2], b.shape[-1]
            return np.full(shape, self._scalars.leaf("constant", 0.0), dtype=object)
        terms = self._each("mul", a[..., :, :, None], b[..., None, :, :])
        total = terms[..., 0, :]
        for k in range(1, terms.shape[-2]):
            total = self._each("add", total, terms[..., k, :])
        return total


def _needed(program: Program) -> Program:
    """The program without the scalars that no output hangs on."""
    needed = [False] * len(program.nodes)
    for indices in program.outputs.values():
        for index in indices:
            needed[index] = True
    for index in reversed(range(len(needed))):
        for operand in program.nodes[index].operands if needed[index] else ():
            needed[operand] = True
    place = np.cumsum(needed) - 1
    nodes = [
        node._replace(operands=tuple(int(place[each]) for each in node.operands))
        for node, wanted in zip(program.nodes, needed, strict=True)
        if wanted
    ]
    return Program(nodes, {name: [int(place[each]) for each in of] for name, of in program.outputs.items()})
