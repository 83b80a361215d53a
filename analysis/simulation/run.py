"""Solves a system over a whole recording at once, and its derivatives with it.

On a uniform grid of step h the derivatives are backward differences: the first step by Euler's, the rest by the second
order's (BDF2, Gear 1971: stable for stiff systems as the thesis's ode15s is, of which it is the fixed-step member)

    d_k = (3 s_k - 4 s_{k-1} + s_{k-2}) / 2h

All instants are solved together by Newton's method. An instant knows the states of the two before it and nothing else
of them, so that its own equations are solved first, as arrays over time (see `instants`); what is left is a triangular
band in the states. The same two steps give the exact derivatives of the trajectory to parameters and inputs (implicit
function theorem), one column each. `docs/decisions/006-free-run-at-once.md` has it beside scipy's solvers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dtbtrs

from faultline.analysis.simulation.instants import Entries, UndeterminedError, solved
from faultline.analysis.simulation.system import Jacobian, System
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

MAXIMUM_STEPS = 40
TOLERANCE = 1e-9
"""Relative to the size of a variable: the last step of Newton's method."""

NEAR, AHEAD = 1e-6, 1e-12
"""A step so short is the last too, if the next, by how the steps' squares go (step**3 / before**2), is below `AHEAD`.

The first is for kinks, where squares say nothing: what a sensor shows has noise a hundred times as large.
"""


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
        added = _entries(self.system.by_parameter, self._arguments)
        return self._outputs(added, len(self.system.parameters), 1.0, self._shown("parameters"))

    def by_input(self, name: str, directions: Array) -> dict[str, Array]:
        """The derivatives (K, D) of the outputs to D disturbances (K, D) that are added to the input `name`."""
        k = self.system.inputs.index(name)
        added = {(i, 0): value for (i, j), value in _entries(self.system.by_input, self._arguments).items() if j == k}
        direct = {y: slope[:, k, None] * directions for y, slope in self._shown("inputs").items()}
        return self._outputs(added, 1, directions[1:].T, direct)

    def _outputs(self, added: Entries, width: int, times: Array | float, direct: dict[str, Array]) -> dict[str, Array]:
        """With what is `added` to the equations, see `_Change`, and what shows `direct` (K, D) without them."""
        change = _Change(self.system, self._arguments, self.drive.step_s, self.w, added, width, times)
        names = list(self.system.outputs)
        found = {y: np.array(value.T, order="C") for y, value in direct.items()}
        for (i, j), slope in _entries(self.system.shown_by["variables"], self._arguments).items():
            found[names[i]][:, 1:] += slope * change.of(j)
        for (i, j), slope in _entries(self.system.shown_by["derivatives"], self._arguments).items():
            moved = np.zeros_like(found[names[i]])
            moved[:, 1:] = change.of(j)
            found[names[i]][:, 1:] += slope * _rates(moved.T, self.drive.step_s)[1:].T
        return {y: np.ascontiguousarray(value.T) for y, value in found.items()}

    def _shown(self, to: str) -> dict[str, Array]:
        """The outputs' own derivatives (K, ...), by what they are to (see `System.shown_by`)."""
        found = self.system.shown_by[to](len(self.w), self._arguments)
        return dict(zip(self.system.outputs, found.swapaxes(0, 1), strict=True))

    @cached_property
    def _arguments(self) -> list[Array | float]:
        return _arguments(self.system, self.drive, self.parameters, self.w)


def run(system: System, drive: Drive, parameters: Mapping[str, float], near: Trajectory | None = None) -> Trajectory:
    """The trajectory with these values of the system's parameters; `near` is one that may be close to it.

    Raises:
        InputError: there is no solution near the guess.
    """
    w = np.asfortranarray(_guess(system, drive, parameters) if near is None else near.w)  # variable by variable
    before = np.inf
    for _ in range(MAXIMUM_STEPS):
        with np.errstate(over="ignore", invalid="ignore"):  # a search that runs away ends with what is not finite
            step = _step(system, drive, parameters, w)
            w = w + step
            size = (np.abs(step).max(axis=0) / np.maximum(np.abs(w).max(axis=0), 1e-300)).max()
        if not np.isfinite(w).all():
            break
        if size <= TOLERANCE or (size <= NEAR and size**3 <= AHEAD * before**2):
            return Trajectory(system, drive, dict(parameters), w)
        before = size
    raise InputError(f"{system.model.name}: no free run is found; check the parameters and what the inputs do")


def _step(system: System, drive: Drive, parameters: Mapping[str, float], w: Array) -> Array:
    """Newton's (K, n)."""
    arguments = _arguments(system, drive, parameters, w)
    left = {(i, 0): _later(value) for i, value in enumerate(system.value(*arguments))}
    change = _Change(system, arguments, drive.step_s, w, left, 1)
    step = np.zeros_like(w)
    for j in range(w.shape[1]):
        step[1:, j] = change.of(j)[0]
    return step


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


def _entries(jacobian: Jacobian, arguments: list[Array | float]) -> dict[tuple[int, int], float | Array]:
    """For the instants from 1 on."""
    values = jacobian.entries(*arguments)
    return {place: _later(value) for place, value in zip(jacobian.places, values, strict=True)}


def _later(value: Array | float) -> Array | float:
    """From instant 1 on."""
    return value[1:] if isinstance(value, np.ndarray) and value.ndim else value


class _Change:
    """How the variables change with D columns that are `added` to the equations, for the instants from 1 on.

    At every instant the equations give, once solved for all of its variables,

        w_k = here_k - by_past_k past_k,    past_k = -2 s_{k-1} + s_{k-2} / 2

    of which the states' part is a triangular matrix whose band holds three instants: solving it is all that goes from
    one instant to the next.
    """

    def __init__(
        self,
        system: System,
        arguments: list[Array | float],
        step_s: float,
        w: Array,
        added: Entries,
        width: int,
        times: Array | float = 1.0,
    ) -> None:
        """What is added is `added` (n, width) `times` (D, K - 1): of the two, one at most has more than one column."""
        self._states, count = len(system.states), len(w) - 1
        lead = np.full(count, 1.5 / step_s)
        lead[0] = 1.0 / step_s
        now = _entries(system.by_variable, arguments)
        right = {(i, self._states + column): -value for (i, column), value in added.items()}
        for (i, j), value in _entries(system.by_derivative, arguments).items():
            now[i, j] = now.get((i, j), 0.0) + lead * value
            right[i, j] = value / step_s
        size = np.abs(w).max(axis=0)
        try:
            found = solved(now, right, np.where(size > 0.0, size, 1.0), (self._states + width, count))
        except UndeterminedError as error:
            raise InputError(
                f"{system.model.name}: the equations do not determine {system.variables[error.column]}; "
                "check them, and that the model is of index 1"
            ) from None
        self._by_past, self._here, self._times = found[:, : self._states], found[:, self._states :], times
        self._moved = self._solved()

    def of(self, j: int) -> Array:
        """The change (D, K - 1) of a variable."""
        if j < self._states:
            return np.asarray(self._moved[:, :, j])
        change: Array = self._here[j] * self._times
        for by_past, past in zip(self._by_past[j], self._past, strict=True):
            change = change - by_past * past
        return change

    @cached_property
    def _past(self) -> list[Array]:
        """By state (D, K - 1)."""
        found = np.zeros_like(self._moved)
        found[:, 1:] = -2.0 * self._moved[:, :-1]
        found[:, 2:] += 0.5 * self._moved[:, :-2]
        return [found[:, :, i] for i in range(self._states)]

    def _solved(self) -> Array:
        """The states' changes (D, K - 1, states)."""
        n, count = self._states, self._by_past.shape[2]
        band = np.zeros((count, n, 3 * n))  # by column of the matrix, from its diagonal down
        for i in range(n):
            for j in range(n):
                band[:-1, j, n + i - j] = -2.0 * self._by_past[i, j, 1:]
                band[:-2, j, 2 * n + i - j] = 0.5 * self._by_past[i, j, 2:]
        here = np.stack([here * self._times for here in self._here[:n]], axis=-1)
        if not len(here):
            return here  # without columns, dtbtrs (scipy 1.17's OpenBLAS) writes outside of what it is given
        right = here.reshape(len(here), count * n).T
        found, _ = dtbtrs(band.reshape(count * n, 3 * n).T, right, uplo="L", diag="U", overwrite_b=True)
        return np.asarray(found.T.reshape(here.shape))
