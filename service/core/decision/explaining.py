"""Who it is: from the conflicts, and from a look at the window, to ranked explanations.

Where residuals have not settled, conflicts alone name candidates (`core.decision.isolation`). Later a fault has to fit
what is seen as well: a single one, else the best two at once. Behind them is always that the fault is unknown, as a
vehicle may have one that nobody has declared; it comes first where that is likelier, or nothing fits. It is unknown too
where a disturbance fits, which is no component's fault, and near the equation that this enters.

A bundle of a single test tells no faults apart: what it shows is one of those that it is sensitive to.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import e, log

import numpy as np
from msgspec.structs import replace

from faultline.service.core.decision.hypotheses import confined
from faultline.service.core.decision.isolation import UNKNOWN, diagnoses
from faultline.service.core.decision.look import TIE, Look
from faultline.service.core.decision.size_intervals import SizeIntervals
from faultline.service.core.manifest import Manifest
from faultline.service.core.records.event import Diagnosis, Size

UNDECLARED = 0.05
"""The prior probability that a fault is none that the model declares: an engineer's, as no statistics are known."""

TIE_PART = 0.25
"""Hypotheses whose misfits differ by less than `TIE`, or than this part of the larger one, are not told apart: the data
do not separate them, or neither explains the data."""

NEARLY = 0.1
"""The part of what is seen that may be left by a fault that is listed beside the unknown one."""

OF_TWO = 15.0
"""By how much two faults must fit better than the best single one: with one more size free, chance fits better too."""


class Explanations:
    """Explanations of what is seen, best first. Their sizes are computed once they are asked for.

    `found` has each with the faults or the disturbance that it is, `size_of` the interval of a single one.
    """

    def __init__(
        self,
        found: Sequence[tuple[tuple[str, ...], Diagnosis]] = (),
        size_of: Callable[[str], list[Size]] | None = None,
    ) -> None:
        self._found, self._size_of = found, size_of

    @property
    def named(self) -> list[Diagnosis]:
        """Return them, with sizes or not."""
        return [each for _, each in self._found]

    @property
    def diagnoses(self) -> list[Diagnosis]:
        """Return them with sizes."""
        self.compute_sizes()
        return self.named

    def compute_sizes(self) -> None:
        """Compute the sizes, if they have not been; the look that they are of is held until then."""
        if self._size_of is None:
            return
        size_of, self._size_of = self._size_of, None
        self._found = [
            (faults, replace(each, sizes=size_of(faults[0])) if len(faults) == 1 else each)
            for faults, each in self._found
        ]


class Explainer:
    """What generators know of faults: which of them a generator is sensitive to, and in which equations."""

    def __init__(self, manifest: Manifest) -> None:
        self._sensitive = [frozenset(generator.faults) for generator in manifest.generators]
        self._equations = [frozenset(generator.equations) for generator in manifest.generators]
        self._disturbed = {each.name: each.equation for each in manifest.disturbances}
        self._brings = {each.fault: each.brings for each in manifest.evidence.consequences}
        self._faults = frozenset(fault.name for fault in manifest.faults)
        self._sizes = SizeIntervals(manifest.evidence)
        self._has_one_test = len({generator.test for generator in manifest.generators}) == 1

    def by_conflicts(self, rows: Sequence[int], look: Look | None, undeclared: bool = False) -> Explanations:
        """The explanations that these generators allow, all of one rank; one may be that it is `undeclared`."""
        named = diagnoses([self._moving(row, look) for row in rows] or [self._faults])
        if undeclared and UNKNOWN not in named:
            named = [*named, UNKNOWN]
        return Explanations(self._ranked(named, {}, {}, rows))

    def by_evidence(self, rows: Sequence[int], look: Look) -> Explanations:
        """Those of them that fit what is seen."""
        if self._has_one_test:
            return self.by_conflicts(rows, look)
        conflicts = [self._moving(row, look) | self._disturbing(row) for row in rows]
        misfits = fitting(conflicts, look)
        if any(len(faults) == 1 for faults in misfits):
            none = undeclared(max(look.chance(faults, q) for faults, q in misfits.items()))
            p = {faults: round(each * (1.0 - none), 3) for faults, each in probabilities(misfits).items()}
            rank = 1 if none >= max(p.values(), default=0.0) else 1 + len(misfits)
            found = [
                *self._ranked([*misfits], misfits, p, rows),
                (UNKNOWN, Diagnosis(faults=[], rank=rank, p=round(none, 3))),
            ]
            found.sort(key=lambda each: each[1].rank)  # of one rank as they are
        else:
            unknown = UNKNOWN, self._diagnosis(UNKNOWN, 1 + len(misfits), None, rows)
            found = self._ranked([*misfits, *nearest(conflicts, look)], {}, {}, rows)
            found = [*found, unknown] if misfits else [unknown, *found]  # behind two that explain all of it
        return Explanations(found, partial(self._sizes.of, look=look))

    def _moving(self, row: int, look: Look | None) -> frozenset[str]:
        """The faults that move a generator, by themselves or by a consequence that the look shows."""
        own = self._sensitive[row]
        shown = () if look is None else look.brought
        return own | {fault for fault in shown if self._brings[fault] in own}

    def _disturbing(self, row: int) -> frozenset[str]:
        """The disturbances that move a generator."""
        return frozenset(name for name, equation in self._disturbed.items() if equation in self._equations[row])

    def _ranked(
        self,
        found: Sequence[tuple[str, ...]],
        misfits: Mapping[tuple[str, ...], float],
        p: Mapping[tuple[str, ...], float],
        rows: Sequence[int],
    ) -> list[tuple[tuple[str, ...], Diagnosis]]:
        return [(faults, self._diagnosis(faults, rank, p.get(faults), rows)) for faults, rank in ranked(found, misfits)]

    def _diagnosis(self, faults: tuple[str, ...], rank: int, p: float | None, rows: Sequence[int]) -> Diagnosis:
        """An explanation as it is published: no component is named for a disturbance."""
        if near := [self._disturbed[name] for name in faults if name in self._disturbed]:
            return Diagnosis(faults=[], rank=rank, p=p, near=near)
        if faults == UNKNOWN and rows:
            near = sorted(frozenset.intersection(*(self._equations[row] for row in rows)))
        return Diagnosis(faults=list(faults), rank=rank, p=p, near=near)


def fitting(conflicts: Sequence[frozenset[str]], look: Look) -> dict[tuple[str, ...], float]:
    """The misfits of what fits and hits every conflict: single faults, else the best two at once, else nothing."""
    single = confined(conflicts, {(fault,): q for fault, q in look.growing_or_not.items()})
    best = min(single.values(), default=np.inf)
    if any(look.fits(faults, q) for faults, q in single.items()):
        near = -np.inf if look.has_free_shifts else best + TIE  # a free shift fits nearly anything
        return {faults: q for faults, q in single.items() if look.fits(faults, q) or q <= near}
    pairs = confined(conflicts, look.pairs)
    least = min(pairs.values(), default=np.inf)
    if least > best - OF_TWO or not any(look.fits(faults, q) for faults, q in pairs.items()):
        return {}
    return {faults: q for faults, q in pairs.items() if q <= least + TIE}


def nearest(conflicts: Sequence[frozenset[str]], look: Look) -> list[tuple[str, ...]]:
    """The single faults that explain nearly all of what is seen, though more is left than chance leaves."""
    single = confined(conflicts, {(fault,): q for fault, q in look.growing_or_not.items()})
    best = min(single.values(), default=np.inf)
    if best > NEARLY * look.nothing:
        return []
    return [faults for faults, q in single.items() if q <= best + max(TIE, TIE_PART * best)]


def probabilities(misfits: Mapping[tuple[str, ...], float]) -> dict[tuple[str, ...], float]:
    """How likely each single fault is if it is one of these: a misfit is -2 log of a likelihood; all as likely before.

    Of two faults at once none is given: there such figures were too sure.

    >>> p = probabilities({("fA",): 2.0, ("fB",): 2.0, ("fC",): 10.0})
    >>> {faults: round(each, 3) for faults, each in p.items()}
    {('fA',): 0.495, ('fB',): 0.495, ('fC',): 0.009}
    >>> probabilities({("fA", "fB"): 2.0})
    {}
    """
    if any(len(faults) > 1 for faults in misfits) or not misfits:
        return {}
    q = np.array(list(misfits.values()))
    weight = np.exp((q.min() - q) / 2)
    return dict(zip(misfits, (weight / weight.sum()).tolist(), strict=True))


def undeclared(chance: float) -> float:
    """Return the probability that a fault is none of those that fit, by the p-value of the one that fits best.

    A p-value below 1/e makes the declared ones -e p ln(p) times as likely as the others, at the least (Sellke, Bayarri
    and Berger, The American Statistician 55, 2001); a larger one says nothing, and the prior probability remains.

    >>> [round(undeclared(p), 3) for p in (0.5, 0.1, 0.01, 1e-4, 0.0)]
    [0.05, 0.078, 0.296, 0.955, 1.0]
    """
    ratio = 0.0 if chance <= 0.0 else -e * chance * log(chance) if chance < 1.0 / e else 1.0
    return UNDECLARED / (UNDECLARED + (1.0 - UNDECLARED) * ratio)


def ranked(
    found: Sequence[tuple[str, ...]], misfits: Mapping[tuple[str, ...], float]
) -> list[tuple[tuple[str, ...], int]]:
    """Explanations with their ranks, best first; all are equal where the misfit of one is not known.

    >>> ranked([("fA",), ("fB",), ("fC",)], {("fA",): 30.0, ("fB",): 2.0, ("fC",): 8.0})
    [(('fB',), 1), (('fC',), 1), (('fA',), 3)]
    >>> ranked([("fA", "fB"), ("fA", "fC")], {("fA",): 30.0, ("fB",): 2.0, ("fC",): 80.0})
    [(('fA', 'fB'), 1), (('fA', 'fC'), 1)]
    """
    if not all(faults in misfits for faults in found):
        return [(faults, 1) for faults in found]
    q = {faults: misfits[faults] for faults in found}
    behind = {faults: value - max(TIE, TIE_PART * value) for faults, value in q.items()}
    rank = {faults: 1 + sum(other < behind[faults] for other in q.values()) for faults in found}
    return sorted(rank.items(), key=lambda item: (item[1], item[0]))
