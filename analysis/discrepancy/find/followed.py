"""Runs that follow the measurements: an unknown input of one equation takes the place of what is missing there.

Where a large effect is missing a free run goes elsewhere than the system did, so that neither its signals nor its
derivatives say what the effect depends on. With the most likely unknown input in, the run is near what was measured.
Input and parameters are found together, by the method of Gauss and Newton with a shortened step where it is too long.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.noise import Weigh
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.discrepancy.find.disturbed import DisturbedRuns, disturbed_runs
from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.find.latent import Latent, Misfit
from faultline.analysis.discrepancy.find.unknown_input import cells_of
from faultline.analysis.simulation import disturbance, run
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

STEPS, SHORTEST = 12, 0.05
ENOUGH = 2.0
"""A step that lowers the cost (a chi square) by less is the last."""


@dataclass(frozen=True)
class Followed:
    """The runs as an `operation`, the parameters' `x` (n,), and the `misfit` without what the input explains of it."""

    x: Array
    misfit: Misfit
    operation: Operation


def followed(problem: Problem, x: Array, weights: Sequence[Weigh], equation: str) -> Followed:
    """The runs from `x` on that follow the measurements by an input of the equation.

    Raises:
        InputError: the model cannot be run at `x`.
    """
    runs = disturbed_runs(problem, x)
    cells, size = cells_of(runs), Operation(runs).terms(equation)[0].size
    marks = [size * part for part in cells.marks]
    columns = runs.outputs(equation, marks)
    response = Misfit(problem, x, weights).response(columns)
    found = [Latent(response.gram, response.pull, root) for root in cells.roots.values()]
    root = max(found, key=lambda latent: latent.evidence).scaled_root
    ends = np.cumsum([part.shape[1] for part in marks])[:-1]

    def course(z: Array) -> list[Array]:
        return [part @ a for part, a in zip(marks, np.split(root @ z, ends), strict=True)]

    def white(parts: Sequence[Array]) -> Array:
        return np.concatenate([weigh(part) for weigh, part in zip(weights, parts, strict=True)])

    z = np.zeros(root.shape[1])
    e = white(problem.left(x, runs.pairs))
    least = float(e @ e + x @ x)
    for _ in range(STEPS):
        J = np.hstack([white(problem.slopes(x, runs.pairs)), -white(_apart(columns)) @ root])
        now = np.concatenate([x, z])
        step = -np.linalg.solve(J.T @ J + np.eye(len(now)), J.T @ e + now)
        share, before = 1.0, least
        while share >= SHORTEST:
            x_new, z_new = np.clip(x + share * step[: len(x)], *problem.bounds), z + share * step[len(x) :]
            try:
                other = _again(problem, runs, x_new, equation, course(z_new))
                left = white(problem.left(x_new, other.pairs))
            except InputError:  # too far: the model cannot be run there
                share /= 2.0
                continue
            cost = float(left @ left + x_new @ x_new + z_new @ z_new)
            if cost < least:
                x, z, e, least, runs = x_new, z_new, left, cost, other
                columns = runs.outputs(equation, marks)
                break
            share /= 2.0
        if before - least < ENOUGH:
            break
    misfit = Misfit(problem, x, weights, runs=runs.pairs)
    return Followed(x, misfit.without(-misfit.effect(misfit.response(columns), root @ z)), Operation(runs))


def _again(problem: Problem, runs: DisturbedRuns, x: Array, equation: str, course: Sequence[Array]) -> DisturbedRuns:
    """The runs at another `x`, with the courses (K,) by section added to the equation."""
    k, found = runs.system.inputs.index(disturbance(equation)), []
    for before, added, parameters in zip(runs.trajectories, course, problem.parameters(x), strict=True):
        inputs = before.drive.inputs.copy()
        inputs[:, k] = added
        found.append(run(runs.system, replace(before.drive, inputs=inputs), parameters, before))
    return replace(runs, trajectories=tuple(found))


def _apart(by_section: Sequence[Array]) -> list[Array]:
    """Columns (N, D) by section side by side, as every section has inputs of its own."""
    widths = [part.shape[1] for part in by_section]
    before = np.cumsum([0, *widths])
    return [
        np.pad(part, ((0, 0), (int(b), int(before[-1] - b - part.shape[1]))))
        for part, b in zip(by_section, before, strict=False)
    ]
