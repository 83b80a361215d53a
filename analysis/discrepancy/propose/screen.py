"""Candidates by what their terms would explain to first order: which of many formulas are worth a fit.

Where the model was fitted with the missing effect taken for unknown, each candidate's course is a disturbance of its
equation, and with a strength of N(0, 1) spreads beforehand its evidence [nats] is

    p^2 / 2 (1 + g) - ln(1 + g) / 2,    g = c'c,  p = c'e

with the whitened response c of the outputs and what is left e, both without what parameters may take of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

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
    """A candidate, to first order: its evidence [nats] and its strength [spreads].

    `same` are those that do the same, the best first.
    """

    candidate: Candidate
    evidence: float
    strength: float
    same: tuple["Screened", ...] = ()


def screened(
    misfit: Misfit, operation: Operation, equations: Sequence[str], sound: Callable[[Candidate], bool]
) -> tuple[list[Screened], int]:
    """Return those `sound` candidates of the equations that are worth a fit, best first, and how many there were."""
    best: dict[tuple[str, ...], tuple[Screened, Array]] = {}
    count = 0
    for equation in equations:
        made = candidates(operation, equation)
        count += len(made)
        for each in _judged(misfit, _responses(misfit, operation, equation, made), made) if made else ():
            before = best.get(each[0].candidate.family)
            if before is None or each[0].evidence > before[0].evidence:
                best[each[0].candidate.family] = each
    ordered = sorted(best.values(), key=lambda each: -each[0].evidence)
    return _field([each for each in ordered if each[0].evidence > 0.0], sound), count


def _responses(misfit: Misfit, operation: Operation, equation: str, made: Sequence[Candidate]) -> Array:
    directions = operation.split(np.column_stack([c.direction for c in made]))
    return misfit.shared(operation.runs.outputs(equation, directions))


def _judged(misfit: Misfit, C: Array, made: Sequence[Candidate]) -> list[tuple[Screened, Array]]:
    """The candidates with what each costs taken off, and with their columns of C (N, D)."""
    power, pull = np.sum(C * C, axis=0), C.T @ misfit.left
    gain = 0.5 * pull**2 / (1.0 + power) - 0.5 * np.log1p(power)
    gain = np.where(np.array([c.one_sided for c in made]) & (pull < 0.0), -np.inf, gain)
    gain -= [c.cost for c in made]
    strength = pull / (1.0 + power)
    return [
        (Screened(c, float(value), float(size)), column)
        for c, value, size, column in zip(made, gain, strength, C.T, strict=True)
    ]


def _field(ordered: Sequence[tuple[Screened, Array]], sound: Callable[[Candidate], bool]) -> list[Screened]:
    """Those to fit: no two that do the same, and not too many of one equation."""
    chosen: list[tuple[Screened, Array]] = []
    same, counted = dict[str, list[Screened]](), dict[str, int]()
    for each, column in ordered:
        unit, equation = column / np.linalg.norm(column), each.candidate.equation
        twin = next((other.candidate.name for other, its in chosen if abs(float(unit @ its)) > SAME), None)
        if twin is not None:
            same[twin].append(each)
        elif len(chosen) < FIELD and counted.get(equation, 0) < EACH and sound(each.candidate):
            counted[equation] = counted.get(equation, 0) + 1
            chosen.append((each, unit))
            same[each.candidate.name] = []
    return [replace(each, same=tuple(same[each.candidate.name])) for each, _ in chosen]
