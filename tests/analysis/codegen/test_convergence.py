"""Residuals of every causality vanish with the period on exact samples: first order, as their rules are."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from generated import needs_compiler, run_c99, run_python
from scipy.integrate import solve_ivp

from faultline.analysis.codegen import ComputationSequence, computation_sequence, residual_program
from faultline.analysis.model import Model
from faultline.analysis.model.file import parse_model, shipped_models
from faultline.analysis.structure import find_tests, mso_sets, structure_of

Array = npt.NDArray[np.float64]

PERIODS_S = (0.1, 0.01)


def largest(model: Model, sequence: ComputationSequence, samples: Mapping[str, Array], period: float) -> float:
    """The largest residual in the second half, when a difference quotient has forgotten its start."""
    program = residual_program(model, sequence, name="residual", period=period)
    r = run_python(program, [*samples], np.column_stack([*samples.values()]))
    return float(np.abs(r[len(r) // 2 :]).max())


@pytest.fixture(scope="module")
def tanks() -> Model:
    """Three tanks whose levels stand 3 to 2 to 1 at the start, exactly."""
    text = shipped_models()["three-tank"].read_text()
    return parse_model(text.replace("0.67*y1", "y1*2/3").replace("0.33*y1", "y1/3"), "three-tank.toml")


def filling(model: Model, period: float) -> dict[str, Array]:
    """Accurate levels of the tanks under a pump that speeds up and slows down, every `period` [s]."""
    v = {name: parameter.value for name, parameter in model.parameters.items()}
    areas = np.array([v["A_12"], v["A_23"], v["A_3"]])

    def rates(t: float, h: Array) -> Array:
        heads = 2 * v["g"] * (h - np.append(h[1:], 0.0))
        out = areas * np.sign(heads) * np.sqrt(np.abs(heads))
        slopes: Array = (np.append(v["k_pump"] * command(t), out[:2]) - out) / v["S"]
        return slopes

    t = np.arange(0.0, 20.0, period)
    levels = solve_ivp(rates, (0.0, 20.0), [0.45, 0.3, 0.15], t_eval=t, rtol=1e-10, atol=1e-12).y
    return {"u": command(t), **dict(zip(("y1", "y2", "y3"), levels, strict=True))}


def command(t: float | Array) -> Array:
    return np.asarray(0.5 + 0.2 * np.sin(0.3 * np.asarray(t)))


def test_every_residual_of_three_tanks_vanishes_with_the_period(tanks: Model) -> None:
    coarse, fine = (filling(tanks, period) for period in PERIODS_S)
    constraints = [d.name for d in tanks.differentials]
    seen: Counter[str] = Counter()
    for test in find_tests(tanks):
        for equation in test.equations:
            for form in ("integral", "derivative") if equation in constraints else ("integral",):
                sequence = computation_sequence(tanks, test.equations, equation, form=form)
                seen[sequence.causality] += 1
                large, small = (largest(tanks, sequence, z, T) for z, T in zip((coarse, fine), PERIODS_S, strict=True))
                assert small < max(large / 3, 1e-9), (test.name, equation, form, sequence.causality, large, small)
    assert seen == {"mixed": 110, "derivative": 82, "integral": 20}


DIVIDER = """
schema = 1
name = "divider"
description = "two leaking capacitors in series at a source: neither of the voltages is free, so a loop differentiates"
[known.u]
unit = "V"
min = -2.0
max = 2.0
noise = 0.1
[known.y]
unit = "V"
min = -2.0
max = 2.0
noise = 0.1
[unknown.v1]
unit = "V"
initial = ["y"]
[unknown.v2]
unit = "V"
initial = ["u - y"]
[unknown.dv1]
unit = "V/s"
[unknown.dv2]
unit = "V/s"
[unknown.i]
unit = "A"
[parameter.C1]
unit = "F"
value = 0.2
source = "made up"
[parameter.C2]
unit = "F"
value = 0.5
source = "made up"
[parameter.R1]
unit = "ohm"
value = 3.0
source = "made up"
[parameter.R2]
unit = "ohm"
value = 7.0
source = "made up"
[[equation]]
name = "e1"
expr = "u - v1 - v2"
[[equation]]
name = "e2"
expr = "i - C1*dv1 - v1/R1"
[[equation]]
name = "e3"
expr = "i - C2*dv2 - v2/R2"
[[equation]]
name = "e4"
expr = "y - v1"
[[differential]]
name = "e5"
state = "v1"
derivative = "dv1"
[[differential]]
name = "e6"
state = "v2"
derivative = "dv2"
"""


def test_a_loop_that_differentiates_within_vanishes_with_the_period() -> None:
    model = parse_model(DIVIDER, "divider.toml")
    [equations] = mso_sets(structure_of(model))
    sequence = computation_sequence(model, equations, "e4")
    assert [component.kind for component in sequence.components] == ["mixed"]
    errors = [largest(model, sequence, divided(model, period), period) for period in PERIODS_S]
    assert 1e-6 < errors[1] < errors[0] / 3 < 0.01


def divided(model: Model, period: float) -> dict[str, Array]:
    """Accurate samples of the divider at a source that rings."""
    v = {name: parameter.value for name, parameter in model.parameters.items()}

    def rate(t: float, x: Array) -> Array:
        u, du = np.sin(2 * t), 2 * np.cos(2 * t)
        slope: Array = (v["C2"] * du + (u - x) / v["R2"] - x / v["R1"]) / (v["C1"] + v["C2"])
        return slope

    t = np.arange(0.0, 20.0, period)
    [y] = solve_ivp(rate, (0.0, 20.0), [0.2], t_eval=t, rtol=1e-10, atol=1e-12).y
    return {"u": np.sin(2 * t), "y": y}


RUNGS = 12
FEED_S, LOAD_S, LINK_S = 1.5, 0.2, 2.0  # conductances
CAPACITY_F = 0.4


def ladder() -> Model:
    """A capacitor behind a ladder of resistors, whose node voltages are one linear loop with its voltage given."""
    known = "".join(f'[known.{name}]\nunit = "V"\nmin = -2.0\nmax = 2.0\nnoise = 0.1\n' for name in "uy")
    nodes = "".join(f'[unknown.v{k}]\nunit = "V"\n' for k in range(RUNGS))
    values = {"Gu": (FEED_S, "1/ohm"), "Gl": (LOAD_S, "1/ohm"), "G": (LINK_S, "1/ohm"), "C": (CAPACITY_F, "F")}
    parameters = "".join(
        f'[parameter.{name}]\nunit = "{unit}"\nvalue = {value}\nsource = "made up"\n'
        for name, (value, unit) in values.items()
    )
    formulas = []
    for k in range(RUNGS):
        before = "Gu*(u - v0)" if k == 0 else f"G*(v{k - 1} - v{k})"
        after = f"G*(v{k} - {f'v{k + 1}' if k + 1 < RUNGS else 'w'})"
        formulas.append(f"{before} - {after} - Gl*v{k}")
    formulas += [f"C*dw - G*(v{RUNGS - 1} - w)", "y - v0"]
    equations = "".join(f'[[equation]]\nname = "e{k}"\nexpr = "{text}"\n' for k, text in enumerate(formulas))
    state = '[unknown.w]\nunit = "V"\ninitial = ["0.0"]\n[unknown.dw]\nunit = "V/s"\n'
    constraint = '[[differential]]\nname = "d"\nstate = "w"\nderivative = "dw"\n'
    head = 'schema = 1\nname = "ladder"\n'
    return parse_model(head + known + nodes + state + parameters + equations + constraint, "ladder.toml")


def through_the_ladder(period: float) -> dict[str, Array]:
    """Accurate samples of the ladder at a source that rings, its capacitor empty at the start."""
    links = LINK_S * (2 * np.eye(RUNGS) - np.eye(RUNGS, k=1) - np.eye(RUNGS, k=-1)) + LOAD_S * np.eye(RUNGS)
    links[0, 0] += FEED_S - LINK_S
    by_source = np.linalg.solve(links, FEED_S * np.eye(RUNGS)[0])
    by_state = np.linalg.solve(links, LINK_S * np.eye(RUNGS)[-1])

    def rate(t: float, w: Array) -> Array:
        slope: Array = LINK_S * (by_source[-1] * np.sin(2 * t) + by_state[-1] * w - w) / CAPACITY_F
        return slope

    t = np.arange(0.0, 20.0, period)
    [w] = solve_ivp(rate, (0.0, 20.0), [0.0], t_eval=t, rtol=1e-10, atol=1e-12).y
    return {"u": np.sin(2 * t), "y": by_source[0] * np.sin(2 * t) + by_state[0] * w}


@needs_compiler
def test_a_large_loop_inside_an_implicit_step_vanishes_with_the_period_and_is_the_same_in_c(tmp_path: Path) -> None:
    model = ladder()
    [equations] = mso_sets(structure_of(model))
    last = f"e{RUNGS + 1}"
    for equation, kinds in ((f"e{RUNGS}", {"algebraic", "derivative"}), (last, {"integral"})):
        sequence = computation_sequence(model, equations, equation)
        assert {component.kind for component in sequence.components} == kinds
        errors = [largest(model, sequence, through_the_ladder(period), period) for period in PERIODS_S]
        assert errors[1] < errors[0] / 3, equation
    program = residual_program(model, computation_sequence(model, equations, last), name="ladder")
    samples = through_the_ladder(0.2)
    z = np.column_stack([*samples.values()])
    np.testing.assert_array_equal(run_c99([program], [*samples], z, tmp_path)[:, 0], run_python(program, [*samples], z))
