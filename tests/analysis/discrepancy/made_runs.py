"""Runs of a model with something added to its equations: a vehicle that the model does not quite describe."""

import dataclasses
from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.inputs import is_command
from faultline.analysis.calibration.noise import Whitening, disturbances
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.calibration.sections import Samples, Section
from faultline.analysis.discrepancy.find.quantities import mode_of, quantities
from faultline.analysis.model import Model
from faultline.analysis.recordings.modes import time_of
from faultline.analysis.simulation import Drive, disturbance, run, system_of

Array = npt.NDArray[np.float64]
Missing = Callable[[Mapping[str, Array]], Array]
"""What is added to an equation (K,), from what the model alone would do: inputs and unknowns (K,) by name, and `t`."""

STEP_S, SAMPLE_S = 0.1, 0.2
HOLD_S = 12.0
DOSE = (0.0, 0.4, 1.0, 0.0, 0.7, 1.0, 0.2, 0.0, 1.0, 0.5, 0.0, 0.8, 1.0)
SPEED = (24.0, 26.0, 30.0, 25.0, 27.0, 31.0, 22.0, 20.0, 29.0, 33.0, 22.0, 28.0, 26.0)
PUMP = (0.6, 0.8, 0.5, 0.7, 0.9, 0.6, 0.4, 0.8, 0.55, 0.75)
LEVELS = {"y_p_tp": 500.0, "y_p_ap": 1500.0, "y_p_du": 1500.0}


def dosing(model: Model, missing: Mapping[str, Missing], seed: int, true: Model | None = None) -> Problem:
    """Doses and speeds that step; the speed wanders besides, as a controller makes it do.

    The vehicle is the `true` model, with `missing` in it besides; without one, the model itself is true.
    """
    t = np.arange(0.0, HOLD_S * len(DOSE), STEP_S)
    wander = sum(0.3 * np.sin(6.28 * f * t + f) for f in (0.021, 0.047, 0.083))
    u = np.column_stack([_ramps(t, SPEED, 2.0) + wander, _ramps(t, DOSE, 0.2)])
    return made(model, u, t, missing, seed, true)


def tanks(model: Model, missing: Mapping[str, Missing], seed: int, true: Model | None = None) -> Problem:
    """The pump's command steps; `true` is as of `dosing`."""
    t = np.arange(0.0, 60.0 * len(PUMP), 2.0 * STEP_S)
    return made(model, _ramps(t, PUMP, 0.4, 60.0)[:, None], t, missing, seed, true)


def made(
    model: Model, u: Array, t: Array, missing: Mapping[str, Missing], seed: int, true: Model | None = None
) -> Problem:
    """The problem that one section of samples with noise makes; the parameters are as expected."""
    rng = np.random.default_rng(seed)
    system, h = system_of(model, model.calibrated), float(t[1])
    noise = np.tile([model.known[name].noise for name in system.inputs], (len(t), 1))
    outputs, start = _outputs(true or model, u, h, missing)
    commands = tuple(name for name, value in zip(system.inputs, u.T, strict=True) if is_command(value))
    drive = Drive(h, u, start, np.tile(start, (len(t), 1)))
    section = Section(0, 0.0, drive, noise, {}, {}, time_of(model), commands)
    mode = mode_of(model, system, section)
    samples = {}
    for name, value in outputs.items():
        at = np.arange(round(model.warm_up_s / h), len(t) - 1, round(SAMPLE_S / h))
        samples[name] = Samples(t[at], value[at] + rng.normal(0.0, _level(model, name), len(at)), mode[at])
    return Problem(system, [dataclasses.replace(section, samples=samples, sensed=outputs)])


def weights(problem: Problem, x: Array) -> list[Whitening]:
    """The weights with the noise that was added."""
    found = []
    for section, trajectory in zip(problem.sections, problem.trajectories(x), strict=True):
        levels = [np.full(len(s.t), _level(problem.system.model, name)) for name, s in section.samples.items()]
        found.append(Whitening(np.concatenate(levels), disturbances(section, trajectory, problem.commands)))
    return found


def _level(model: Model, name: str) -> float:
    return LEVELS.get(name, model.known[name].noise)


def _outputs(model: Model, u: Array, h: float, missing: Mapping[str, Missing]) -> tuple[dict[str, Array], Array]:
    """The outputs with what is missing, from a state of rest on; and that state."""
    system = system_of(model, model.calibrated)
    values = {name: model.parameters[name].value for name in system.parameters}
    guess = np.array([{"p_tp": 99e3, "p_bp": 95e3}.get(name, 1e6 if name[0] == "p" else 0.3) for name in system.states])
    ran_in = Drive(h, np.tile(u[0], (len(u), 1)), guess, np.tile(guess, (len(u), 1)))
    start = run(system, ran_in, values).w[-1, : len(system.states)]
    alone = run(system, Drive(h, u, start, np.tile(start, (len(u), 1))), values)
    known = {**quantities(alone), "t": np.linspace(0.0, h * (len(u) - 1), len(u))}
    disturbed = system_of(model, model.calibrated, disturbed=True)
    extra = np.zeros((len(u), len(disturbed.inputs) - u.shape[1]))
    for equation, effect in missing.items():
        extra[:, disturbed.inputs.index(disturbance(equation)) - u.shape[1]] = effect(known)
    drive = Drive(h, np.hstack([u, extra]), start, np.tile(start, (len(u), 1)))
    return run(disturbed, drive, values).outputs(), start


def _ramps(t: Array, values: tuple[float, ...], width_s: float, hold_s: float = HOLD_S) -> Array:
    """Steps that take `width_s`."""
    middle = hold_s * np.arange(1, len(values))
    times = np.column_stack([middle - width_s / 2.0, middle + width_s / 2.0]).ravel()
    levels = np.array([*pairwise(values)]).ravel()
    return np.asarray(np.interp(t, times, levels))
