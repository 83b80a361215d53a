"""What the data can tell of the parameters, and what only the datasheet does.

In directions of the parameters' space in which the data say less than the prior, the prior decides. Where such a
direction has several parameters (the flow scale: pressures alone cannot tell it), the one whose prior is tightest
is the *anchor*: the others are known relative to it.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.fit import Fit

Array = npt.NDArray[np.float64]

TELLS = 1.0
"""Of the prior's information: data that say more tell the parameter."""

INVOLVED = 0.1
"""A share of the largest change from which a parameter belongs to a direction."""

VAGUE = 1.0
"""The prior, as of a logarithm, of a parameter that may be zero: others are rather taken as anchors."""

QUANTILE = 2.09
"""Of Student's distribution, for 95 %: the standard errors rest on some twenty blocks."""


@dataclass(frozen=True)
class Estimate:
    """A parameter: value; standard deviation of its logarithm by itself, and with the anchors as they are.

    `told` says whether the data, not the prior, give it (with the anchors as they are). One that may be zero or
    negative is `absolute`: its standard deviations are its own, in its unit.
    """

    value: float
    spread: float
    relative_spread: float
    told: bool
    absolute: bool = False

    def interval(self, spread: float) -> tuple[float, float]:
        """The 95 % interval for one of the spreads."""
        if self.absolute:
            return self.value - QUANTILE * spread, self.value + QUANTILE * spread
        return self.value * float(np.exp(-QUANTILE * spread)), self.value * float(np.exp(QUANTILE * spread))


@dataclass(frozen=True)
class Identified:
    """All parameters by name; `anchors` with the parameters known relative to each; told pairs' correlation."""

    estimates: dict[str, Estimate]
    anchors: dict[str, tuple[str, ...]]
    correlated: tuple[tuple[str, str, float], ...]


def identify(fit: Fit) -> Identified:
    """What a fit tells of every parameter."""
    names, scales = fit.unknowns.parameters, fit.unknowns.priors + fit.unknowns.spreads  # one of the two is zero
    anchors = _anchors(fit)
    n = len(names)
    whole = np.sqrt(np.diag(fit.covariance))[:n]
    free = [k for k in range(len(fit.x)) if k >= n or names[k] not in anchors]
    conditional = np.linalg.inv(np.linalg.inv(fit.covariance)[np.ix_(free, free)])
    relative = np.zeros(n)
    for place, k in enumerate(free):
        if k < n:
            relative[k] = np.sqrt(conditional[place, place])
    estimates = {
        name: Estimate(
            value=fit.values[name],
            spread=float(whole[k] * scales[k]),
            relative_spread=float(relative[k] * scales[k]),
            told=bool(relative[k] ** 2 < 1.0 / (1.0 + TELLS)) and name not in anchors,
            absolute=bool(fit.unknowns.spreads[k] > 0.0),
        )
        for k, name in enumerate(names)
    }
    sd = np.sqrt(np.diag(conditional))
    inside = [(place, names[k]) for place, k in enumerate(free) if k < n and estimates[names[k]].told]
    correlated = [
        (first, second, float(conditional[a, b] / sd[a] / sd[b])) for (a, first), (b, second) in combinations(inside, 2)
    ]
    return Identified(estimates, anchors, tuple(correlated))


def _anchors(fit: Fit) -> dict[str, tuple[str, ...]]:
    names = fit.unknowns.parameters
    priors = np.where(fit.unknowns.spreads > 0.0, VAGUE, fit.unknowns.priors)
    n = len(names)
    own, other = slice(0, n), slice(n, None)
    nuisance = fit.information[other, other] + np.eye(len(fit.x) - n)
    cross = fit.information[own, other]
    power, directions = np.linalg.eigh(fit.information[own, own] - cross @ np.linalg.solve(nuisance, cross.T))
    left = directions[:, power < TELLS] * priors[:, None]  # logarithms of the parameters
    anchors = {}
    for k in np.argsort(priors, kind="stable"):
        if left.shape[1] == 0:
            break
        reach = np.linalg.norm(left[k]) / max(np.linalg.norm(left, axis=1).max(), 1e-300)
        if reach < INVOLVED:
            continue
        moved = left @ left[k]  # the direction that moves it most, the rest without it
        others = tuple(names[i] for i in range(n) if i != k and abs(moved[i]) > INVOLVED * np.abs(moved).max())
        if others:
            anchors[names[k]] = others
        basis = np.linalg.svd(left[k : k + 1])[2][1:].T
        left = left @ basis
    return anchors
