"""Events against the truth: was it found, how fast, how narrowly, was there peace before, and who could tell at all."""

from collections.abc import Collection, Sequence
from itertools import pairwise

import msgspec

from faultline.analysis.evaluation.truth import Truth
from faultline.analysis.evaluation.weights import UNNAMED, suggested, true_explanation
from faultline.service.core.records.event import Event


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """The judgement of one recording.

    `delay_s` runs from the onset to the first event that explains something new. `isolated` are the faults of the
    diagnoses that stand at the end and that something speaks for (`weights.suggested`), in rank order, and `first`
    those of rank 1 alone: what has been healed while the fault was there is not isolated. `contained`: the true faults
    together are one of the diagnoses;
    `named`: the only one of rank 1. `false_alarms` counts the episodes that began before the onset, or all of them in a
    fault-free recording; like every event, one that lasts less than two seconds is not told. `could_tell` is the share
    of the recording in which each test could tell; one in which one never could (`blind`) proves nothing of it.
    `apart_ticks` is set where the events of a bus are judged: how far they are from the log's own, None if they tell
    other candidates.
    """

    recording: str
    faults: list[str]
    onset_s: float | None
    detected: bool
    delay_s: float | None
    isolated: list[str]
    first: list[str]
    contained: bool
    named: bool
    tests: list[str]
    false_alarms: int
    could_tell: dict[str, float]
    blind: list[str]
    apart_ticks: int | None = None

    @property
    def good(self) -> bool:
        """Whether the true faults, and nothing before them, were found by tests that could all tell."""
        return self.false_alarms == 0 and not self.blind and self.contained == bool(self.faults)


def judge(
    truth: Truth,
    events: Sequence[Event],
    tests: Sequence[str],
    origin_s: float,
    end_s: float,
    known: Collection[str] | None = None,
) -> Verdict:
    """Judges the events of a recording.

    `tests` are the bundle's, `known` its faults (None: all that are true): of others, *unknown* is the right answer.
    `origin_s` and `end_s` are the log times of tick 0 and of the last tick [s] after the first frame. What was told
    later, of the silence after a replay, is left out.
    """
    dated = [(origin_s + event.t_s, event) for event in events if origin_s + event.t_s <= end_s]
    onset = min((fault.onset_s for fault in truth.fault), default=None)
    before = [event for t, event in dated if onset is None or t < onset]
    after = [(t, event) for t, event in dated if onset is not None and t >= onset]
    standing = before[-1].diagnoses if before else []
    news = next((t for t, event in after if event.diagnoses and event.diagnoses != standing), None)
    last = after[-1][1] if after and news is not None else None
    stood = suggested(last.diagnoses) if last else []
    isolated = [name for d in stood for name in d.faults or [UNNAMED]]
    first = [name for d in stood if d.rank == 1 for name in d.faults or [UNNAMED]]
    true = [fault.name for fault in truth.fault]
    right = true_explanation(true, true if known is None else known)
    told: dict[frozenset[str], int] = {}
    for diagnosis in stood:  # best first; what is unknown may be near several places
        told.setdefault(frozenset(diagnosis.faults), diagnosis.rank)
    shares = _shares(dated, tests, origin_s, end_s)
    return Verdict(
        recording=truth.recording,
        faults=true,
        onset_s=onset,
        detected=news is not None,
        delay_s=round(news - onset, 1) if news is not None and onset is not None else None,
        isolated=list(dict.fromkeys(isolated)),
        first=list(dict.fromkeys(first)),
        contained=bool(true) and right in told,
        named=bool(true) and [faults for faults, rank in told.items() if rank == 1] == [right],
        tests=last.alarm if last else [],
        false_alarms=sum(event.transition == "occurred" for event in before),
        could_tell={test: round(share, 3) for test, share in shares.items()},
        blind=[test for test, share in shares.items() if share == 0.0],
    )


def apart(live: Sequence[Event], own: Sequence[Event], end_tick: int) -> int | None:
    """By how many ticks the changes of candidates over a bus differ from the log's own; None if they are others."""
    theirs, ours = (_changes([event for event in events if event.tick <= end_tick]) for events in (live, own))
    if [candidates for candidates, _ in theirs] != [candidates for candidates, _ in ours]:
        return None
    return max((abs(a - b) for (_, a), (_, b) in zip(theirs, ours, strict=True)), default=0)


def _changes(events: Sequence[Event]) -> list[tuple[list[list[str]], int]]:
    """Every change of the candidates, whatever their ranks, with its tick."""
    changes: list[tuple[list[list[str]], int]] = []
    for event in events:
        candidates = sorted(diagnosis.faults for diagnosis in event.diagnoses)
        if candidates != (changes[-1][0] if changes else []):
            changes.append((candidates, event.tick))
    return changes


def _shares(
    dated: Sequence[tuple[float, Event]], tests: Sequence[str], origin_s: float, end_s: float
) -> dict[str, float]:
    """The share of the recording in which each test could tell, by the last word on it."""
    told = dict.fromkeys(tests, 0.0)
    ends = [*(t for t, _ in dated), end_s]
    for (_, event), (start, stop) in zip(dated, pairwise(ends), strict=True):
        for test in told:
            told[test] += (stop - start) * (test not in event.cannot_tell)
    whole = max(end_s - origin_s, 1e-9)
    return {test: seconds / whole for test, seconds in told.items()}
