"""Maximum a posteriori calibration of a model's free run.

The unknowns are x = (xi, zeros, delays), each N(0, 1) beforehand: the parameters theta = value * exp(prior * xi) within
their bounds; the zero error that calibration at atmosphere has left of every sensor; and by how much the commands act
later than they are logged. They minimise

    sum over sections |Sigma^(-1/2) (y - y_hat(x))|^2 + |x|^2

with Sigma as in `noise`, from several starts (the datasheet, and draws from the prior), by scipy's trust region method
with exact derivatives. What Sigma is follows from the data: first from how the measurements flicker in each operating
mode, then from what a fit leaves. The covariance is the inverse of the curvature there, with each standard error at
least what the scatter between blocks of `BLOCK_S` says (the sandwich of White 1982): noise may be worse than thought.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares

from analysis.calibration.noise import (
    Levels,
    Whitening,
    by_square,
    commands_of,
    disturbances,
    levels_of,
    stacked,
)
from analysis.calibration.sections import Section, by_median
from analysis.simulation import Drive, System, Trajectory, run
from service.core.errors import InputError

Array = npt.NDArray[np.float64]

DELAY_S = 0.3
"""Prior standard deviation of a command's delay: a period of the valve."""

ROUGH, FINE = 1e-3, 1e-7
"""Relative change of the cost at which the search ends: from a start, and at last."""

ROUNDS = 3
"""How often the weights are made anew from what the fit leaves; the last two differ by little."""

SAME = 5.0
"""Two searches whose costs (half a chi square) differ by less have come to the same place, for all `ROUGH` can tell."""

BLOCK_S = 20.0
"""Longer than anything here remembers."""

AT_BOUND = 1e-3
"""So near to a bound in standard deviations of the prior, a parameter has run into it."""


class Unknowns(NamedTuple):
    """What is fitted, by name: `parameters`, `zeros` of outputs, `delays` of inputs, with their sizes at x = 1."""

    parameters: tuple[str, ...]
    values: Array
    priors: Array
    zeros: dict[str, float]
    delays: tuple[str, ...]

    @property
    def size(self) -> int:
        """The length of x."""
        return len(self.parameters) + len(self.zeros) + len(self.delays)

    def theta(self, x: Array) -> dict[str, float]:
        """The parameters' values."""
        xi = x[: len(self.parameters)]
        return dict(zip(self.parameters, (self.values * np.exp(self.priors * xi)).tolist(), strict=True))

    def zero(self, x: Array) -> dict[str, float]:
        """The sensors' zero errors, in their units."""
        part = x[len(self.parameters) : len(self.parameters) + len(self.zeros)].tolist()
        return {name: sd * value for (name, sd), value in zip(self.zeros.items(), part, strict=True)}

    def delay(self, x: Array) -> dict[str, float]:
        """The commands' delays [s]."""
        part = DELAY_S * x[len(self.parameters) + len(self.zeros) :]
        return dict(zip(self.delays, part.tolist(), strict=True))


@dataclass(frozen=True)
class Fit:
    """The result: x and its covariance (n, n), the `information` (n, n) of the data without the priors, and the noise.

    `starts` is how many searches there were and how many of them came to the best place; `at_bound` the parameters that
    have run into a bound.
    """

    system: System
    unknowns: Unknowns
    x: Array
    covariance: Array
    information: Array
    levels: Levels
    starts: tuple[int, int]
    at_bound: tuple[str, ...]

    @property
    def values(self) -> dict[str, float]:
        """The calibrated parameters."""
        return self.unknowns.theta(self.x)


def unknowns_of(system: System, commands: tuple[str, ...]) -> Unknowns:
    """The unknowns of a system that has its calibrated parameters as symbols."""
    model = system.model
    chosen = [model.parameters[name] for name in system.parameters]
    return Unknowns(
        parameters=system.parameters,
        values=np.array([p.value for p in chosen]),
        priors=np.array([p.prior for p in chosen], dtype=np.float64),
        zeros={name: model.known[name].zero for name in system.outputs if model.known[name].zero > 0.0},
        delays=commands,
    )


def fit(system: System, sections: Sequence[Section], say: Callable[[str], None], starts: int = 4) -> Fit:
    """Calibrates the parameters that are symbols of `system`, on fault-free sections; `say` hears how it goes.

    Raises:
        InputError: the model cannot be run from any start.
    """
    problem, model = _Problem(system, sections), system.model
    measured = [np.concatenate([s.value for s in section.samples.values()]) for section in sections]
    levels = levels_of(model, sections, measured, by_median)
    weights = problem.weights(np.zeros(problem.unknowns.size), levels)
    rng = np.random.default_rng(1)
    found: list[OptimizeResult] = []
    for number in range(starts):
        x = np.zeros(problem.unknowns.size)
        if number:
            x[: len(system.parameters)] = rng.standard_normal(len(system.parameters))
        say(f"start {number + 1} of {starts}")
        try:
            found.append(problem.search(np.clip(x, *problem.bounds), weights, ROUGH))
        except InputError:  # from there the model cannot be run; at least one start must
            if number + 1 == starts and not found:
                raise
    best = min(found, key=lambda result: float(result.cost))
    same = sum(float(result.cost - best.cost) < SAME for result in found)
    x = best.x
    for number in range(ROUNDS):
        say(f"weights from what is left, round {number + 1} of {ROUNDS}")
        levels = levels_of(model, sections, problem.left(x), by_square)
        x = problem.search(x, problem.weights(x, levels), FINE).x
    return problem.result(x, levels, (starts, same))


class _Problem:
    """The sections with the model, evaluated at one x at a time."""

    def __init__(self, system: System, sections: Sequence[Section]) -> None:
        self._system, self._sections = system, sections
        self._commands = commands_of(system, sections)
        self.unknowns = unknowns_of(system, self._commands)
        self.bounds = np.full((2, self.unknowns.size), [[-np.inf], [np.inf]])
        for k, name in enumerate(system.parameters):
            p = system.model.parameters[name]
            for side, limit in enumerate((p.min, p.max)):
                if limit is not None and limit > 0:
                    self.bounds[side, k] = np.log(limit / p.value) / self.unknowns.priors[k]
        self._at: Array | None = None
        self._runs: list[Trajectory] = []

    def weights(self, x: Array, levels: Levels) -> list[Whitening]:
        """Those that hold at `x`."""
        return [
            Whitening(section, levels, disturbances(section, trajectory, self._commands))
            for section, trajectory in zip(self._sections, self._trajectories(x), strict=True)
        ]

    def search(self, x: Array, whitenings: Sequence[Whitening], tolerance: float) -> OptimizeResult:
        """The optimum near `x`."""

        def residual(x: Array) -> Array:
            return np.concatenate([*(white(e) for white, e in zip(whitenings, self.left(x), strict=True)), x])

        def slope(x: Array) -> Array:
            parts = [white(J) for white, J in zip(whitenings, self._slopes(x), strict=True)]
            return np.concatenate([*parts, np.eye(len(x))])

        return least_squares(residual, x, jac=slope, bounds=self.bounds, ftol=tolerance, xtol=1e-8, gtol=1e-10)

    def left(self, x: Array) -> list[Array]:
        """The differences y - y_hat of every section (N,)."""
        zero = self.unknowns.zero(x)
        found = []
        for section, trajectory in zip(self._sections, self._trajectories(x), strict=True):
            measured = [s.value - zero.get(name, 0.0) for name, s in section.samples.items()]
            found.append(np.concatenate(measured) - stacked(section, trajectory.outputs()))
        return found

    def _slopes(self, x: Array) -> list[Array]:
        """Their derivatives (N, n)."""
        unknowns, found = self.unknowns, []
        scale = np.array([*unknowns.theta(x).values()]) * unknowns.priors
        for section, trajectory in zip(self._sections, self._trajectories(x), strict=True):
            columns = [stacked(section, trajectory.by_parameters()) * scale]
            for name, sd in unknowns.zeros.items():
                parts = [np.full((len(s.t), 1), sd if other == name else 0.0) for other, s in section.samples.items()]
                columns.append(np.concatenate(parts))
            for name in unknowns.delays:
                u = trajectory.drive.inputs[:, self._system.inputs.index(name)]
                lost = -DELAY_S * np.gradient(u, section.drive.step_s)
                columns.append(stacked(section, trajectory.by_input(name, lost[:, None])))
            found.append(-np.concatenate(columns, axis=1))
        return found

    def _trajectories(self, x: Array) -> list[Trajectory]:
        if self._at is None or not np.array_equal(x, self._at):
            theta, delay = self.unknowns.theta(x), self.unknowns.delay(x)
            near: Sequence[Trajectory | None] = self._runs or [None] * len(self._sections)
            self._runs = [
                run(self._system, delayed(section, self._system, delay), theta, other)
                for section, other in zip(self._sections, near, strict=True)
            ]
            self._at = x.copy()
        return self._runs

    def result(self, x: Array, levels: Levels, starts: tuple[int, int]) -> Fit:
        """The fit at `x`."""
        information, scores = np.zeros((len(x), len(x))), []
        parts = zip(self._sections, self.weights(x, levels), self._slopes(x), self.left(x), strict=True)
        for section, whitening, J, e in parts:
            J, e = whitening(J), whitening(e)
            information += J.T @ J
            block = (np.concatenate([s.t for s in section.samples.values()]) / BLOCK_S).astype(int)
            scores += [J[block == k].T @ e[block == k] for k in np.unique(block)]
        prior = np.eye(len(x))
        covariance = np.linalg.inv(information + prior)
        between = np.array(scores).T @ np.array(scores) * len(scores) / (len(scores) - 1)
        scattered = np.diag(covariance @ (between + prior) @ covariance)
        inflation = np.sqrt(np.maximum(1.0, scattered / np.diag(covariance)))
        near = np.abs(self.bounds - x).min(axis=0)[: len(self._system.parameters)] < AT_BOUND
        return Fit(
            system=self._system,
            unknowns=self.unknowns,
            x=x,
            covariance=covariance * np.outer(inflation, inflation),
            information=information,
            levels=levels,
            starts=starts,
            at_bound=tuple(name for name, there in zip(self._system.parameters, near, strict=True) if there),
        )


def delayed(section: Section, system: System, delay: Mapping[str, float]) -> Drive:
    """The section's drive with the commands in `delay` acting so much later [s]."""
    inputs = section.drive.inputs.copy()
    for name, seconds in delay.items():
        k = system.inputs.index(name)
        inputs[:, k] = np.interp(section.t - seconds, section.t, inputs[:, k])
    return replace(section.drive, inputs=inputs)
