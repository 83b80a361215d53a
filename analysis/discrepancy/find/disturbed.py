"""A calibrated model's runs with a disturbance on every equation, and what disturbances do to the outputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
import sympy as sp

from faultline.analysis.calibration.noise import stacked
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.calibration.sections import Section
from faultline.analysis.simulation import Drive, System, Trajectory, disturbance, run, system_of

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class DisturbedRuns:
    """The runs of a problem at an x, on a coarser grid: `sections` are the problem's with that grid.

    `system` has the disturbances, all zero in the runs but for those that were asked for; `commands` are its inputs
    that hold still between steps, `lag` [s] is what the outputs lag behind.
    """

    system: System
    sections: tuple[Section, ...]
    trajectories: tuple[Trajectory, ...]
    commands: tuple[str, ...]
    lag: Mapping[str, float]

    @property
    def pairs(self) -> list[tuple[Section, Trajectory]]:
        """Every section and its run."""
        return [*zip(self.sections, self.trajectories, strict=True)]

    def outputs(self, equation: str, directions: Sequence[Array]) -> list[Array]:
        """What disturbances (K, D) by section of an equation add to the samples, (N, D)."""
        name = disturbance(equation)
        return [
            stacked(section, trajectory.by_input(name, direction), self.lag)
            for section, trajectory, direction in zip(self.sections, self.trajectories, directions, strict=True)
        ]

    @cached_property
    def same_as(self) -> dict[str, tuple[str, float]]:
        """By equation another, maybe itself, whose disturbance times a number does exactly the same, and that number.

        In a balance of flows it does not matter which flow is wrong: that saves half of the time.
        """
        numbers = {sp.Symbol(name): sp.Float(value) for name, value in self.trajectories[0].parameters.items()}
        found: dict[str, tuple[str, float]] = {}
        first: dict[tuple[float, ...], tuple[str, float]] = {}
        for name in self.system.model.equations:
            d = sp.Symbol(disturbance(name))
            slopes = [sp.diff(e, d).xreplace(numbers) for e in (*self.system.residuals, *self.system.outputs.values())]
            found[name] = (name, 1.0)
            if all(slope.is_number for slope in slopes):
                values = [float(slope) for slope in slopes]
                lead = next((value for value in values if value != 0.0), 1.0)
                other, other_lead = first.setdefault(tuple(float(f"{v / lead:.9g}") for v in values), (name, lead))
                found[name] = (other, lead / other_lead)
        return found


def disturbed_runs(
    problem: Problem, x: Array, added: Mapping[str, Sequence[Array]] = MappingProxyType({})
) -> DisturbedRuns:
    """The problem's runs at `x`, with what is `added` to equations (K,) by section.

    Raises:
        InputError: the model cannot be run at `x`.
    """
    system = system_of(problem.system.model, problem.system.parameters, disturbed=True)
    sections, trajectories = [], []
    for k, (section, fine) in enumerate(zip(problem.sections, problem.trajectories(x), strict=True)):
        every = max(1, round(section.time.period_s / fine.drive.step_s))
        inputs = fine.drive.inputs[::every]
        extra = np.zeros((len(inputs), len(system.inputs) - inputs.shape[1]))
        for equation, by_section in added.items():
            extra[:, system.inputs.index(disturbance(equation)) - inputs.shape[1]] = by_section[k]
        guess = fine.w[::every]
        states = guess[:, : len(system.states)]
        drive = Drive(every * fine.drive.step_s, np.hstack([inputs, extra]), fine.drive.start, states)
        near = replace(fine, system=system, drive=drive, w=guess)
        trajectories.append(run(system, drive, fine.parameters, near))
        sections.append(replace(section, drive=drive))
    lag = problem.unknowns.lag(x)
    return DisturbedRuns(system, tuple(sections), tuple(trajectories), problem.commands, lag)
