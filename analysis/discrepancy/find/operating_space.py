"""Where in the operating space an equation is wrong: the one feature, or two, that its unknown input follows best.

Every feature's coefficient, a fraction, is N(0, `PLAUSIBLE`^2) beforehand; so the evidence for a feature has the scale
of that for a free input (`latent`), and says how much of it one number can do. A second must add what is worth it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.discrepancy.find.features import Feature, Operation
from faultline.analysis.discrepancy.find.latent import Misfit
from faultline.analysis.model.display import units_of
from faultline.service.core.display import Display

Array = npt.NDArray[np.float64]

PLAUSIBLE = 0.3
"""Standard deviation of a fraction that an effect changes: more is a fault."""

WORTH = 10.0
"""What a second feature must add at least, twice in nats; and a part `NOTABLE` of the first's."""

NOTABLE = 0.1


@dataclass(frozen=True)
class Part:
    """A feature with its coefficient, its standard deviation, and in words: amounts in the unit `shown`."""

    feature: Feature
    value: float
    sd: float
    shown: Display

    @property
    def words(self) -> str:
        """For example "+17.0 % +- 0.3 % only at maximum dc_dose"."""
        term = self.feature.term
        if self.feature.relative:
            amount = f"{100 * self.value:+.3g} % +- {100 * self.sd:.2g} % of {term.variable}"
        else:
            scale = term.size / abs(term.factor) / self.shown.size
            amount = f"{scale * self.value:+.3g} +- {scale * self.sd:.2g} {self.shown.unit}".rstrip()
        return f"{amount} {self.feature.course.words}"


@dataclass(frozen=True)
class Finding:
    """What an equation's unknown input follows: one part or two; `evidence` is twice in nats."""

    equation: str
    parts: tuple[Part, ...]
    evidence: float

    def sentence(self, description: str) -> str:
        """What a mechanic can read."""
        return f"{description} ({self.equation}): {', and '.join(part.words for part in self.parts)}"


def finding_of(operation: Operation, misfit: Misfit, equation: str) -> Finding:
    """The best description of what `equation` misses."""
    features = operation.features(equation)
    C = columns_of(operation, misfit, equation, features)
    G, pull = C.T @ C, C.T @ misfit.left
    cost = np.array([feature.cost for feature in features])
    one = [_evidence(G, pull, [k]) - cost[k] for k in range(len(features))]
    first = int(np.argmax(one))
    two = [_evidence(G, pull, [first, k]) - cost[first] - cost[k] for k in range(len(features))]
    second = int(np.argmax(two))
    worth = two[second] - one[first] > max(WORTH, NOTABLE * one[first])
    chosen, evidence = ([first, second], two[second]) if worth else ([first], one[first])
    mean, sd = _coefficients(G, pull, chosen)
    units = units_of(operation.model)
    parts = [
        Part(features[k], float(a), float(b), units.of(features[k].term.unit))
        for k, a, b in zip(chosen, mean, sd, strict=True)
    ]
    return Finding(equation, tuple(parts), float(evidence))


def columns_of(operation: Operation, misfit: Misfit, equation: str, features: Sequence[Feature]) -> Array:
    """What features of an equation do, whitened and projected, for coefficients of one."""
    directions = operation.split(np.column_stack([feature.direction for feature in features]))
    return misfit.shared(operation.runs.outputs(equation, directions))


def _evidence(G: Array, pull: Array, chosen: list[int]) -> float:
    """Twice the gain of the log marginal likelihood by these features together."""
    P = PLAUSIBLE**2 * G[np.ix_(chosen, chosen)] + np.eye(len(chosen))
    p = pull[chosen]
    return float(PLAUSIBLE**2 * p @ np.linalg.solve(P, p) - np.linalg.slogdet(P)[1])


def _coefficients(G: Array, pull: Array, chosen: list[int]) -> tuple[Array, Array]:
    covariance = np.linalg.inv(G[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / PLAUSIBLE**2)
    return covariance @ pull[chosen], np.sqrt(np.diag(covariance))
