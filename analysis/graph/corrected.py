"""A graph of networks that is fed with corrected samples: row h of a batch sees the samples less the biases of h."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper

from faultline.service.core.residuals.generators import Graph

Array = npt.NDArray[np.float64]


def corrected(raw: bytes, biases: Array, rows: Sequence[int], columns: npt.NDArray[np.intp], states: int) -> bytes:
    """Return the graph of some generators, by their `rows`, with `biases` (H, nz) taken off the samples z (H, nz).

    It has the `columns` of x (H, `states`) that are theirs alone; to the other generators any state is given, as
    nothing of them is looked at.
    """
    model = onnx.load_model_from_string(raw)
    graph = model.graph
    for node in graph.node:
        renamed = {"z": "z_corrected", "x": "x_every"}
        node.input[:] = [renamed.get(name, name) for name in node.input]
        node.output[:] = [f"{name}_every" if name in Graph.OUTPUTS else name for name in node.output]
    place = np.zeros(states, dtype=np.int64)
    place[columns] = np.arange(len(columns))
    constants = {"biases": biases, "place": place, "rows": np.array(rows), "columns": columns}
    before = [
        helper.make_node("Sub", ["z", "biases"], ["z_corrected"]),
        helper.make_node("Gather", ["x", "place"], ["x_every"], axis=1),
    ]
    of = {name: "columns" if name == "x_next" else "rows" for name in Graph.OUTPUTS}
    after = [helper.make_node("Gather", [f"{name}_every", of[name]], [name], axis=1) for name in Graph.OUTPUTS]
    nodes = [*before, *graph.node, *after]
    del graph.node[:]
    graph.node.extend(nodes)
    graph.initializer.extend(numpy_helper.from_array(value, name) for name, value in constants.items())
    widths = {"z": biases.shape[1], "x": len(columns), "x_next": len(columns)}
    for value in (*graph.input, *graph.output):
        value.type.tensor_type.shape.dim[1].dim_value = widths.get(value.name, len(rows))
    onnx.checker.check_model(model, full_check=True)
    found: bytes = model.SerializeToString(deterministic=True)
    return found
