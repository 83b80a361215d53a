"""Detection and isolation of a recording, by the definitions of two benchmarks, over what subscribers were told.

Samples are ticks. What was told last stands until something else is told. *Detected*: some diagnosis stands.

DX 2025 challenge (LiU-ICE benchmark, Jung, Frisk and Krysander 2024):

    TDR  share of the faulty samples that are detected
    FAR  share of the fault-free samples that are detected, of those in which some test could tell: silence of the
         blind is no peace
    FIA  mean probability given to the true diagnosis, over the faulty samples that are detected

DAMADICS (Bartys et al., Control Engineering Practice 14, 2006), with times in place of samples:

    detection time         from the onset to the last rising edge of detection
    isolation time         from the onset to the last rising edge of isolation: the true diagnosis is told alone
    true detection rate    share of the faulty time that is detected: TDR
    false detection rate   share of the fault-free time that is detected: FAR
    true isolation rate    share of the faulty time in which the true diagnosis is told alone
    false isolation rate   share of the faulty time in which others are told and the true one is not among them

Here *told* means of rank 1. The detection time of a fault that is found once and lost never is the delay of `judge`.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import msgspec
import numpy as np

from faultline.analysis.evaluation.weights import UNNAMED, Explanation, suggested, true_explanation, weights
from faultline.service.core.records.event import Diagnosis, Event
from faultline.service.core.signals.values import Mask

NOTHING = "nothing told"
PAIR = "another pair"


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """What was told of a recording, counted in ticks, and what stands at its end.

    `free_ticks` are those without a fault in which some test could tell, `false_ticks` those of them that are detected.
    `isolated`: the true diagnosis is told alone; `mistaken`: others are told, and it is not among them; `weight`: sum
    of the probabilities given to it. `standing` are the weights of what stands at the end by label, `rank`, `p` and
    `size` those of the true diagnosis and the number of diagnoses there; rank and p are None where it is not among
    them, and p also where none is told. `alone`: it is the only one of rank 1 there.
    """

    free_ticks: int
    false_ticks: int
    faulty_ticks: int
    detected_ticks: int
    isolated_ticks: int
    mistaken_ticks: int
    weight: float
    shared: bool
    detection_s: float | None
    isolation_s: float | None
    standing: dict[str, float]
    rank: int | None
    p: float | None
    alone: bool
    size: int


class Scores(msgspec.Struct, frozen=True, kw_only=True):
    """The definitions above over several recordings, all samples weighing the same; None where there are no such."""

    tdr: float | None
    far: float | None
    fia: float | None
    true_isolation: float | None
    false_isolation: float | None


def told(
    events: Sequence[Event], telling: Mask, onset: int, period_s: float, faults: Sequence[str], known: Sequence[str]
) -> Told:
    """Counts what the `events` told in as many ticks as `telling` (K,) has; those from `onset` on have the `faults`.

    `telling`: whether some test could tell. `known` are the faults that the bundle knows: of others, *unknown* is the
    true diagnosis.
    """
    true, ticks = true_explanation(faults, known), len(telling)
    given = np.zeros(ticks)  # probability of the true diagnosis
    detected, alone, without = np.zeros((3, ticks), dtype=np.bool_)
    within = [event for event in events if event.tick < ticks]
    for event, (start, end) in zip(within, pairwise([*(e.tick for e in within), ticks]), strict=True):
        span, first = slice(start, end), _first(event.diagnoses)
        given[span] = weights(event.diagnoses).get(true, 0.0)
        detected[span] = bool(event.diagnoses)
        alone[span] = first == [true]
        without[span] = bool(first) and true not in first
    last = within[-1].diagnoses if within and onset < ticks else []
    stood = suggested(last)
    own = next((d for d in stood if frozenset(d.faults) == true), None)
    return Told(
        free_ticks=int(telling[:onset].sum()),
        false_ticks=int((detected & telling)[:onset].sum()),
        faulty_ticks=ticks - onset,
        detected_ticks=int(detected[onset:].sum()),
        isolated_ticks=int(alone[onset:].sum()),
        mistaken_ticks=int(without[onset:].sum()),
        weight=float(given[onset:][detected[onset:]].sum()),
        shared=any(d.p is None for event in within for d in event.diagnoses),
        detection_s=_last_edge(detected[onset:], period_s),
        isolation_s=_last_edge(alone[onset:], period_s),
        standing=standing(last, true),
        rank=own.rank if own else None,
        p=own.p if own else None,
        alone=_first(last) == [true],
        size=len(stood),
    )


def standing(diagnoses: Sequence[Diagnosis], true: Explanation) -> dict[str, float]:
    """The weights of diagnoses by label; two names are `PAIR` unless they are the true ones."""
    found: dict[str, float] = {}
    for explanation, weight in weights(diagnoses).items():
        name = label(explanation) if len(explanation) < 2 or explanation == true else PAIR
        found[name] = found.get(name, 0.0) + weight
    return found or {NOTHING: 1.0}


def label(explanation: Iterable[str]) -> str:
    """An explanation in words."""
    return "+".join(sorted(explanation)) or UNNAMED


def scores(of: Sequence[Told]) -> Scores:
    """The benchmarks' figures over recordings."""
    free, faulty = (sum(getattr(t, name) for t in of) for name in ("free_ticks", "faulty_ticks"))
    detected = sum(t.detected_ticks for t in of)
    return Scores(
        tdr=_quotient(detected, faulty),
        far=_quotient(sum(t.false_ticks for t in of), free),
        fia=_quotient(sum(t.weight for t in of), detected),
        true_isolation=_quotient(sum(t.isolated_ticks for t in of), faulty),
        false_isolation=_quotient(sum(t.mistaken_ticks for t in of), faulty),
    )


def _quotient(part: float, whole: int) -> float | None:
    return part / whole if whole else None


def _first(diagnoses: Sequence[Diagnosis]) -> list[Explanation]:
    return [frozenset(diagnosis.faults) for diagnosis in diagnoses if diagnosis.rank == 1]


def _last_edge(signal: Mask, period_s: float) -> float | None:
    """When `signal` (K,) rose for the last time [s]; None if it never did or does not stand at the end."""
    if not signal.size or not signal[-1]:
        return None
    return round(int(np.flatnonzero(~signal)[-1] + 1 if not signal.all() else 0) * period_s, 3)
