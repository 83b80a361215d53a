"""Solves a system over a whole recording at once, and its derivatives with it.

On a uniform grid of step h the derivatives are backward differences: the first step by Euler's, the rest by the second
order's (BDF2, Gear 1971: stable for stiff systems as the thesis's ode15s is, of which it is the fixed-step member)

    d_k = (3 s_k - 4 s_{k-1} + s_{k-2}) / 2h

All instants are solved together by Newton's method. Its matrix is banded, as an instant knows the two before it only,
so that a step costs one sweep of LAPACK's band solver and the model's functions are evaluated as arrays over time. The
same factors give the exact derivatives of the trajectory to parameters and inputs (implicit function theorem), one
column each. `docs/decisions/006-free-run-at-once.md` has it beside scipy's solvers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dgbtrf, dgbtrs

from analysis.simulation.system import System
from service.core.errors import InputError

Array = npt.NDArray[np.float64]

MAXIMUM_STEPS = 40
TOLERANCE = 1e-9
"""Relative to the size of a variable: the last step of Newton's method."""


@dataclass(frozen=True)
class Drive:
    """What drives a run: `inputs` (K, inputs) in the system's order at the instants k h, and the states' values before.

    `start` (states) is the state at instant 0; `guess` (K, states) is where the states are looked for first.
    """

    step_s: float
    inputs: Array
    start: Array
    guess: Array


@dataclass(frozen=True)
class Trajectory:
    """A solved run: `w` (K, n) are the system's variables at the instants; at instant 0 the states are as given."""

    system: System
    drive: Drive
    parameters: Mapping[str, float]
    w: Array

    def outputs(self) -> dict[str, Array]:
        """The outputs (K,) by signal."""
        values = self.system.shown(*self._arguments)
        return {y: np.broadcast_to(value, len(self.w)) for y, value in zip(self.system.outputs, values, strict=True)}

    def by_parameters(self) -> dict[str, Array]:
        """The derivatives (K, parameters) of the outputs."""
        effect = self.system.by_parameter(len(self.w), self._arguments)
        return self._outputs(-effect[1:], self._shown("parameters"))

    def by_input(self, name: str, directions: Array) -> dict[str, Array]:
        """The derivatives (K, D) of the outputs to D disturbances (K, D) that are added to the input `name`."""
        k = self.system.inputs.index(name)
        effect = self.system.by_input(len(self.w), self._arguments)[:, :, k, None] * directions[:, None]
        direct = {y: slope[:, k, None] * directions for y, slope in self._shown("inputs").items()}
        return self._outputs(-effect[1:], direct)

    def _outputs(self, right: Array, direct: dict[str, Array]) -> dict[str, Array]:
        moved = np.zeros((len(self.w), self.w.shape[1], right.shape[2]))
        moved[1:] = self._band.solve(right)
        rates = _rates(moved[:, : len(self.system.states)], self.drive.step_s)
        through, by_rate = self._shown("variables"), self._shown("derivatives")
        return {
            y: np.einsum("kn,knd->kd", through[y], moved) + np.einsum("kn,knd->kd", by_rate[y], rates) + direct[y]
            for y in self.system.outputs
        }

    def _shown(self, to: str) -> dict[str, Array]:
        """The outputs' own derivatives (K, ...), by what they are to (see `System.shown_by`)."""
        found = self.system.shown_by[to](len(self.w), self._arguments)
        return dict(zip(self.system.outputs, found.swapaxes(0, 1), strict=True))

    @cached_property
    def _arguments(self) -> list[Array | float]:
        return _arguments(self.system, self.drive, self.parameters, self.w)

    @cached_property
    def _band(self) -> "_Band":
        return _Band(self.system, self._arguments, self.drive.step_s, self.w)


def run(system: System, drive: Drive, parameters: Mapping[str, float], near: Trajectory | None = None) -> Trajectory:
    """The trajectory with these values of the system's parameters; `near` is one that may be close to it.

    Raises:
        InputError: there is no solution near the guess.
    """
    w = _guess(system, drive, parameters) if near is None else near.w
    for _ in range(MAXIMUM_STEPS):
        arguments = _arguments(system, drive, parameters, w)
        value = np.column_stack([np.broadcast_to(v, len(w)) for v in system.value(*arguments)])
        step = np.zeros_like(w)
        step[1:] = _Band(system, arguments, drive.step_s, w).solve(-value[1:, :, None])[:, :, 0]
        w = w + step
        if not np.isfinite(w).all():
            break
        if (np.abs(step).max(axis=0) <= TOLERANCE * np.abs(w).max(axis=0)).all():
            return Trajectory(system, drive, dict(parameters), w)
    raise InputError(f"{system.model.name}: no free run is found; check the parameters and what the inputs do")


def _guess(system: System, drive: Drive, parameters: Mapping[str, float]) -> Array:
    """The states as guessed, algebraic variables zero, roots from their arguments."""
    w = np.zeros((len(drive.inputs), len(system.variables)))
    w[:, : len(system.states)] = drive.guess
    w[0, : len(system.states)] = drive.start
    for symbol, argument in zip(system.roots, system.root_arguments, strict=True):
        [value] = argument(*_arguments(system, drive, parameters, w))
        w[:, system.variables.index(symbol)] = np.sign(value) * np.sqrt(np.abs(value))
    return w


def _arguments(system: System, drive: Drive, parameters: Mapping[str, float], w: Array) -> list[Array | float]:
    d = _rates(w[:, : len(system.states)], drive.step_s)
    return [*w.T, *d.T, *drive.inputs.T, *(parameters[name] for name in system.parameters)]


def _rates(s: Array, step_s: float) -> Array:
    """The derivatives of (K, ...), zero at instant 0."""
    d = np.zeros_like(s)
    d[1:] = np.diff(s, axis=0)
    d[2:] = 1.5 * d[2:] - 0.5 * d[1:-1]
    return np.asarray(d / step_s)


class _Band:
    """The factors of Newton's matrix for the instants from 1 on."""

    def __init__(self, system: System, arguments: list[Array | float], step_s: float, w: Array) -> None:
        count, n = w.shape
        by_derivative = system.by_derivative(count, arguments)[1:] / step_s  # (K - 1, n, states)
        now = system.by_variable(count, arguments)[1:]
        lead = np.full((count - 1, 1, 1), 1.5)
        lead[0] = 1.0
        states = slice(0, len(system.states))
        now[:, :, states] += lead * by_derivative
        before = np.zeros_like(now)
        before[:, :, states] = np.where(lead > 1.0, -2.0, -1.0) * by_derivative
        earlier = np.zeros_like(now)
        earlier[:, :, states] = np.where(lead > 1.0, 0.5, 0.0) * by_derivative
        size = np.abs(w).max(axis=0)
        self._columns = np.where(size > 0.0, size, 1.0)
        now, before, earlier = now * self._columns, before * self._columns, earlier * self._columns
        self._rows = 1.0 / np.maximum(np.abs(now).max(axis=2), 1e-300)  # (K - 1, n)
        self._lower, self._upper = 3 * n - 1, n - 1
        self._shape = (count - 1, n)
        band = np.zeros((2 * self._lower + self._upper + 1, (count - 1) * n))
        middle = self._lower + self._upper
        for back, block in enumerate((now, before, earlier)):
            scaled = block * self._rows[:, :, None]
            for i in range(n):
                for j in range(n):
                    columns = np.arange(count - 1 - back) * n + j
                    band[middle + back * n + i - j, columns] = scaled[back:, i, j]
        self._factors, self._pivots, failed = dgbtrf(band, self._lower, self._upper, overwrite_ab=True)
        if failed:
            raise InputError(
                f"{system.model.name}: the equations do not determine {system.variables[(failed - 1) % n]}; "
                "check them, and that the model is of index 1"
            )

    def solve(self, right: Array) -> Array:
        """The solution for right hand sides (K - 1, n, D)."""
        scaled = (right * self._rows[:, :, None]).reshape(-1, right.shape[2])
        found, _ = dgbtrs(self._factors, self._lower, self._upper, scaled, self._pivots)
        solution: Array = found.reshape(*self._shape, -1) * self._columns[None, :, None]
        return solution
