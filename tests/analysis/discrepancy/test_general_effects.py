"""Effects of any system, bound to a system's roles: what they make of its equations, and what is refused."""

import dataclasses
import tomllib
from pathlib import Path

import pytest
import sympy as sp

from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.experiments import load_experiments
from faultline.analysis.discrepancy.effects.library import GENERAL, load_library
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.model import Model, ModelError, load_model
from faultline.analysis.model.file import SYSTEMS, alike, folder_of

EMPS = load_model("emps")
BOUND = """schema = 1
[[use]]
effect = "friction"
name = "coulomb"
component = "guide"
roles = { force = "F", velocity = "v" }
parameter.F_c = { unit = "N", spread = 20.0, max = 100.0 }
parameter.v_0 = { unit = "m/s", value = 0.002 }
"""
LIMITED = {"limit": 'unit = "N", value = 50.0', "w": 'unit = "N", value = 1.0'}
USES = {
    "friction": (
        '{ force = "F", velocity = "v" }',
        {"F_c": 'unit = "N", spread = 5.0', "v_0": 'unit = "m/s", value = 1e-3'},
    ),
    "saturation": ('{ quantity = "F", beside = "Fv" }', LIMITED),
    "dead_zone": (
        '{ quantity = "F", beside = "Fv" }',
        {"d": 'unit = "N", spread = 5.0', "w": 'unit = "N", value = 1.0'},
    ),
    "leak": ('{ flow = "F", level = "v" }', {"c": 'unit = "N s/m", spread = 5.0'}),
    "overflow": (
        '{ flow = "F", level = "v" }',
        {"c": 'unit = "N s/m", spread = 5.0', "limit": 'unit = "m/s", value = 0.5', "w": 'unit = "m/s", value = 0.01'},
    ),
    "lag": ('{ quantity = "v", beside = "y_v" }', {"tau": "spread = 0.01"}),
    "delay": ('{ quantity = "v", beside = "y_v" }', {"tau": "spread = 0.01"}),
    "offset": ('{ quantity = "v", beside = "y_v" }', {"o": 'unit = "m/s", spread = 0.01'}),
    "gain": ('{ quantity = "v", beside = "y_v" }', {}),
    "second_order": ('{ quantity = "v", beside = "y_v" }', {"tau": "spread = 0.01"}),
    "drift": ('{ quantity = "v", beside = "y_v" }', {}),
}
BEHIND = 'unknown.z = { unit = "m/s", initial = ["y_v"] }\nunknown.dz = { unit = "m/s2" }\n'
LATE = 'unknown.late = { unit = "m/s" }\n'
SWINGS = 'unknown.v = { unit = "m/s" }\nunknown.dv = { unit = "m/s2" }\n'
SEEN = 'unknown.seen = { unit = "m/s" }\n'
UNKNOWNS = {"lag": BEHIND, "delay": BEHIND + LATE, "second_order": BEHIND + SWINGS, "drift": SEEN}


def bound(folder: Path, text: str) -> Path:
    (folder / "effects.toml").write_text(text)
    return folder / "effects.toml"


def use(name: str) -> str:
    roles, parameters = USES[name]
    lines = [f"parameter.{own} = {{ {given} }}" for own, given in parameters.items()]
    head = f'schema = 1\n[[use]]\neffect = "{name}"\ncomponent = "drive"\nroles = {roles}\n'
    return head + "\n".join(lines) + "\n" + UNKNOWNS.get(name, "")


def without(model: Model, effect: Effect) -> dict[str, sp.Expr]:
    """The equations with the effect in them at nothing, a lag of none solved."""
    after = rewritten(model, effect)
    nothing = {sp.Symbol(name): 0.0 for name, p in effect.strengths.items() if p.null == 0.0}
    unlagged = {sp.Symbol(effect.prefixed(own)): sp.Symbol("v") for own in ("z", "late", "seen")}
    return {name: e.expression.xreplace(nothing).xreplace(unlagged) for name, e in after.equations.items()}


@pytest.mark.parametrize("name", USES)
def test_each_is_nothing_at_its_null_and_changes_its_equation_else(name: str, tmp_path: Path) -> None:
    effect = load_library(None, bound(tmp_path, use(name)))[name]
    before = {key: equation.expression for key, equation in EMPS.equations.items()}
    after = without(EMPS, effect)
    for key, expression in before.items():
        assert sp.simplify(after[key] - expression) == 0, key
    changed = rewritten(EMPS, effect)
    assert sum(changed.equations[key].expression != expression for key, expression in before.items()) == 1


def test_all_that_the_library_has_are_tried_here() -> None:
    names = [entry["name"] for entry in tomllib.loads(GENERAL.read_text())["effect"]]
    assert sorted(names) == sorted(USES)


def test_friction_is_what_coulomb_says_far_from_rest(tmp_path: Path) -> None:
    model = rewritten(EMPS, load_library(None, bound(tmp_path, BOUND))["coulomb"])
    values = {"F": 100.0, "coulomb_F_c": 20.0, "coulomb_v_0": 0.002, "M": 10.0, "Fv": 30.0, "F_0": 0.0, "dv": 0.0}
    for velocity in (0.5, -0.5):
        given = {sp.Symbol(key): value for key, value in {**values, "v": velocity}.items()}
        left = float(model.equations["e2"].expression.subs(given))
        assert left == pytest.approx(-(100.0 - 20.0 * velocity / 0.5 - 30.0 * velocity), rel=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            '"friction"',
            '"stiction"',
            "use[0].effect: stiction is none of friction, saturation, dead_zone, leak",
        ),
        ("parameter.v_0", "parameter.v_1", "use[0].parameter.v_1: is none of F_c, v_0"),
        ('unit = "N", spread', "spread", "effect coulomb.parameter.F_c.unit: is missing; give a string"),
        ('component = "guide"', "", "component: is missing; give a string"),
        ("roles =", "role =", "effect coulomb.role: unknown key"),
    ],
)
def test_what_a_use_lacks_is_told_with_its_place(old: str, new: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError) as error:
        load_library(None, bound(tmp_path, BOUND.replace(old, new, 1)))
    assert told in str(error.value)


def test_effects_and_experiments_are_those_of_the_models_system(tmp_path: Path) -> None:
    emps = SYSTEMS / "emps"
    for name, found in (("uds", "uds"), ("uds/production", "uds"), ("emps", "emps"), ("three-tank", "three-tank")):
        assert folder_of(name, load_model(name).name) == SYSTEMS / found
    assert folder_of(emps / "model.toml", "") == folder_of(emps, "") == emps
    assert folder_of(tmp_path / "calibrated.toml", "emps") == emps  # a calibrated model keeps its name
    assert folder_of(tmp_path / "calibrated.toml", "mine") is None
    bound(tmp_path, BOUND)
    assert folder_of(tmp_path / "calibrated.toml", "emps") == tmp_path
    assert [*load_library(emps)] != [*load_library(tmp_path)] == ["coulomb"]
    assert load_library(SYSTEMS / "three-tank") == load_library(None) == {}
    assert load_experiments(SYSTEMS / "three-tank") == load_experiments(None)
    assert not any("uds" in effect.place for effect in load_library(emps).values())


def test_a_copy_of_a_shipped_model_elsewhere_has_that_systems_effects() -> None:
    uds = load_model("uds")
    values = {name: dataclasses.replace(p, value=2.0 * p.value) for name, p in uds.parameters.items()}
    other = dataclasses.replace(uds, name="mine", parameters=values)
    assert alike(other) == SYSTEMS / "uds"
    assert alike(dataclasses.replace(other, unknown={**uds.unknown, "q": uds.unknown["q_ori"]})) is None
