"""Maximum a posteriori calibration with the generators' own graph.

The parameters theta = value * exp(prior * xi), xi ~ N(0, 1), minimise

    sum_b,t ( mean_b(r_t) / w_tc )^2 + sum xi^2

over blocks b of 5 s in a steady mode c and over numerically independent tests t, chosen anew with the fitted parameters
until the choice stands. The weight w_tc is the RMS of the
block means of test and mode after a first fit, so that what the model cannot do counts as spread and does not bend
parameters. Block means, because the valve's ripple is no information and its samples are not independent. Gauss-Newton
with Levenberg's damping (scipy); the whole Jacobian is one batch through the graph.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from analysis.graph.bank import Bank
from analysis.graph.independence import independent
from service.core.errors import InputError
from service.core.manifest import MODES
from service.core.modes import EDGE
from service.core.observer import Tick

Array = npt.NDArray[np.float64]

BLOCK_TICKS = 25
STEP = 1e-3  # of xi, for the Jacobian
MINIMUM_BLOCKS = 20
TOLERANCE = 1e-4  # relative change of the cost at which the fit ends


@dataclass(frozen=True)
class Fit:
    """The result: value and spread of the logarithm per parameter, RMS of the tests' block means [unit of y].

    The spread takes the blocks for independent, which they are not quite: on made drives it was 1.3 to 1.7 times too
    small.
    """

    values: dict[str, float]
    spread: dict[str, float]
    rms: dict[str, float]
    blocks: int


def fit(bank: Bank, ticks: list[Tick], where: str, progress: Callable[[str], None]) -> Fit:
    """Calibrates the parameters that have a prior, on a fault-free recording seen as `ticks`.

    Raises:
        InputError: the recording has fewer than 20 steady blocks, or the model has no parameter with a prior.
    """
    free = {name: p for name, p in bank.model.parameters.items() if p.prior is not None}
    if not free:
        raise InputError(f"{bank.model.name}: no parameter has a prior; give `prior` to those that shall be calibrated")
    data = _blocks(ticks)
    if len(data.blocks) < MINIMUM_BLOCKS:
        raise InputError(
            f"{where}: only {len(data.blocks)} steady blocks of 5 s; record some minutes within the operating ranges"
        )
    values = np.array([p.value for p in free.values()])
    priors = np.array([p.prior for p in free.values()], dtype=np.float64)

    def residuals(of: Bank, xi: Array) -> Array:
        """Residuals (K, batch, T) for a batch of xi (batch, P)."""
        trials = [dict(zip(free, values * np.exp(priors * row), strict=True)) for row in xi]
        return of.simulate(trials, data.z, of.start(data.z[0]))

    def means(of: Bank, xi: Array) -> Array:
        """Block means (batch, blocks, T)."""
        r = residuals(of, xi)
        return np.array([r[block].mean(axis=0) for block in data.blocks]).swapaxes(0, 1)

    xi = np.zeros(len(free))
    rows = independent(np.array([tick.residuals.r for tick in ticks if tick.residuals.usable.all()]))
    tried: list[list[int]] = []
    while (
        rows not in tried
    ):  # what a wrong parameter does to all tests alike hides, before the fit, what each one knows
        tried.append(rows)
        used = bank.only(rows)
        weight = np.tile(used.sigma, (len(data.blocks), 1))
        for title in ("first fit", "second fit"):
            xi = _solve(partial(means, used), xi, weight, partial(_say, progress, title))
            left = means(used, xi[None])[0]
            weight = _spread(left, data.modes, used.sigma)
        rows = independent(residuals(bank, xi[None])[data.told, 0])
    J = _jacobian(partial(means, used), xi, weight)
    return Fit(
        values=dict(zip(free, (values * np.exp(priors * xi)).tolist(), strict=True)),
        spread=dict(zip(free, (priors * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))).tolist(), strict=True)),
        rms=dict(zip((t.name for t in used.tests), np.sqrt((left**2).mean(axis=0)).tolist(), strict=True)),
        blocks=len(data.blocks),
    )


def _say(progress: Callable[[str], None], title: str, cost: float) -> None:
    progress(f"{title}: cost {cost:.1f}")


class _Data(NamedTuple):
    """Samples z (K, nz), at which of them all tests told (K,), the runs of 25 in one steady mode, the mode of each."""

    z: Array
    told: npt.NDArray[np.bool_]
    blocks: list[slice]
    modes: npt.NDArray[np.int64]


def _blocks(ticks: Sequence[Tick]) -> _Data:
    z = np.array([tick.z for tick in ticks])
    good = next((k for k, tick in enumerate(ticks) if tick.usable.all()), len(ticks))
    mode = np.array([tick.mode if tick.residuals.usable.all() else EDGE for tick in ticks])
    blocks, modes = [], []
    start = good
    while start + BLOCK_TICKS <= len(ticks):
        if mode[start] != EDGE and (mode[start : start + BLOCK_TICKS] == mode[start]).all():
            blocks.append(slice(start - good, start - good + BLOCK_TICKS))
            modes.append(mode[start])
            start += BLOCK_TICKS
        else:
            start += 1
    told = np.array([tick.residuals.usable.all() for tick in ticks[good:]], dtype=np.bool_)
    return _Data(z[good:], told, blocks, np.array(modes))


def _spread(left: Array, modes: npt.NDArray[np.int64], floor: Array) -> Array:
    """The weight of every block mean (blocks, T): the RMS of its test in its mode, at least a tenth of the sensor's."""
    weight = np.empty_like(left)
    for mode in range(len(MODES)):
        inside = modes == mode
        if inside.any():
            weight[inside] = np.maximum(np.sqrt((left[inside] ** 2).mean(axis=0)), floor / 10)
    return weight


def _solve(means: Callable[[Array], Array], start: Array, weight: Array, progress: Callable[[float], None]) -> Array:
    """One weighted fit."""

    def residual(xi: Array) -> Array:
        value = np.concatenate([(means(xi[None])[0] / weight).ravel(), xi])
        progress(float(value @ value))
        return value

    fitted = least_squares(residual, start, jac=lambda xi: _jacobian(means, xi, weight), method="lm", ftol=TOLERANCE)
    solution: Array = fitted.x
    return solution


def _jacobian(means: Callable[[Array], Array], xi: Array, weight: Array) -> Array:
    """Central differences of the weighted block means and of the prior, (blocks * T + P, P), as one batch."""
    steps = STEP * np.eye(len(xi))
    both = means(np.concatenate([xi + steps, xi - steps]))
    slope = (both[: len(xi)] - both[len(xi) :]) / (2 * STEP)
    return np.vstack([(slope / weight).reshape(len(xi), -1).T, np.eye(len(xi))])
