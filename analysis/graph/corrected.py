"""A graph of networks that is fed with corrected samples: row h of a batch sees the samples less the biases of h."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper

from faultline.service.core.residuals.generators import Graph

Array = npt.NDArray[np.float64]

SWAPPED = (2, 1, 0, 3)
"""Axes of a batch's rows and of one."""


def corrected(raw: bytes, biases: Array, rows: Sequence[int], columns: npt.NDArray[np.intp], states: int) -> bytes:
    """Return the graph of some generators, by their `rows`, with `biases` (H, nz) taken off the samples z (H, nz).

    It has the `columns` of x (H, `states`) that are theirs alone; to the other generators any state is given, as
    nothing of them is looked at.
    """
    model = onnx.load_model_from_string(raw)
    graph = model.graph
    if len(biases) > 1:
        _side_by_side(graph)
    of = f"of_{len(graph.node)}"  # a graph that was cut once may be cut again
    for node in graph.node:
        renamed = {"z": f"z_{of}", "x": f"x_{of}"}
        node.input[:] = [renamed.get(name, name) for name in node.input]
        node.output[:] = [f"{name}_{of}" if name in Graph.OUTPUTS else name for name in node.output]
    place = np.zeros(states, dtype=np.int64)
    place[columns] = np.arange(len(columns))
    constants = {"biases": biases, "place": place, "rows": np.array(rows), "columns": columns}
    before = [
        helper.make_node("Sub", ["z", f"biases_{of}"], [f"z_{of}"]),
        helper.make_node("Gather", ["x", f"place_{of}"], [f"x_{of}"], axis=1),
    ]
    after = [
        helper.make_node(
            "Gather", [f"{name}_{of}", f"columns_{of}" if name == "x_next" else f"rows_{of}"], [name], axis=1
        )
        for name in Graph.OUTPUTS
    ]
    nodes = [*before, *graph.node, *after]
    del graph.node[:]
    graph.node.extend(nodes)
    graph.initializer.extend(numpy_helper.from_array(value, f"{name}_{of}") for name, value in constants.items())
    widths = {"z": biases.shape[1], "x": len(columns), "x_next": len(columns)}
    for value in (*graph.input, *graph.output):
        value.type.tensor_type.shape.dim[1].dim_value = widths.get(value.name, len(rows))
    onnx.checker.check_model(model, full_check=True)
    found: bytes = model.SerializeToString(deterministic=True)
    return found


def _side_by_side(graph: onnx.GraphProto) -> None:
    """Let each function take all rows of a batch at once: (B, N, 1, D) by (N, D, H) are B N products, (1, N, B, D) N.

    With one row the former is faster, as nothing has to be moved.
    """
    matrices = {each.name for each in graph.initializer if len(each.dims) == 3}
    nodes = []
    for node in graph.node:
        if node.op_type == "MatMul" and node.input[1] in matrices:
            given, found = f"{node.input[0]}_by_function_{node.output[0]}", f"{node.output[0]}_by_function"
            nodes.append(helper.make_node("Transpose", [node.input[0]], [given], perm=SWAPPED))
            nodes.append(helper.make_node("MatMul", [given, node.input[1]], [found]))
            nodes.append(helper.make_node("Transpose", [found], [node.output[0]], perm=SWAPPED))
        else:
            nodes.append(node)
    del graph.node[:]
    graph.node.extend(nodes)
