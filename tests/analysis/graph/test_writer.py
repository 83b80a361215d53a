"""The writer writes only what the vehicle accepts, and the same graph as the same bytes."""

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from faultline.analysis.graph.writer import Writer
from faultline.service.core.residuals.generators import Graph
from faultline.service.core.residuals.graph_file import IR_VERSIONS, OPERATORS, OPSETS


def affine(*, gain: float = 2.0, repeated: int = 1) -> bytes:
    """r = gain z + 1, and the same under every other name; the constant 1 is asked for `repeated` times."""
    w = Writer()
    z = w.input("z", ["B", 3])
    value = w("Mul", z, w.constant(gain))
    for _ in range(repeated):
        one = w.constant(1.0)
    value = w("Add", value, one)
    for name in Graph.OUTPUTS:
        w.output(name, value, ["B", 3])
    return w.model("affine")


def parsed(raw: bytes) -> onnx.ModelProto:
    return onnx.load_model_from_string(raw)


@pytest.mark.parametrize("operator", ["Loop", "Scan", "If", "Sinh", "Softmax", "sqrt", "com.microsoft.FusedMatMul", ""])
def test_operators_outside_the_allow_list_are_refused(operator: str) -> None:
    w = Writer()
    z = w.input("z", ["B", 3])
    with pytest.raises(AssertionError):
        w(operator, z)


def test_the_allow_list_has_no_control_flow_and_no_function() -> None:
    assert not OPERATORS & {"Loop", "Scan", "If", "SequenceMap", "Optional"}
    standard = {schema.name for schema in onnx.defs.get_all_schemas() if schema.domain == ""}
    assert standard >= OPERATORS


def test_the_same_graph_has_the_same_bytes_and_another_has_others() -> None:
    assert affine() == affine()
    assert affine(gain=3.0) != affine()


def test_a_constant_is_stored_once_however_often_it_is_used() -> None:
    assert affine(repeated=5) == affine()
    stored = [numpy_helper.to_array(constant).item() for constant in parsed(affine(repeated=5)).graph.initializer]
    assert stored == [2.0, 1.0]


def test_constants_of_other_shape_type_or_sign_of_zero_are_not_confused() -> None:
    """Keys by bytes alone would take the integer [0], [0.0] and [[0.0]] for one; -0.0 divides to another sign."""
    w = Writer()
    names = [
        w.constant([0.0]),
        w.constant([[0.0]]),
        w.constant([0], np.int64),
        w.constant([-0.0]),
        w.constant([0.0, 0.0]),
    ]
    assert len(set(names)) == len(names)
    assert w.constant([[0.0]]) == names[1]


def test_the_model_declares_version_types_and_only_allowed_nodes() -> None:
    model = parsed(affine())
    assert model.ir_version == IR_VERSIONS[0]
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [("", OPSETS[0])]
    assert model.producer_name == "faultline"
    assert {node.op_type for node in model.graph.node} <= OPERATORS
    assert not model.functions
    values = [*model.graph.input, *model.graph.output]
    assert {value.type.tensor_type.elem_type for value in values} == {onnx.TensorProto.DOUBLE}
    assert [value.name for value in model.graph.output] == list(Graph.OUTPUTS)


def test_slice_reshape_and_concat_do_what_numpy_does() -> None:
    w = Writer()
    z = w.input("z", ["B", 6])
    cube = w.reshape(z, [-1, 2, 3])
    joined = w.concat([w.slice(cube, 2, 1, 3), w.slice(cube, 2, 0, 1)], axis=2)
    for name in Graph.OUTPUTS:
        w.output(name, joined, ["B", 2, 3])
    samples = np.arange(12.0).reshape(2, 6)
    expected = np.roll(samples.reshape(2, 2, 3), -1, axis=2)
    for output in Graph(w.model("cube"))(z=samples):
        assert output.tolist() == expected.tolist()


def test_a_graph_that_cannot_run_is_not_given_out() -> None:
    """Shapes that do not fit are found when the graph is made, not on the vehicle."""
    w = Writer()
    z = w.input("z", ["B", 3])
    bad = w("MatMul", z, w.constant(np.eye(4)))
    for name in Graph.OUTPUTS:
        w.output(name, bad, ["B", 4])
    with pytest.raises(onnx.shape_inference.InferenceError, match="Incompatible dimensions"):
        w.model("bad")
