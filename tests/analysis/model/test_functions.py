"""Functions, curves and maps in formulas: slopes, graphs, generated code, units, and a model that has all of them."""

import math
from math import exp, log, tanh
from typing import Any

import numpy as np
import pytest
import sympy as sp

from faultline.analysis.codegen import computation_sequence, python_source, residual_program
from faultline.analysis.codegen.helpers import LIBRARY, helpers_in
from faultline.analysis.codegen.text import Writer as TextWriter
from faultline.analysis.graph.bank import build_bank
from faultline.analysis.graph.formula import write_formulas
from faultline.analysis.graph.writer import Writer
from faultline.analysis.model import ModelError, parse_model
from faultline.analysis.model.curves import Curve, trouble
from faultline.analysis.model.expression import parse_expression
from faultline.analysis.model.slope import Sign, slope
from faultline.analysis.model.write import dump_model
from faultline.analysis.simulation import Drive, run, system_of
from faultline.analysis.structure.lint import lint
from faultline.service.core.residuals.generators import Graph

CURVE = Curve(x=(0.0, 1.0, 3.0, 4.0), y=(1.0, 2.0, 1.0, 5.0))
MAP = Curve(
    x=(0.0, 1.0, 3.0), y=(-1.0, 0.0, 2.0, 3.0), z=((0.0, 1.0, 2.0, 1.0), (2.0, 0.0, 1.0, 4.0), (1.0, 1.0, 3.0, 0.0))
)
CURVES = {"k": CURVE, "m": MAP}

VALUES = [
    ("exp(a - b)", lambda a, b: exp(a - b)),
    ("log(a + b**2)", lambda a, b: log(a + b**2)),
    ("tanh(a*b)", lambda a, b: tanh(a * b)),
    ("sign(b)*a", lambda a, b: np.sign(b) * a),
    ("min(a, b)", min),
    ("max(a, 2*b, -1)", lambda a, b: max(a, 2 * b, -1)),
]
POINTS = [(0.3, 0.7), (1.9, -0.4), (2.6, 1.1), (0.8, -1.7)]


def formula(text: str) -> sp.Expr:
    return parse_expression(text, ["a", "b"], "here", CURVES)


def value(expression: sp.Expr, a: float, b: float) -> float:
    return float(expression.replace(Sign, sp.sign).subs({"a": a, "b": b}))


@pytest.mark.parametrize(("text", "meant"), VALUES, ids=[text for text, _ in VALUES])
def test_what_a_function_is(text: str, meant: Any) -> None:
    for a, b in POINTS:
        assert value(formula(text), a, b) == pytest.approx(meant(a, b), rel=1e-12)


@pytest.mark.parametrize("text", [*(text for text, _ in VALUES), "k(a)", "m(a, b)"])
@pytest.mark.parametrize("name", ["a", "b"])
def test_its_slope_is_that_of_its_values(text: str, name: str) -> None:
    expression = formula(text)
    steep = slope(expression, sp.Symbol(name))
    for a, b in POINTS:
        h = 1e-6
        da, db = (h, 0.0) if name == "a" else (0.0, h)
        central = (value(expression, a + da, b + db) - value(expression, a - da, b - db)) / (2 * h)
        assert value(steep, a, b) == pytest.approx(central, abs=1e-6)


@pytest.mark.parametrize("text", [*(text for text, _ in VALUES), "k(a)", "m(a, b)"])
def test_graphs_and_generated_code_have_its_values(text: str) -> None:
    expression = formula(text)
    w = Writer()
    z = w.input("z", ["B", 2])
    written = write_formulas(w, [expression], {"a": w.slice(z, 1, 0, 1), "b": w.slice(z, 1, 1, 2)})[0]
    for name in Graph.OUTPUTS:
        w.output(name, written, ["B", 1])
    found = Graph(w.model("f"))(z=np.array(POINTS))[0]
    wanted = [value(expression, *point) for point in POINTS]
    np.testing.assert_allclose(found[:, 0], wanted, rtol=1e-12)
    text = TextWriter({"a": "a", "b": "b"}, {}, "here")(expression)
    space: dict[str, Any] = {name: getattr(math, name) for name in (*LIBRARY, "inf", "nan")}
    for name, helper in helpers_in([text]).items():
        exec(f"def {name}({', '.join(helper.arguments)}):\n    " + "\n    ".join(helper.python), space)  # noqa: S102
    for (a, b), expected in zip(POINTS, wanted, strict=True):
        assert eval(text, space, {"a": a, "b": b}) == pytest.approx(expected, rel=1e-12)  # noqa: S307


def test_a_curve_goes_through_its_points_but_for_its_round_bends() -> None:
    for x, y in zip(CURVE.x, CURVE.y, strict=True):
        assert value(formula("k(a)"), x, 0.0) == pytest.approx(y, abs=0.25)
    assert value(formula("k(a)"), 2.0, 0.0) == pytest.approx(1.5, abs=0.02)
    assert value(formula("k(a)"), 6.0, 0.0) == pytest.approx(5.0 + 2 * 4.0, abs=0.02)  # it goes on as it ends
    straight = Curve(x=(0.0, 1.0, 2.0), y=(1.0, 3.0, 5.0))
    assert sp.expand(straight(sp.Symbol("a")) - (1 + 2 * sp.Symbol("a"))).subs({"a": 0.7}) == pytest.approx(0.0)


def test_a_map_is_straight_along_each_axis_between_its_points() -> None:
    for k, (a, b) in enumerate([(0.5, -0.5), (2.0, 1.0), (2.0, 2.5)]):
        i, j = [(0, 0), (1, 1), (1, 2)][k]
        corners = [MAP.z[i + di][j + dj] for di in (0, 1) for dj in (0, 1)]
        assert value(formula("m(a, b)"), a, b) == pytest.approx(sum(corners) / 4, abs=0.06)


@pytest.mark.parametrize(
    ("curve", "why"),
    [
        (Curve(x=(0.0,), y=(1.0,)), "x has 1 points; give 2 to 40"),
        (Curve(x=(0.0, 0.0), y=(1.0, 2.0)), "x must rise from point to point"),
        (Curve(x=(0.0, 1.0), y=(1.0, 2.0, 3.0)), "y has 3 values for the 2 points of x"),
        (Curve(x=(0.0, 1.0), y=(1.0, 2.0), z=((1.0, 2.0),)), "z must have 2 rows"),
        (Curve(x=tuple(map(float, range(30))), y=tuple(map(float, range(30))), z=((0.0,) * 30,) * 30), "z has 900"),
    ],
)
def test_points_that_are_no_curve(curve: Curve, why: str) -> None:
    assert trouble(curve).startswith(why)
    assert not trouble(CURVE)
    assert not trouble(MAP)


@pytest.mark.parametrize("text", ["min(a)", "exp(a, b)", "k(a, b)", "m(a)", "sin(a)"])
def test_no_call_of_a_function(text: str) -> None:
    with pytest.raises(ModelError, match=r"is no call of sgsqrt\(x\), .*, min\(x, y\), max\(x, y\), k\(x\), m\(x, y\)"):
        formula(text)


OVEN = """
schema = 1
name = "oven"
warm_up_s = 400.0
period_s = 1.0
[known]
u = {unit = "W", min = 0.0, max = 900.0, noise = 1.0}
y_1 = {unit = "K", min = 250.0, max = 500.0, noise = 0.05}
y_2 = {unit = "K", min = 250.0, max = 500.0, noise = 0.05}
[unknown]
T_1 = {unit = "K", initial = ["y_1", "T_a"]}
T_2 = {unit = "K", initial = ["y_2", "T_a"]}
dT_1 = {unit = "K/s"}
dT_2 = {unit = "K/s"}
q = {unit = "W"}
[parameter]
C_1 = {value = 1000.0, unit = "J/K"}
C_2 = {value = 800.0, unit = "J/K"}
k = {value = 8.0, unit = "W/K"}
k_a = {value = 4.0, unit = "W/K"}
T_0 = {value = 50.0, unit = "K"}
T_a = {value = 290.0, unit = "K"}
q_0 = {value = 100.0, unit = "W"}
[curve.heater]
x = [0.0, 2.0, 5.0, 9.0]
y = [0.0, 2.0, 4.2, 6.0]
source = "datasheet"
[curve.draught]
x = [0.0, 1.0, 4.0]
y = [0.0, 3.0, 9.0]
z = [[1.0, 1.1, 1.2], [1.2, 1.3, 1.5], [1.5, 1.7, 2.0]]
[[equation]]
name = "inner"
expr = "C_1*dT_1 - q_0*heater(u/q_0) + q"
fault = {name = "fh", component = "heater", enters = "q_0 -> q_0 + fh", sizes = [-0.2], relative_to = "q_0"}
[[equation]]
name = "wall"
expr = "q - k*(T_1 - T_2)*(1 + 0.1*tanh((T_1 - T_2)/T_0))"
[[equation]]
name = "outer"
expr = "C_2*dT_2 - q + k_a*(T_2 - T_a)*draught((T_2 - T_a)/T_0, u/q_0)*min(1.5, 1.2 + log(1 + u/q_0)/9)*exp(-u/q_0/90)"
[[equation]]
name = "e_1"
expr = "y_1 - T_1"
[[equation]]
name = "e_2"
expr = "y_2 - T_2"
[[differential]]
name = "d_1"
state = "T_1"
derivative = "dT_1"
[[differential]]
name = "d_2"
state = "T_2"
derivative = "dT_2"
"""


def test_a_model_with_all_of_them_is_written_and_read_again() -> None:
    model = parse_model(OVEN, "oven.toml")
    assert parse_model(dump_model(model), "again") == model
    assert model.curves["heater"].source == "datasheet"
    with pytest.raises(ModelError, match="u is declared twice among known, unknown, parameter and curve"):
        parse_model(OVEN.replace("curve.heater", "curve.u"), "x.toml")
    with pytest.raises(ModelError, match=r"curve\.heater: y has 4 values for the 3 points of x"):
        parse_model(OVEN.replace("x = [0.0, 2.0, 5.0, 9.0]", "x = [0.0, 2.0, 5.0]"), "x.toml")


def test_its_generators_predict_a_free_run_of_it() -> None:
    model = parse_model(OVEN, "oven.toml")
    u = np.repeat([0.0, 300.0, 850.0, 100.0], 300)
    start = np.array([model.parameters["T_a"].value] * 2)
    found = run(system_of(model, []), Drive(1.0, u[:, None], start, np.tile(start, (len(u), 1))), {}).outputs()
    signals = {"u": u, "y_1": found["y_1"], "y_2": found["y_2"]}
    assert signals["y_1"].max() > 340.0
    bank = build_bank(model)
    z = np.column_stack([signals[channel.signal] for channel in bank.inputs])
    r = bank.simulate([{}, {"fh": -20.0}], z, bank.start(z[0]))
    assert np.abs(r[100:, 0]).max() < 0.3  # between 290 and 390 K
    assert np.abs(r[100:, 1]).max() > 3.0
    for row, test in enumerate(bank.tests):
        program = residual_program(model, computation_sequence(model, test.equations, test.residual), name="a")
        space: dict[str, Any] = {}
        exec(python_source(program), space)  # noqa: S102  (that is what is tested)
        generator = space["A"]()
        columns = [[channel.signal for channel in bank.inputs].index(name) for name in generator.INPUTS]
        code = np.array([generator.step(sample) for sample in z[:, columns].tolist()])
        np.testing.assert_allclose(code, r[:, 0, row], atol=0.3)


def test_functions_of_what_has_a_unit_are_named() -> None:
    assert not [each for each in lint(parse_model(OVEN, "oven.toml")) if "unit" in str(each)]
    odd = parse_model(OVEN.replace("tanh((T_1 - T_2)/T_0)", "tanh(T_1 - T_2)"), "oven.toml")
    assert "`T_1 - T_2` in `tanh(T_1 - T_2)` is in K" in str(lint(odd))
