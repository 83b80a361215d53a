"""What is told of each fault: the confusion of true and told explanations, rank, probability and size."""

from collections.abc import Sequence
from statistics import mean, median

import msgspec

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.measure.intervals import Share, share
from faultline.analysis.evaluation.measure.metrics import NOTHING, PAIR, Scores, Told, label, scores
from faultline.analysis.evaluation.weights import true_explanation


class Isolation(msgspec.Struct, frozen=True, kw_only=True):
    """One faulty case: `true` is what should be told, *unknown* where the bundle does not know the fault.

    `told` are the mean weights of what stands at the end of its recordings, by label. `contained`: the true diagnosis
    is among those that stand at the end; `alone`: it is the only one of rank 1. `ranks`, `sizes` and `p` are those at
    the end of each recording in which it is contained. `delays_s` run to the first diagnosis that explains something
    new, one for each of the `detected` recordings.
    """

    case: str
    true: str
    recordings: int
    detected: Share
    delays_s: list[float]
    median_delay_s: float | None
    contained: Share
    alone: Share
    ranks: list[int]
    p: list[float]
    sizes: list[int]
    told: dict[str, float]
    scores: Scores


def isolations(of: Sequence[Facts], known: Sequence[str]) -> list[Isolation]:
    """Every faulty case, in the order of the recordings."""
    found = []
    for case in dict.fromkeys(one.case for one in of if one.case.faults):
        here = [one for one in of if one.case == case]
        told = [one.told for one in here]
        delays = [one.verdict.delay_s for one in here if one.verdict.delay_s is not None]
        true = label(true_explanation(case.faults, known))
        ranks = [t.rank for t in told if t.rank is not None]
        found.append(
            Isolation(
                case=case.label,
                true=true,
                recordings=len(here),
                detected=share(len(delays), len(here)),
                delays_s=delays,
                median_delay_s=round(median(delays), 1) if delays else None,
                contained=share(len(ranks), len(here)),
                alone=share(sum(t.alone for t in told), len(here)),
                ranks=ranks,
                p=[t.p for t in told if t.p is not None],
                sizes=[t.size for t in told if t.size],
                told={name: mean(t.standing.get(name, 0.0) for t in told) for name in _labels(told)},
                scores=scores(told),
            )
        )
    return found


def columns(rows: Sequence[Isolation], known: Sequence[str]) -> list[str]:
    """Of the confusion matrix: the bundle's faults, whatever else was true or told, and what names nothing."""
    last = (PAIR, NOTHING)
    others = [name for row in rows for name in (row.true, *row.told) if name not in last]
    return [*dict.fromkeys([*known, *others]), *last]


def _labels(told: Sequence[Told]) -> list[str]:
    return list(dict.fromkeys(name for t in told for name in t.standing))
