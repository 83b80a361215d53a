"""Candidates by what their terms would explain to first order: which of many formulas are worth a fit.

Where the model was fitted with the missing effect taken for unknown, each candidate's course is a disturbance of its
equation, and with a strength of N(0, 1) spreads beforehand its evidence [nats] is

    p^2 / 2 (1 + g) - ln(1 + g) / 2,    g = c'c,  p = c'e

with the whitened response c of the outputs and what is left e, both without what parameters may take of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.find.latent import Misfit
from faultline.analysis.discrepancy.propose.candidates import Candidate, candidates

Array = npt.NDArray[np.float64]

SAME = 0.995
"""Cosine of two responses from which the two formulas do the same to first order: the better one stands for both."""

FIELD, EACH = 12, 4
"""So many are fitted, of one equation at most so many."""


@dataclass(frozen=True)
class Screened:
    """A candidate with its evidence to first order [nats], and those that do the same, the best first."""

    candidate: Candidate
    evidence: float
    same: tuple[Candidate, ...]


def screened(
    misfit: Misfit, operation: Operation, equations: Sequence[str], sound: Callable[[Candidate], bool]
) -> tuple[list[Screened], int]:
    """Return those `sound` candidates of the equations that are worth a fit, best first, and how many there were."""
    found: list[tuple[float, Candidate, Array]] = []
    for equation in equations:
        made = candidates(operation, equation)
        if made:
            C = _responses(misfit, operation, equation, made)
            values = _evidences(C, misfit.left, [c.one_sided for c in made])
            found += [(value - c.cost, c, C[:, k]) for k, (value, c) in enumerate(zip(values, made, strict=True))]
    best: dict[tuple[str, ...], tuple[float, Candidate, Array]] = {}
    for each in sorted(found, key=lambda each: -each[0]):
        best.setdefault(each[1].family, each)
    return _field([each for each in best.values() if each[0] > 0.0], sound), len(found)


def _responses(misfit: Misfit, operation: Operation, equation: str, made: Sequence[Candidate]) -> Array:
    directions = operation.split(np.column_stack([c.direction for c in made]))
    return misfit.shared(operation.runs.outputs(equation, directions))


def _evidences(C: Array, left: Array, one_sided: Sequence[bool]) -> list[float]:
    power, pull = np.sum(C * C, axis=0), C.T @ left
    gain = 0.5 * pull**2 / (1.0 + power) - 0.5 * np.log1p(power)
    return [float(value) for value in np.where(np.asarray(one_sided) & (pull < 0.0), -np.inf, gain)]


def _field(ordered: Sequence[tuple[float, Candidate, Array]], sound: Callable[[Candidate], bool]) -> list[Screened]:
    """Those to fit: no two that do the same, and not too many of one equation."""
    chosen: list[tuple[float, Candidate, Array]] = []
    same, counted = dict[str, list[Candidate]](), dict[str, int]()
    for value, candidate, column in ordered:
        unit = column / np.linalg.norm(column)
        twin = next((c.name for _, c, other in chosen if abs(float(unit @ other)) > SAME), None)
        if twin is not None:
            same[twin].append(candidate)
        elif len(chosen) < FIELD and counted.get(candidate.equation, 0) < EACH and sound(candidate):
            counted[candidate.equation] = counted.get(candidate.equation, 0) + 1
            chosen.append((value, candidate, unit))
            same[candidate.name] = []
    return [Screened(candidate, value, tuple(same[candidate.name])) for value, candidate, _ in chosen]
