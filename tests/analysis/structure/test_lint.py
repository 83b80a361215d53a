"""What the linter finds, and that the shipped models give no reason."""

import dataclasses
from collections.abc import Sequence
from fractions import Fraction

import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.analysis.model import Differential, Model, load_model, parse_model
from faultline.analysis.model.file import shipped_models
from faultline.analysis.model.units import parse_unit
from faultline.analysis.structure import over_determined
from faultline.analysis.structure.lint import Finding, lint, lint_structure
from faultline.analysis.structure.matrix import structural_model

MODEL = """
schema = 1
name = "tank"

[known.y]
unit = "Pa"
min = 0.0
max = 1e5
noise = 1.0

[unknown.p]
unit = "Pa"
initial = ["y", "p_0"]

[unknown.dp]
unit = "Pa/s"

[unknown.q]
unit = "m3/s"

[parameter.A]
unit = "m2"
value = 1.0
source = "drawing"

[parameter.rho]
unit = "kg/m3"
value = 1000.0
source = "water"

[parameter.C]
unit = "m3/Pa"
value = 1.0
source = "drawing"

[parameter.p_0]
unit = "Pa"
value = 0.0
source = "empty"

[[equation]]
name = "e1"
expr = "q - A*sgsqrt(2/rho*(p - p_0))"

[equation.fault]
name = "fA"
component = "valve"
enters = "A -> A + fA"
sizes = [-0.5]
relative_to = "A"

[[equation]]
name = "e2"
expr = "C*dp + q"

[[equation]]
name = "e3"
expr = "y - p"

[[differential]]
name = "e4"
state = "p"
derivative = "dp"
"""


def changed(old: str, new: str) -> Model:
    assert MODEL.count(old) == 1
    return parse_model(MODEL.replace(old, new), "tank.toml")


@pytest.mark.parametrize("name", shipped_models())
def test_shipped_models_have_no_errors(name: str) -> None:
    assert [finding for finding in lint(load_model(name)) if finding.severity == "error"] == []


def test_the_four_state_model_has_no_findings() -> None:
    assert lint(load_model("uds")) == []
    assert lint(parse_model(MODEL, "tank.toml")) == []


@pytest.mark.parametrize(
    ("old", "new", "place", "message"),
    [
        ("A*sgsqrt(2/rho*(p - p_0))", "A*(2/rho*(p - p_0))", "equation.e1", "`q` is in m3/s, "),
        ("sgsqrt(2/rho*(p - p_0))", "(2/rho*(p - p_0))**2", "equation.e1", " in m6 s-4"),
        ("(p - p_0)", "(p - 101325)", "equation.e1", "`-101325` is in 1, `p` in Pa"),
        ("C*dp + q", "C*(dp + p) + q", "equation.e2", "`dp` is in Pa/s, `p` in Pa"),
        ("C*dp + q", "abs(C)*dp + A*q", "equation.e2", " in m5 s-1"),
        ("A -> A + fA", "A -> A + fA*(1 - fA/rho - 1)", None, ""),
        ("A -> A + fA", "A -> A*(1 + fA/p)", None, ""),
        ("A -> A + fA", "A -> A + fA*(rho + p)", "equation.e1.fault.enters", "kg/m3"),
        ('["y", "p_0"]', '["y", "rho"]', "unknown.p.initial[1]", "`p` is in Pa, `rho` in kg/m3"),
        ('[unknown.dp]\nunit = "Pa/s"', '[unknown.dp]\nunit = "Pa"', "differential.e4", "`p` is in Pa"),
        ('[known.y]\nunit = "Pa"', '[known.y]\nunit = "m"', "equation.e3", " in m"),
    ],
)
def test_units_that_do_not_fit_are_errors(old: str, new: str, place: str | None, message: str) -> None:
    """A fault variable has the unit that makes its replacement right, if there is one."""
    errors = [finding for finding in lint(changed(old, new)) if finding.severity == "error"]
    if place is None:
        assert errors == []
    else:
        assert place in [finding.place for finding in errors]
        assert any(message in finding.message and "; correct" in finding.message for finding in errors)


def test_a_unit_that_cannot_be_read_is_told_once_and_not_used() -> None:
    assert lint(changed('unit = "m3/Pa"', 'unit = "sccm"')) == [
        Finding(
            "warning",
            "parameter.C.unit",
            "`sccm` is no unit; write it like m3/s, kg/(m s2) or 1; what has C in it is not checked",
        )
    ]


def test_a_unit_that_needs_conversion_is_told() -> None:
    """The dimension fits, the number does not."""
    [finding] = lint(changed('[known.y]\nunit = "Pa"', '[known.y]\nunit = "mbar"'))
    assert (finding.severity, finding.place) == ("error", "known.y.unit")
    assert finding.message == "1 mbar is 100 of the SI unit, and formulas convert nothing; give y in SI units"


@pytest.mark.parametrize(
    ("text", "size", "exponents"),
    [
        ("1", 1, {}),
        ("%", Fraction(1, 100), {}),
        ("1/s", 1, {"s": -1}),
        ("m3/s", 1, {"m": 3, "s": -1}),
        ("Pa s", 1, {"kg": 1, "m": -1, "s": -1}),
        ("kg/(m s2)", 1, {"kg": 1, "m": -1, "s": -2}),
        ("J/kg/K", 1, {"m": 2, "s": -2, "K": -1}),
        ("W/(m^2 K)", 1, {"kg": 1, "s": -3, "K": -1}),
        ("m s-1", 1, {"m": 1, "s": -1}),
        ("kg*m**2", 1, {"kg": 1, "m": 2}),
        ("V/A", 1, {"kg": 1, "m": 2, "s": -3, "A": -2}),
        ("kΩ", 1000, {"kg": 1, "m": 2, "s": -3, "A": -2}),
        ("µF", Fraction(1, 10**6), {"kg": -1, "m": -2, "s": 4, "A": 2}),
        ("mL/min", Fraction(1, 60 * 10**6), {"m": 3, "s": -1}),
        ("mm2", Fraction(1, 10**6), {"m": 2}),
        ("1/min", Fraction(1, 60), {"s": -1}),
    ],
)
def test_units_are_read(text: str, size: Fraction | int, exponents: dict[str, int]) -> None:
    base = ("kg", "m", "s", "A", "K", "mol", "cd")
    found_size, dimension = parse_unit(text)
    assert found_size == size
    assert dimension == tuple(Fraction(exponents.get(unit, 0)) for unit in base)


@pytest.mark.parametrize(
    "text", ["", "-", "degC", "foo", "m+s", "sgsqrt(m)", "m/", "(m", "m)", "0", "m_3", "as", "1/0"]
)
def test_what_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is no unit; write it like"):
        parse_unit(text)


@pytest.mark.parametrize("text", ["kg/m s2", "J/kg*K", "1/(J/kg K)", "m/s kg/(m s)"])
def test_a_product_below_a_fraction_bar_needs_parentheses(text: str) -> None:
    with pytest.raises(ValueError, match="read in two ways"):
        parse_unit(text)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.text(alphabet="kgmsPaN123/*^(-) %µ", max_size=12))
def test_any_text_is_a_unit_or_refused(text: str) -> None:
    try:
        size, dimension = parse_unit(text)
    except ValueError:
        return
    assert size > 0
    assert len(dimension) == 7


def test_parts_that_nothing_uses_are_told() -> None:
    extra = '[parameter.spare]\nunit = "1"\nvalue = 1.0\n[known.w]\nunit = "1"\nmin = 0.0\nmax = 1.0\nnoise = 0.1\n'
    assert [(finding.severity, finding.place) for finding in lint(parse_model(MODEL + extra, "tank.toml"))] == [
        ("warning", "parameter.spare"),
        ("warning", "parameter.spare.source"),
        ("warning", "known.w"),
    ]


def test_a_signal_that_gives_the_operating_mode_is_used() -> None:
    extra = '[known.w]\nunit = "1"\nmin = 0.0\nmax = 1.0\nnoise = 0.1\n'
    extra += '[[mode]]\nname = "low"\nwhere = {w = {below = 0.5}}\n[[mode]]\nname = "else"\n'
    assert lint(parse_model(MODEL + extra, "tank.toml")) == []


def test_errors_come_first() -> None:
    findings = lint(changed('unit = "m3/Pa"\nvalue = 1.0\nsource = "drawing"', 'unit = "m"\nvalue = 1.0\nsource = ""'))
    assert [finding.severity for finding in findings] == ["error", "warning"]


def test_a_model_made_in_python_is_checked_like_a_file() -> None:
    model = parse_model(MODEL, "tank.toml")
    twice = {**model.equations, "e3": dataclasses.replace(model.equations["e3"], fault=model.equations["e1"].fault)}
    [finding] = lint(dataclasses.replace(model, equations=twice))
    assert finding.severity == "error"
    assert finding.message.startswith("fault fA is in two equations; let it define an unknown of its own")
    [finding] = lint(dataclasses.replace(model, differentials=()))
    assert finding.message.startswith("unknown.dp: no [[differential]] makes it the derivative of p")
    parameters = {name: parameter for name, parameter in model.parameters.items() if name != "rho"}
    [finding] = lint(dataclasses.replace(model, parameters=parameters))
    assert (finding.severity, finding.place) == ("error", "equation.e1")
    assert finding.message.startswith("rho declared neither as known, unknown nor parameter")


X = Differential(name="d", state="x", derivative="dx")


def places(
    equations: dict[str, list[str]],
    *constraints: Differential,
    faults: Sequence[str] = (),
    unknowns: Sequence[str] | None = None,
) -> dict[str, str]:
    """The findings of a structure, message by place."""
    structure = structural_model(equations, constraints, faults, unknowns=unknowns)
    return {finding.place: finding.message for finding in lint_structure(structure)}


def test_constraints_without_effect_are_told() -> None:
    redundant = {"y1": ["v"], "y2": ["v"]}
    assert places({**redundant, "e": ["x"]}, X)["differential.d"].startswith("dx is in no other equation, so nothing")
    assert places({**redundant, "e": ["dx"]}, X)["differential.d"].startswith("x is in no other equation, so its value")
    assert "differential.d" not in places({**redundant, "e": ["dx", "x"]}, X)
    assert places({"y1": ["x"], "y2": ["x"], "e": ["dx", "x"]})["unknown.dx"].startswith("no differential constraint")


def test_unused_unknowns_and_under_determined_ones_are_told_apart() -> None:
    found = places({"e": ["a", "b", "c"], "y1": ["v"], "y2": ["v"]}, unknowns=["a", "b", "c", "v", "unused"])
    assert found.pop("fault").startswith("there is none, so no test is sensitive to a fault")
    assert found == {
        "unknown.unused": "is in no equation; use it or remove it",
        "unknown": "a, b and c cannot be computed: the equations that have them are 2 too few; "
        "add equations, or sensors of them",
    }


def test_no_redundancy_is_told_with_the_sensors_that_would_give_some() -> None:
    assert places({"e1": ["a", "b"], "e2": ["b"], "e3": ["c", "d"]})["equation"] == (
        "no redundancy, so no test and no detectable fault; a sensor of a or b would give some"
    )
    assert places({"e3": ["c", "d"]})["equation"].endswith("; add equations or several sensors")


def test_a_fault_without_test_is_told_with_the_sensors_that_would_give_one() -> None:
    equations = {"y1": ["v"], "y2": ["v"], "e1": ["a", "b", "f1"], "e2": ["b"], "e3": ["c", "g", "f3"]}
    found = places(equations, faults=["f1", "f3"])
    assert found["fault.f1"] == "is not detectable: no test contains e1; a sensor of a would give one"
    assert found["fault.f3"] == "is not detectable: no test contains e3; no single sensor would give one"


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.lists(st.lists(st.sampled_from("abcd"), unique=True, max_size=3), min_size=1, max_size=5))
def test_every_sensor_named_gives_redundancy_and_no_other_does(rows: list[list[str]]) -> None:
    equations = {f"e{k}": row for k, row in enumerate(rows)}
    structure = structural_model(equations, unknowns=list("abcd"))
    message = {f.place: f.message for f in lint_structure(structure)}.get("equation")
    assert (message is None) == bool(over_determined(structure))
    if message is not None:
        gain = [x for x in "abcd" if over_determined(structural_model({**equations, "y": [x]}, unknowns=list("abcd")))]
        *most, last = gain or ["", ""]
        words = f"a sensor of {f'{chr(44)} '.join(most)} or {last} would" if most else f"a sensor of {last} would"
        assert (words in message) if gain else "several sensors" in message


def test_a_parameter_that_only_scales_a_fault_is_used() -> None:
    extra = '[parameter.typical]\nunit = "m2"\nvalue = 1.0\nsource = "drawing"\n'
    text = MODEL.replace('relative_to = "A"', 'relative_to = "typical"') + extra
    assert lint(parse_model(text, "tank.toml")) == []


def test_a_fault_that_changes_a_parameter_in_one_of_two_equations_is_told() -> None:
    model = load_model("three-tank")
    e06 = dataclasses.replace(model.equations["e06"], expression=model.equations["e06"].expression + sp.Symbol("A_12"))
    twice = dataclasses.replace(model, equations={**model.equations, "e06": e06})
    told = [finding.message for finding in lint(twice) if finding.place == "fault.fA_12"]
    assert told[0].startswith("changes A_12 in e02 only, and e06 has it too; give what the fault changes an equation")
