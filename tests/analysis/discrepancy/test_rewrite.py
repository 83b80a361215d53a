"""A rewritten model is the old one at the null values, runs, differs elsewhere, and is a model file like any other."""

import dataclasses
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import sympy as sp

from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.effects.rewrite import applicable, rewritten, substituted
from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import Model, ModelError, dump_model, load_model, parse_model
from faultline.analysis.model.file import SYSTEMS
from faultline.analysis.simulation import Drive, System, run, system_of
from faultline.analysis.structure.command import main as structure
from faultline.analysis.structure.lint import lint

Array = npt.NDArray[np.float64]

CREEPING_HOSE = Path(__file__).resolve().parents[3] / "docs" / "examples" / "creeping_hose.toml"
LIBRARY = load_library(SYSTEMS / "uds", CREEPING_HOSE)

STEP_S = 0.2
START = {"p_tp": 98e3, "p_bp": 95e3, "p_ap": 950e3, "p_du": 940e3, "z": 950e3}


@cache
def nominal(name: str) -> Model:
    return load_model(name)


def inputs(model: str) -> dict[str, Array]:
    """Idle, middle, maximum and small dose at pressures up to 13 bar, then the pump stops: 24 s."""
    t = STEP_S * np.arange(120)
    dose = np.select([t < 5, t < 9, t < 13, t < 16], [0.0, 0.4, 1.0, 0.03], 0.0)
    speed = (23.5 + 14.0 * dose) * (0.95 + 0.15 * np.sin(t / 3.0))
    slow = 0.0 if model == "uds" else 3.0  # the other divides by the speed
    return {"n_p": np.where(t < 18, speed, slow), "dc_dose": dose}


def outputs(system: System, values: Mapping[str, float]) -> Array:
    """The outputs (instants, outputs) of a run, but for the first instant, which is as given."""
    start = np.array([next((p for end, p in START.items() if name.endswith(end)), 0.0) for name in system.states])
    signals = inputs(system.model.name)
    u = np.column_stack([signals[name] for name in system.inputs])
    found = run(system, Drive(STEP_S, u, start, np.tile(start, (len(u), 1))), values).outputs()
    return np.column_stack([found[name] for name in sorted(found)])[1:]


@cache
def nominal_outputs(name: str) -> Array:
    return outputs(system_of(nominal(name), []), {})


@cache
def with_effect(model: str, name: str) -> Model:
    return rewritten(nominal(model), LIBRARY[name])


def pairs() -> list[tuple[str, str]]:
    return [
        (m, name) for m in ("uds", "uds/production") for name, e in LIBRARY.items() if applicable(nominal(m), e) is None
    ]


def refusals(model: str) -> dict[str, str]:
    found = {name: applicable(load_model(model), effect) for name, effect in LIBRARY.items()}
    return {name: reason for name, reason in found.items() if reason is not None}


def with_entry(tmp_path: Path, **changed: str) -> Effect:
    """An effect `mine`, A_dos -> A_dos*(1 + g), with lines changed."""
    lines = {
        "where": 'where = ["q_dos", "A_dos"]',
        "replace": 'replace = "A_dos -> A_dos*(1 + g)"',
        "unit": 'unit = "1"',
        "null": "null = 0.0",
        "more": "",
    } | changed
    path = tmp_path / "own.toml"
    path.write_text(
        'schema = 1\n[[effect]]\nname = "mine"\nstatement = "s"\ncomponent = "c"\nsource = "s"\nsignature = "s"\n'
        f'[effect.parameter.g]\n{lines["unit"]}\ndescription = "d"\n{lines["null"]}\nspread = 0.1\n'
        f"[[effect.change]]\n{lines['where']}\n{lines['replace']}\n{lines['more']}"
    )
    return load_library(SYSTEMS / "uds", path)["mine"]


@pytest.mark.parametrize(("model", "name"), pairs())
def test_an_effect_is_nothing_at_its_null_and_something_at_its_size(model: str, name: str) -> None:
    """Also: its units fit (`rewritten` refuses what does not), and its text is the formula that is computed with."""
    effect = LIBRARY[name]
    new = with_effect(model, name)
    assert parse_model(dump_model(new), "written.toml") == new
    strengths = effect.strengths
    assert {new.parameters[p].value for p in strengths} == {0.0}
    system = system_of(new, [*strengths])
    at_null = outputs(system, dict.fromkeys(strengths, 0.0))
    assert np.abs(at_null / nominal_outputs(model) - 1.0).max() < 1e-6
    typical = outputs(system, {p: strength.spread or 0.0 for p, strength in strengths.items()})
    assert np.isfinite(typical).all()
    assert np.abs(typical / nominal_outputs(model) - 1.0).max() > 1e-6


@pytest.mark.parametrize(("model", "name"), pairs())
def test_the_changed_equations_are_the_nominal_ones_at_the_null(model: str, name: str) -> None:
    """By sympy alone, for all values: what `rewritten` would accept from a probe is not needed for what ships."""
    effect, old = LIBRARY[name], nominal(model)
    new = with_effect(model, name)
    nulls = {sp.Symbol(p): sp.Integer(0) for p in effect.strengths}
    for equation, e in old.equations.items():
        if name.startswith("lag_") and new.equations[equation].expression != e.expression:
            continue  # at null a new equation gives the new unknown, which the test below is about
        assert sp.expand(new.equations[equation].expression.xreplace(nulls) - e.expression) == 0
        assert (e.fault is None) == (new.equations[equation].fault is None)


def test_what_a_model_lacks_is_said_in_a_line() -> None:
    assert refusals("uds") == {}
    assert refusals("uds/production") == {"air_before_pump": "uds_production has no dp_tp"}
    assert set(refusals("rc")) == set(refusals("three-tank")) == set(LIBRARY)
    assert refusals("rc")["stiff_hose"] == "rc has neither B_ap with p_ap with dp_ap nor B_du with p_du with dp_du"
    with pytest.raises(
        ModelError, match=r"effects.toml: effect air_before_pump: uds_production has no dp_tp; leave it away"
    ):
        rewritten(load_model("uds/production"), LIBRARY["air_before_pump"])


def test_a_lag_moves_the_sensors_fault_to_what_the_sensor_shows() -> None:
    equation = with_effect("uds", "lag_p_du").equations["e16"]
    assert equation.text == "y_p_du - lag_p_du_z"
    assert equation.fault is not None
    assert equation.fault.enters_text == "lag_p_du_z -> lag_p_du_z + fy_p_du"
    assert equation.fault.replacement == sp.Symbol("lag_p_du_z") + sp.Symbol("fy_p_du")


def test_a_clogged_filter_narrows_the_laminar_part_too() -> None:
    new = with_effect("uds", "laminar_tank_filter")
    faulty = new.expression("e05", with_fault=True)
    assert sp.Symbol("A_t") not in (faulty.subs(sp.Symbol("fA_t"), -sp.Symbol("A_t") + 1)).free_symbols


@pytest.mark.parametrize(
    ("model", "names"),
    [
        ("uds", ("full_open_gain", "nozzle_deposit", "valve_opens_late")),
        ("uds", ("entrained_air", "stiff_hose", "leak_laminar")),
        ("uds", ("lag_p_du", "offset_p_du", "gain_p_du")),
        ("uds", ("gain_p_du", "offset_p_du", "lag_p_du")),
        ("uds", ("creeping_hose", "pump_slip", "viscosity_drift", "pump_wears")),
        ("uds/production", ("du_filter_cake", "du_inlet_spring", "laminar_du_filter")),
    ],
)
def test_effects_follow_one_another_also_in_the_same_equation(model: str, names: tuple[str, ...]) -> None:
    new = nominal(model)
    for name in names:
        new = rewritten(new, LIBRARY[name])
    assert parse_model(dump_model(new), "written.toml") == new
    strengths = [p for name in names for p in LIBRARY[name].strengths]
    found = outputs(system_of(new, strengths), dict.fromkeys(strengths, 0.0))
    assert np.abs(found / nominal_outputs(model) - 1.0).max() < 1e-6


def test_an_effect_is_added_once() -> None:
    new = with_effect("uds", "pump_slip")
    assert applicable(new, LIBRARY["pump_slip"]) == "uds has pump_slip in it already"


@pytest.mark.parametrize("name", ["full_open_gain", "lag_p_du", "creeping_hose"])
def test_a_rewritten_model_is_analysed_like_any_other(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new = with_effect("uds", name)
    assert lint(new) == []
    path = tmp_path / "uds.toml"
    path.write_text(dump_model(new))
    assert structure([str(path)]) == 0
    assert "tests" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["lag_p_du", "creeping_hose", "laminar_tank_filter"])
def test_sums_of_flows_with_new_states_become_generators(name: str) -> None:
    effect = LIBRARY[name]
    sizes = {p: strength.spread or 0.0 for p, strength in effect.strengths.items()}
    bank = build_bank(with_effect("uds", name).with_parameters(sizes, {}))
    assert bank.generators


def test_numbers_survive_exactly(tmp_path: Path) -> None:
    number = "0.1234567890123456789e-7"
    new = rewritten(nominal("uds"), with_entry(tmp_path, replace=f'replace = "A_dos -> A_dos*(1 + g*{number}/3)"'))
    [found] = new.equations["e04"].expression.atoms(sp.Float)
    assert float(found) == float(number) / 3
    assert parse_model(dump_model(new), "again.toml").equations["e04"] == new.equations["e04"]


@pytest.mark.parametrize(
    ("text", "names", "written"),
    [
        ("q - A*(b - c)", {"A": "A + g", "c": "-c"}, "q - (A + g)*(b - -c)"),
        ("a**2/b", {"a": "x - y", "b": "x*y"}, "(x - y)**2/(x*y)"),
        ("a - b", {"a": "b", "b": "a - b"}, "b - (a - b)"),
        ("abs(abs)*sgsqrt(d)", {"d": "abs(d)", "abs": "x"}, "abs(x)*sgsqrt(abs(d))"),
        ("-a**(1/2) + 1e-300*a", {"a": "-a"}, "-(-a)**(1/2) + 1e-300*-a"),
        ("a\n  + b", {}, "a + b"),
    ],
)
def test_names_are_replaced_all_at_once_and_grouping_stays(text: str, names: dict[str, str], written: str) -> None:
    assert substituted(text, names) == written


def test_a_null_that_only_holds_in_the_signals_range_is_accepted(tmp_path: Path) -> None:
    """A duty cycle is not negative, which sympy does not know."""
    new = rewritten(
        nominal("uds"),
        with_entry(
            tmp_path,
            where='where = ["q_dos", "dc_dose"]',
            replace='replace = "dc_dose -> (dc_dose - g + abs(dc_dose - g))/2"',
        ),
    )
    assert "mine_g" in new.equations["e04"].text


BALANCE = 'where = ["dp_ap", "B_ap"]'
NEW_STATE = '[effect.unknown.x]\nunit = "Pa"\n{initial}[effect.unknown.dx]\nunit = "Pa/s"\n{equation}'
FOLLOWS = '[[effect.equation]]\nname = "e"\nexpr = "g*dx - (p_du - x)"\n'
CHAINED = '[[effect.differential]]\nname = "d"\nstate = "x"\nderivative = "dx"\n'
STATE = 'initial = ["p_sys"]\n'


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"where": 'where = ["q_dso"]'}, "effect mine: uds has no q_dso; leave it away"),
        ({"where": 'where = ["q_dos", "A_ori"]'}, "effect mine: no equation of uds has q_dos and A_ori in it"),
        ({"replace": 'replace = "A_t -> A_t*(1 + g)"'}, "mine.change[0].replace: A_t is not in e04, `q_dos - "),
        ({"replace": 'replace = "A_dos -> A_dos*(1 + gg)"'}, "mine.change[0].replace: unknown name 'gg'; known"),
        ({"replace": 'replace = "A_dos -> A_ori*(1 + g)"'}, "takes A_dos out of e04, where fault fA_dos enters; keep"),
        ({"replace": 'replace = "A_dos -> A_dos + g"'}, "equation.e04: `A_dos` is in m2, `mine_g` in 1; correct"),
        ({"unit": 'unit = "bar"'}, "parameter.mine_g.unit: 1 bar is 100000 of the SI unit"),
        ({"replace": 'replace = "A_dos -> A_dos*(2 + g)"'}, "e04 is not `q_dos - dc_dose*C_q*A_dos*sgsqrt("),
        ({"null": "null = 1.0"}, "with mine_g = 1; write what vanishes there, or correct null"),
        ({"more": NEW_STATE.format(initial="", equation="")}, "mine: unknown.mine_x: is in no equation"),
        ({"more": NEW_STATE.format(initial="", equation=FOLLOWS)}, "mine: 1 equations and differentials for 2 new"),
        (
            {"more": NEW_STATE.format(initial="", equation=FOLLOWS + CHAINED)},
            "mine: unknown.mine_x.initial: is missing",
        ),
        (
            {"more": NEW_STATE.format(initial='initial = ["p_sis"]\n', equation=FOLLOWS + CHAINED)},
            "mine.unknown.x.initial[0]: unknown name 'p_sis'",
        ),
        (
            {"more": NEW_STATE.format(initial=STATE, equation=FOLLOWS.replace("p_du", "p_dd") + CHAINED)},
            "mine.equation[0].expr: unknown name 'p_dd'",
        ),
        (
            {
                "where": 'where = ["y_p_du"]',
                "replace": 'replace = "p_du -> p_du - g*(p_ap - p_du)"',
            },
            "the model cannot be run with it: uds: 12 equations besides its sensors' (y_p_tp, y_p_ap) for 11",
        ),
    ],
)
def test_an_effect_that_means_nothing_in_the_model_is_refused(
    tmp_path: Path, changed: dict[str, str], message: str
) -> None:
    with pytest.raises(ModelError, match=re.escape(message)) as caught:
        rewritten(nominal("uds"), with_entry(tmp_path, **changed))
    assert str(caught.value).startswith(f"{tmp_path}/own.toml: effect mine")
    assert "\n" not in str(caught.value)


def test_a_model_whose_text_says_something_else_is_not_rewritten(tmp_path: Path) -> None:
    model = nominal("uds")
    bent = dataclasses.replace(model.equations["e04"], text="q_dos - A_dos")
    model = dataclasses.replace(model, equations={**model.equations, "e04": bent})
    with pytest.raises(ModelError, match="e04 is not what its text says, `q_dos - A_dos`; correct the model"):
        rewritten(model, with_entry(tmp_path))
