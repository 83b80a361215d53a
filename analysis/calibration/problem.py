"""A model's free run over sections as a function of all that a calibration does not know.

The unknowns are x = (xi, own, delays, lags), each N(0, 1) beforehand: the parameters theta within their bounds, value
* exp(prior * xi) or, for one that may be zero or negative, value + spread * xi; of every log its own conditions, which
are the sensors' zero errors and how far a parameter that drifts from one drive to the next is from its usual value; by
how much the commands act later than they are logged; and, where that is asked for, by how much later than it was
measured an output is.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import hypot
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult, least_squares

from faultline.analysis.calibration.noise import Weigh, commands_of, stacked
from faultline.analysis.calibration.sections import Section
from faultline.analysis.model import Parameter
from faultline.analysis.simulation import Drive, System, Trajectory, run
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

OWN_STEPS = 2
"""Of Gauss and Newton: a log's own conditions are small, and what they do is nearly linear."""

DELAY = 1.5
"""Periods. Prior standard deviation of a command's delay."""


SHORTEST = 1.0 / 64.0
"""Smallest step of the continuation from the expected x, as a part of the whole way; below it the run has failed."""

Runs = Sequence[tuple[Section, Trajectory]]
"""Every section, on the grid of a run, and the run."""


class Nuisance(NamedTuple):
    """What is of one recording: `zero` errors, `lag` [s] of outputs, `delay` [s] of commands.

    `drifted` are the values of parameters that differ from one drive to the next, by name.
    """

    zero: Mapping[str, float]
    lag: Mapping[str, float]
    delay: Mapping[str, float]
    drifted: Mapping[str, float] = MappingProxyType({})


class Unknowns(NamedTuple):
    """What is fitted, by name: `parameters`, each of the `logs`' own conditions, `delays` of inputs, output `lags`.

    A parameter is `values` * exp(`priors` * xi) + `spreads` * xi; one of prior and spread is zero. A log's own are the
    `zeros` of outputs and the `drifts`, standard deviations in parts of the value; those of `fixed` parameters, which
    are not fitted, start from the values there.
    """

    parameters: tuple[str, ...]
    values: Array
    priors: Array
    spreads: Array
    fixed: dict[str, float]
    zeros: dict[str, float]
    drifts: dict[str, float]
    logs: int
    delays: tuple[str, ...]
    lags: dict[str, float]
    period_s: float

    @property
    def size(self) -> int:
        """The length of x."""
        return int(self.own.stop) + len(self.delays) + len(self.lags)

    @property
    def own(self) -> slice:
        """Where in x the logs' own conditions are, log by log: every recording was zeroed anew, on another day."""
        width = len(self.zeros) + len(self.drifts)
        return slice(len(self.parameters), len(self.parameters) + self.logs * width)

    def theta(self, x: Array) -> dict[str, float]:
        """The values of the parameters that are fitted."""
        return {name: self.value(k, float(x[k])) for k, name in enumerate(self.parameters)}

    def value(self, k: int, xi: float) -> float:
        """The value of the parameter with the number `k`, so many standard deviations from what is expected."""
        return float(self.values[k] * np.exp(self.priors[k] * xi) + self.spreads[k] * xi)

    def usual(self, x: Array) -> dict[str, float]:
        """The values of all parameters that a system has as symbols, as they are when nothing has drifted."""
        return self.fixed | self.theta(x)

    def drifted(self, x: Array, log: int) -> dict[str, float]:
        """The values in a log of the parameters that drift."""
        usual, part = self.usual(x), x[self.own].reshape(self.logs, -1)[log, len(self.zeros) :]
        return {
            name: usual[name] * (1.0 + sd * value)
            for (name, sd), value in zip(self.drifts.items(), part.tolist(), strict=True)
        }

    def theta_by_x(self, x: Array) -> Array:
        """The derivative of every parameter to its own xi."""
        return self.values * np.exp(self.priors * x[: len(self.parameters)]) * self.priors + self.spreads

    def zero(self, x: Array, log: int | None = None) -> dict[str, float]:
        """The sensors' zero errors in a log, in their units; their means over all logs if none is said."""
        by_log = x[self.own].reshape(self.logs, -1)[:, : len(self.zeros)]
        part = by_log.mean(axis=0) if log is None else by_log[log]
        return {name: sd * value for (name, sd), value in zip(self.zeros.items(), part.tolist(), strict=True)}

    def delay(self, x: Array) -> dict[str, float]:
        """The commands' delays [s]."""
        begin = self.own.stop
        part = DELAY * self.period_s * x[begin : begin + len(self.delays)]
        return dict(zip(self.delays, part.tolist(), strict=True))

    def lag(self, x: Array) -> dict[str, float]:
        """The outputs' lags [s]."""
        part = np.array([*self.lags.values()]) * x[self.size - len(self.lags) :]
        return dict(zip(self.lags, part.tolist(), strict=True))

    def nuisance(self, x: Array, log: int = 0) -> Nuisance:
        """All but the parameters, in a log."""
        return Nuisance(self.zero(x, log), self.lag(x), self.delay(x), self.drifted(x, log))


def unknowns_of(system: System, commands: tuple[str, ...], logs: int, lags: tuple[str, ...]) -> Unknowns:
    """The unknowns of a system whose symbols are `varying` parameters of its model; `lags` are outputs that may lag."""
    model = system.model
    fitted = tuple(name for name in system.parameters if name in set(model.calibrated))
    chosen = [model.parameters[name] for name in fitted]
    return Unknowns(
        parameters=fitted,
        values=np.array([p.value for p in chosen]),
        priors=np.array([p.prior or 0.0 for p in chosen]),
        spreads=np.array([p.spread or 0.0 for p in chosen]),
        fixed={name: model.parameters[name].value for name in system.parameters if name not in fitted},
        zeros={name: sd for name in system.outputs if (sd := hypot(model.known[name].zero, model.known[name].drift))},
        drifts={name: sd for name in system.parameters if (sd := model.parameters[name].drift)},
        logs=logs,
        delays=commands,
        lags={name: model.lag_s(name) for name in lags},
        period_s=model.period_s,
    )


def _bounds(parameter: Parameter) -> list[float]:
    """Of xi."""
    found = []
    for limit, none in ((parameter.min, -np.inf), (parameter.max, np.inf)):
        if limit is None or (parameter.prior is not None and limit <= 0.0):
            found.append(none)
        elif parameter.prior is not None:
            found.append(float(np.log(limit / parameter.value)) / parameter.prior)
        else:
            found.append((limit - parameter.value) / (parameter.spread or 1.0))
    return found


class Problem:
    """The sections with the model, evaluated at one x at a time.

    `bounds` (2, n) are the lower and upper limits of x; with `lagging`, how much the outputs lag is unknown too.
    Which inputs are `commands` the sections tell, or other sections, whose x shall hold for these as well.
    """

    def __init__(
        self,
        system: System,
        sections: Sequence[Section],
        *,
        lagging: bool = False,
        commands: tuple[str, ...] | None = None,
    ) -> None:
        self.system, self.sections = system, sections
        self.commands = commands_of(system, sections) if commands is None else commands
        self._log = np.cumsum([section.number == 0 for section in sections]) - 1
        lags = tuple(system.outputs) if lagging else ()
        self.unknowns = unknowns_of(system, self.commands, int(self._log[-1]) + 1, lags)
        self.bounds = np.full((2, self.unknowns.size), [[-np.inf], [np.inf]])
        for k, name in enumerate(self.unknowns.parameters):
            self.bounds[:, k] = _bounds(system.model.parameters[name])
        self._at: Array | None = None
        self._runs: list[Trajectory] = []

    def search(self, x: Array, whitenings: Sequence[Weigh], tolerance: float) -> OptimizeResult:
        """The optimum near `x`.

        Raises:
            InputError: the model cannot be run at `x`.
        """
        count = len(x) + len(np.concatenate([white(e) for white, e in zip(whitenings, self.left(x), strict=True)]))

        def residual(x: Array) -> Array:
            try:
                left = self.left(x)
            except InputError:  # too far: what is not finite makes the trust region smaller
                return np.full(count, np.inf)
            return np.concatenate([*(white(e) for white, e in zip(whitenings, left, strict=True)), x])

        def slope(x: Array) -> Array:
            parts = [white(J) for white, J in zip(whitenings, self.slopes(x), strict=True)]
            return np.concatenate([*parts, np.eye(len(x))])

        return least_squares(residual, x, jac=slope, bounds=self.bounds, ftol=tolerance, xtol=1e-8, gtol=1e-10)

    def left(self, x: Array, runs: Runs | None = None) -> list[Array]:
        """The differences y - y_hat of every section (N,), of its run at x or of another."""
        lag, found = self.unknowns.lag(x), []
        for log, (section, trajectory) in zip(self._log, self._pairs(x, runs), strict=True):
            zero = self.unknowns.zero(x, log)
            measured = [s.value - zero.get(name, 0.0) for name, s in section.samples.items()]
            found.append(np.concatenate(measured) - stacked(section, trajectory.outputs(), lag))
        return found

    def slopes(self, x: Array, runs: Runs | None = None) -> list[Array]:
        """Their derivatives (N, n)."""
        unknowns, found = self.unknowns, []
        scale, lag, usual = unknowns.theta_by_x(x), unknowns.lag(x), unknowns.usual(x)
        place = {name: k for k, name in enumerate(self.system.parameters)}
        fitted, drifting = ([place[name] for name in names] for names in (unknowns.parameters, unknowns.drifts))
        size = np.array([sd * usual[name] for name, sd in unknowns.drifts.items()])
        for log, (section, trajectory) in zip(self._log, self._pairs(x, runs), strict=True):
            by_parameter = stacked(section, trajectory.by_parameters(), lag)
            columns = [by_parameter[:, fitted] * scale]
            for other in range(unknowns.logs):
                columns += [_of_output(section, name, sd * (other == log)) for name, sd in unknowns.zeros.items()]
                columns.append(by_parameter[:, drifting] * size * (other == log))
            for name in unknowns.delays:
                u = trajectory.drive.inputs[:, self.system.inputs.index(name)]
                lost = -DELAY * unknowns.period_s * np.gradient(u, section.drive.step_s)
                columns.append(stacked(section, trajectory.by_input(name, lost[:, None]), lag))
            rates = {name: np.gradient(y, section.drive.step_s) for name, y in trajectory.outputs().items()}
            rate = stacked(section, rates, lag)[:, None]
            columns += [rate * _of_output(section, name, -lag_s) for name, lag_s in unknowns.lags.items()]
            found.append(-np.concatenate(columns, axis=1))
        return found

    def _pairs(self, x: Array, runs: Runs | None) -> Runs:
        return [*zip(self.sections, self.trajectories(x), strict=True)] if runs is None else runs

    def parameters(self, x: Array) -> list[dict[str, float]]:
        """The parameters of every section, by name."""
        usual = self.unknowns.usual(x)
        return [usual | self.unknowns.drifted(x, log) for log in self._log]

    def trajectories(self, x: Array) -> list[Trajectory]:
        """The free runs of every section."""
        if self._at is None or not np.array_equal(x, self._at):
            self._runs = self._run(x, self._runs)
            self._at = x.copy()
        return self._runs

    def _run(self, x: Array, near: Sequence[Trajectory]) -> list[Trajectory]:
        """Run freely at x, from other runs; without any, and where that fails, by continuation from the expected x."""
        try:
            return self._run_near(x, near)
        except InputError:
            if near:
                raise
        found, part, step = self._run_near(0.0 * x, ()), 0.0, 0.5
        while part < 1.0:
            try:
                found = self._run_near((part + step) * x, found)
            except InputError:
                step /= 2.0
                if step < SHORTEST:
                    raise
            else:
                part += step
        return found

    def _run_near(self, x: Array, near: Sequence[Trajectory]) -> list[Trajectory]:
        return runs(self.system, self.sections, self.parameters(x), self.unknowns.delay(x), near)


def carried(x: Array, old: Unknowns, new: Unknowns) -> Array:
    """The same x for a model with other parameters, or for other logs; what is new is as expected beforehand."""
    found = np.zeros(new.size)
    place = {name: k for k, name in enumerate(old.parameters)}
    for k, name in enumerate(new.parameters):
        if name in place:
            found[k] = x[place[name]]
    found[new.own.stop :] = x[old.own.stop :]
    if old.logs == new.logs:  # with another number of logs they are others, with conditions of their own
        found[new.own] = x[old.own]
    return found


def with_own(problem: Problem, x: Array, weigh: Callable[[Sequence[Array]], Array]) -> Array:
    """Return x with the logs' own conditions as the sections show them, all else as it is.

    `weigh` makes the differences of all sections, (N, ...) each, unit independent noise (M, ...).
    """
    x, own = x.copy(), problem.unknowns.own
    x[own] = 0.0
    for _ in range(OWN_STEPS):
        J, e = weigh(problem.slopes(x))[:, own], weigh(problem.left(x))
        x[own] -= np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ e + x[own])
    return x


def _of_output(section: Section, name: str, value: float) -> Array:
    """A column (N, 1) that has the value where the samples of one output are, and zero elsewhere."""
    parts = [np.full((len(s.t), 1), value if other == name else 0.0) for other, s in section.samples.items()]
    return np.concatenate(parts)


def runs(
    system: System,
    sections: Sequence[Section],
    theta: Sequence[Mapping[str, float]],
    delay: Mapping[str, float],
    near: Sequence[Trajectory] = (),
) -> list[Trajectory]:
    """The free runs of the sections, each with its parameters, and delays of commands [s]; `near` may be close to them.

    A state that no sensor shows goes on where the section of the same log before left it, at the rate it had there.

    Raises:
        InputError: the model cannot be run with them.
    """
    found: list[Trajectory] = []
    for k, section in enumerate(sections):
        drive = delayed(section, system, delay)
        if section.number and system.unseen:
            drive = replace(drive, start=_continued(system, found[-1], sections[k - 1], section))
        found.append(run(system, drive, theta[k], near[k] if near else None))
    return found


def _continued(system: System, before: Trajectory, old: Section, new: Section) -> Array:
    start, unseen = new.drive.start.copy(), list(system.unseen)
    first, last = before.w[0, unseen], before.w[-1, unseen]
    rate = (last - first) / old.t[-1]
    start[unseen] = last + rate * (new.start_s - old.start_s - old.t[-1])
    return start


def delayed(section: Section, system: System, delay: Mapping[str, float]) -> Drive:
    """The section's drive with the commands in `delay` acting so much later [s]."""
    inputs = section.drive.inputs.copy()
    for name, seconds in delay.items():
        k = system.inputs.index(name)
        inputs[:, k] = np.interp(section.t - seconds, section.t, inputs[:, k])
    return replace(section.drive, inputs=inputs)
