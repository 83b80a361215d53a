"""Graphs as scalars: every operator as ONNX Runtime computes it, and what is needless left out."""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper, numpy_helper

from faultline.analysis.compiled.elements import NotCompiledError, program_of
from faultline.analysis.compiled.kernels import WORTH_IT, kernels_of
from faultline.service.core.residuals.graph_file import OPERATORS

ROWS, COLUMNS = 7, 4
Constants = dict[str, npt.NDArray[np.float64] | npt.NDArray[np.int64]]
OUTPUTS = ("r", "y_hat", "sigma", "x_next")
RNG = np.random.default_rng(1)


def graph(nodes: Sequence[onnx.NodeProto], constants: Constants, kind: int = TensorProto.DOUBLE) -> bytes:
    """A graph of z and x (B, COLUMNS) with four outputs (B, COLUMNS), of which the nodes compute `r`."""
    given = [helper.make_tensor_value_info(name, kind, ["B", COLUMNS]) for name in ("z", "x")]
    made = [helper.make_tensor_value_info(name, kind, ["B", COLUMNS]) for name in OUTPUTS]
    others = [helper.make_node("Identity", ["x"], [name]) for name in OUTPUTS[1:]]
    tensors = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    model = helper.make_model(helper.make_graph([*nodes, *others], "g", given, made, tensors))
    model.opset_import[0].version, model.ir_version = 21, 10
    return bytes(model.SerializeToString())


def node(kind: str, *names: str, axis: int | None = None) -> onnx.NodeProto:
    made = helper.make_node(kind, list(names[:-1]), [names[-1]])
    if axis is not None:
        made.attribute.append(helper.make_attribute("axis", axis))
    return made


ELEMENTWISE = [
    node("Abs", "z", "a"),
    node("Sqrt", "a", "b"),
    node("Log", "a", "c"),
    node("Tanh", "z", "d"),
    node("Relu", "z", "e"),
    node("Exp", "d", "f"),
    node("Reciprocal", "f", "g"),
    node("Add", "b", "c", "h"),
    node("Sub", "h", "d", "i"),
    node("Mul", "i", "e", "j"),
    node("Div", "j", "f", "k"),
    node("Max", "k", "x", "l"),
    node("Add", "l", "g", "r"),
]
SHAPES: Constants = {
    "twice": np.array([2, COLUMNS, -1]),
    **{name: np.array([value]) for name, value in (("zero", 0), ("one", 1), ("end", 9))},
    "shared": np.where(RNG.random((COLUMNS, COLUMNS)) < 0.5, 0.0, RNG.normal(size=(COLUMNS, COLUMNS))),
    "places": np.array([3, 0, 3]),
    "row_of_three": RNG.normal(size=(3, ROWS)),
    "into": np.eye(COLUMNS)[:, [1, 1, 2]],
    "offset": RNG.normal(size=(1, COLUMNS)),
}
MATRICES = [
    node("Transpose", "z", "a"),
    node("MatMul", "shared", "a", "b"),
    node("Gather", "a", "places", "c", axis=0),
    node("Mul", "c", "row_of_three", "d"),
    node("MatMul", "into", "d", "e"),
    node("Add", "b", "e", "f"),
    node("Slice", "f", "one", "end", "zero", "g"),
    node("Slice", "f", "zero", "one", "zero", "h"),
    node("Concat", "g", "h", "f", "i", axis=0),
    node("Reshape", "i", "twice", "j"),
    helper.make_node("ReduceSum", ["j", "zero"], ["k"], keepdims=0),
    node("Transpose", "k", "l"),
    node("Shape", "l", "m"),
    node("Expand", "offset", "m", "n"),
    node("Add", "l", "n", "o"),
    node("Sub", "o", "x", "r"),
]


def of_runtime(raw: bytes, z: npt.NDArray[np.float64], x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    session = ort.InferenceSession(raw, providers=["CPUExecutionProvider"])
    return np.asarray(session.run(["r"], {"z": z, "x": x})[0])


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def test_element_by_element() -> None:
    raw = graph(ELEMENTWISE, {})
    z, x = RNG.normal(size=COLUMNS), RNG.normal(size=COLUMNS)
    out = [np.zeros(COLUMNS) for _ in OUTPUTS]
    kernels = kernels_of(raw, None, 0)
    kernels.tests(z, x, kernels.of_tests, *out)
    np.testing.assert_allclose(out[0], of_runtime(raw, z[None], x[None])[0], rtol=1e-14)
    np.testing.assert_array_equal(out[3], x)


def test_rows_with_constants_of_their_own() -> None:
    raw = graph(MATRICES, SHAPES)
    z, x = RNG.normal(size=COLUMNS), RNG.normal(size=(COLUMNS, ROWS))
    r, x_next = np.zeros((COLUMNS, ROWS)), np.zeros((COLUMNS, ROWS))
    kernels = kernels_of(graph(ELEMENTWISE, {}), raw, ROWS)
    kernels.hypotheses(z, x, kernels.of_hypotheses, kernels.table, r, x_next)
    expected = of_runtime(raw, np.tile(z, (ROWS, 1)), np.ascontiguousarray(x.T))
    np.testing.assert_allclose(r.T, expected, rtol=1e-13, atol=1e-15)


def test_zeros_and_ones_of_a_matrix_cost_nothing() -> None:
    chosen = np.zeros((COLUMNS, COLUMNS))
    chosen[0, 1] = chosen[2, 3] = 1.0
    program = program_of(graph([node("MatMul", "z", "chosen", "r")], {"chosen": chosen}), 1)
    assert {each.operator for each in program.nodes} == {"constant", "input"}
    assert [program.nodes[index].value for index in program.outputs["r"]] == [0.0, ("z", 0), 0.0, ("z", 2)]


def test_a_sum_of_nothing_is_zero() -> None:
    nothing: Constants = {"left": np.zeros((1, 0)), "right": np.zeros((0, COLUMNS))}
    program = program_of(graph([node("MatMul", "left", "right", "a"), node("Add", "z", "a", "r")], nothing), 1)
    assert [program.nodes[index].value for index in program.outputs["r"]] == [("z", k) for k in range(COLUMNS)]


def test_the_same_operation_is_there_once() -> None:
    twice = [node("Mul", "z", "x", "a"), node("Mul", "z", "x", "b"), node("Add", "a", "b", "r")]
    program = program_of(graph(twice, {}), 1)
    assert sum(each.operator == "mul" for each in program.nodes) == COLUMNS


def test_what_is_compiled_is_what_bundles_may_have_but_for_networks() -> None:
    assert OPERATORS - {each.op_type for each in (*ELEMENTWISE, *MATRICES)} == {
        *("Cast", "Identity", "ReduceMean", "ReduceMin"),
    }


def test_networks_are_refused() -> None:
    with pytest.raises(NotCompiledError, match="input z is not float64"):
        program_of(graph([node("Relu", "z", "r")], {}, TensorProto.FLOAT), 1)
    with pytest.raises(NotCompiledError, match="operator ReduceMean is not compiled"):
        program_of(graph([node("ReduceMean", "z", "r")], {}), 1)


def test_constants_of_other_rows_are_refused() -> None:
    with pytest.raises(NotCompiledError, match=f"constant row_of_three is of {ROWS} rows, not of {ROWS - 1}"):
        program_of(graph(MATRICES, SHAPES), ROWS - 1)


def test_a_graph_of_an_earlier_form_is_refused() -> None:
    """Its constants by row have the rows first, and no name of their own."""
    with pytest.raises(NotCompiledError, match="r is not a row"):
        program_of(graph([node("Mul", "z", "c0", "r")], {"c0": RNG.normal(size=(ROWS, COLUMNS))}), ROWS)


def test_vehicles_of_other_parameters_share_what_is_compiled() -> None:
    def scaled(by: float) -> bytes:
        return graph([node("Mul", "z", "by", "r")], {"by": np.full((1, COLUMNS), by)})

    one, other = kernels_of(scaled(0.3), None, 0), kernels_of(scaled(0.7), None, 0)
    assert one.tests.__module__ == other.tests.__module__
    assert (one.of_tests.tolist(), other.of_tests.tolist()) == ([0.3], [0.7])


def test_a_second_process_only_loads(tmp_path: Path) -> None:
    raw = graph(ELEMENTWISE, {})
    first = kernels_of(raw, None, 0)
    files = [path for path in (tmp_path / "faultline" / "compiled").iterdir() if path.is_file()]
    assert [path.suffix for path in files] == [".py", ".py"]  # the tests, and no hypotheses
    del sys.modules[first.tests.__module__]
    again = kernels_of(raw, None, 0)
    assert again.tests.stats.cache_hits  # type: ignore[attr-defined]


def test_few_ticks_are_counted_until_compiling_is_worth_it() -> None:
    raw, some = graph(ELEMENTWISE, {}), WORTH_IT // 3 + 1
    with pytest.raises(NotCompiledError, match="few ticks"):
        kernels_of(raw, None, 0, ticks=some)
    with pytest.raises(NotCompiledError, match="few ticks"):
        kernels_of(raw, None, 0, ticks=0)
    with pytest.raises(NotCompiledError, match="few ticks"):
        kernels_of(raw, None, 0, ticks=some)
    kernels_of(raw, None, 0, ticks=some)
    kernels_of(raw, None, 0, ticks=0)


def test_a_damaged_count_begins_anew(tmp_path: Path) -> None:
    raw = graph(ELEMENTWISE, {})
    for _ in range(2):
        with pytest.raises(NotCompiledError, match="few ticks"):
            kernels_of(raw, None, 0, ticks=WORTH_IT - 1)
        [count] = (tmp_path / "faultline" / "compiled").glob("*.ticks")
        count.write_text("half a nu")


def test_ticks_that_are_still_to_come_count() -> None:
    raw = graph(ELEMENTWISE, {})
    with pytest.raises(NotCompiledError, match="few ticks"):
        kernels_of(raw, None, 0, ticks=1, more=WORTH_IT - 2)
    kernels_of(raw, None, 0, ticks=1, more=WORTH_IT - 2)
