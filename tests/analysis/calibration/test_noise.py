"""The noise that is stated is the noise that is whitened, and its levels are found."""

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest
from made_drive import DOSE, ECU_S, UDS4, UDS4_SYSTEM, frames, log_sections

from faultline.analysis.calibration.inputs import UNIFORM
from faultline.analysis.calibration.noise import (
    CELL,
    STEP_TIME,
    Whitening,
    commands_of,
    disturbances,
    stacked,
)
from faultline.analysis.calibration.sections import Section
from faultline.analysis.simulation import Trajectory, run

MODES = UDS4.modes.names
CELL_S, STEP_TIME_S = CELL * UDS4.settling_s, STEP_TIME * UDS4.period_s


Array = npt.NDArray[np.float64]
SEEDS = range(5)
COMMANDS = ("dc_dose",)


@pytest.fixture(scope="module")
def section() -> Section:
    [found] = log_sections(UDS4, UDS4_SYSTEM, frames(UDS4, {}, seed=1))
    return found


@pytest.fixture(scope="module")
def trajectory(section: Section) -> Trajectory:
    values = {name: UDS4.parameters[name].value for name in UDS4_SYSTEM.parameters}
    return run(UDS4_SYSTEM, section.drive, values)


def made_levels(section: Section) -> dict[str, Array]:
    """Another one for every output and mode, above the sensors' own."""
    names = list(section.samples)
    return {
        name: np.asarray(UDS4.known[name].noise * (1.0 + k + 0.5 * np.array([3, 0, 1, 2])))
        for k, name in enumerate(names)
    }


def level_of(section: Section, levels: dict[str, Array]) -> Array:
    """The standard deviation of every sample of a section, all outputs one after the other."""
    return np.concatenate([levels[name][s.mode] for name, s in section.samples.items()])


def drawn_noise(section: Section, levels: dict[str, Array], rng: np.random.Generator) -> Array:
    """v (N,)."""
    sd = np.concatenate([levels[name][s.mode] for name, s in section.samples.items()])
    return np.asarray(sd * rng.standard_normal(len(sd)))


def test_the_dose_is_the_only_command(section: Section) -> None:
    assert commands_of(UDS4_SYSTEM, [section]) == COMMANDS


def test_noise_of_the_stated_model_becomes_unit_and_independent(section: Section, trajectory: Trajectory) -> None:
    """Sums of squares, in all and over each output, and neighbours' products lie within 4.5 of their own spreads.

    Directions too faint to be whitened leave up to FAINT^2 of a unit each, far below that.
    """
    levels = made_levels(section)
    B = disturbances(section, trajectory, COMMANDS)
    white = Whitening(level_of(section, levels), B)
    ends = np.cumsum([len(s.t) for s in section.samples.values()])[:-1]
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        noise = drawn_noise(section, levels, rng) + B @ rng.standard_normal(B.shape[1])
        found = white(noise)
        for part in (found, *np.split(found, ends)):
            n = len(part)
            assert abs(np.sum(part**2) - n) < 4.5 * np.sqrt(2 * n), seed
            for lag in (1, 5, 20):
                assert abs(np.sum(part[lag:] * part[:-lag])) < 4.5 * np.sqrt(n), (seed, lag)
        slow = [
            block.sum() / np.sqrt(len(block)) for part in np.split(found, ends) for block in np.array_split(part, 8)
        ]
        assert np.sum(np.square(slow)) < 24 + 4.5 * np.sqrt(2 * 24), seed  # blocks of 20 s wander no more than chance


def test_without_the_disturbances_it_would_not_be(section: Section, trajectory: Trajectory) -> None:
    """So that the test above can fail."""
    levels = made_levels(section)
    B = disturbances(section, trajectory, COMMANDS)
    rng = np.random.default_rng(0)
    noise = drawn_noise(section, levels, rng) + B @ rng.standard_normal(B.shape[1])
    plain = Whitening(level_of(section, levels), np.zeros((len(B), 1)))(noise)
    assert np.sum(plain**2) > len(plain) + 10 * np.sqrt(2 * len(plain))


def test_whitening_is_the_inverse_of_the_covariance(section: Section, trajectory: Trajectory) -> None:
    """To the directions that are faint."""
    levels = made_levels(section)
    B = disturbances(section, trajectory, COMMANDS)
    sd = np.concatenate([levels[name][s.mode] for name, s in section.samples.items()])
    e = np.random.default_rng(1).standard_normal((len(sd), 3)) * sd[:, None]
    white = Whitening(level_of(section, levels), B)(e)
    expected = e.T @ np.linalg.solve(np.diag(sd**2) + B @ B.T, e)
    assert white.T @ white == pytest.approx(expected, rel=1e-3, abs=1.0)
    assert Whitening(level_of(section, levels), B)(e[:, 0]) == pytest.approx(white[:, 0])


def test_the_disturbances_are_those_of_speed_levels_and_steps(section: Section, trajectory: Trajectory) -> None:
    """One column for each cell of the speed, each of its jumps, each level of the dose and each of its steps."""
    steps = sum(a != b for a, b in zip(DOSE[1:], DOSE[:-1], strict=True))
    cells = int(np.ceil(len(section.t) * section.drive.step_s / CELL_S))
    B = disturbances(section, trajectory, COMMANDS)
    jumps = len(section.uncertain["n_p"])
    assert B.shape == (sum(len(s.t) for s in section.samples.values()), cells + jumps + (steps + 1) + steps)
    assert jumps < 0.01 * cells * CELL_S / ECU_S  # here the speed does not: chance


def test_a_late_step_is_its_column(section: Section, trajectory: Trajectory) -> None:
    """Every step later by a little: the sum of the steps' columns."""
    B = disturbances(section, trajectory, COMMANDS)
    u = section.drive.inputs.copy()
    late = 0.02
    u[:, 1] = np.interp(section.t - late, section.t, u[:, 1])
    moved = run(
        UDS4_SYSTEM, type(section.drive)(0.05, u, section.drive.start, section.drive.guess), trajectory.parameters
    )
    change = stacked(section, moved.outputs()) - stacked(section, trajectory.outputs())
    told = -late / STEP_TIME_S * B[:, -4:].sum(axis=1)
    assert np.abs(change).max() > 500.0
    assert min(np.abs(change - told).max(), np.abs(change + told).max()) < 0.05 * np.abs(change).max()


def test_a_level_error_stays_with_its_level(section: Section, trajectory: Trajectory) -> None:
    """It lifts the pressure from its step to the next, and what the hose remembers after."""
    B = disturbances(section, trajectory, COMMANDS)
    t = np.concatenate([section.start_s + s.t for s in section.samples.values()])
    partial = B[:, -8]  # of the second of five levels, 0.4 from 60 s on
    output = np.repeat(np.arange(3), [len(s.t) for s in section.samples.values()])
    ap = output == 1
    assert np.abs(partial[ap & (t < 59.0)]).max() < 1e-6
    held = partial[ap & (t > 80.0) & (t < 89.0)]
    assert np.ptp(held) < 0.05 * np.abs(held).mean()
    assert np.abs(held).mean() > 100.0
    assert np.abs(partial[ap & (t > 118.0)]).max() < 0.01 * np.abs(held).mean()


def test_a_jumps_column_is_what_its_unknown_instant_does(section: Section, trajectory: Trajectory) -> None:
    """A speed that is higher from the begin of an interval on, or from its end on: sqrt(12) times the column apart."""
    height, begin, end = 0.5, 100.0, 100.2
    jump = np.array([[begin, end, height * UNIFORM, 0.0]])
    B = disturbances(dataclasses.replace(section, uncertain={"n_p": jump}), trajectory, COMMANDS)
    column = B[:, int(np.ceil(len(section.t) * section.drive.step_s / CELL_S))]
    outputs = []
    for at in (begin, end):
        u = section.drive.inputs.copy()
        u[:, 0] += height * (section.t > at - 0.01)
        outputs.append(
            stacked(
                section, run(UDS4_SYSTEM, dataclasses.replace(section.drive, inputs=u), trajectory.parameters).outputs()
            )
        )
    apart = outputs[0] - outputs[1]
    t = np.concatenate([s.t for s in section.samples.values()])
    after = t > end + 0.2
    assert np.abs(apart[after]).max() > 500.0
    assert np.abs(apart - np.sqrt(12.0) * column)[after].max() < 0.05 * np.abs(apart[after]).max()
    assert np.abs(column[t < begin - 0.2]).max() < 1e-6
