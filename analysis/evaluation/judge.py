"""Events against the truth: was it found, how fast, how narrowly, and was there peace before."""

from collections.abc import Sequence

import msgspec

from analysis.evaluation.truth import Truth
from service.core.events import Event


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """The judgement of one recording.

    `delay_s` runs from the onset to the first event with a diagnosis; `isolated` are the faults of the last diagnosis
    (of single faults, in rank order) and `first` those of rank 1 alone; `false_alarms` counts the episodes before the
    onset, or all of them in a fault-free recording. `contained`: every true fault is in `isolated`; `named`: they are
    `first` alone.
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


def judge(truth: Truth, events: Sequence[Event], origin_s: float) -> Verdict:
    """Judges the events of a recording; `origin_s` is the log time of tick 0 [s] after the first frame."""
    onset = min((fault.onset_s for fault in truth.fault), default=None)
    times = [origin_s + event.t_s for event in events]
    after = [e for e, t in zip(events, times, strict=True) if onset is not None and t >= onset and e.diagnoses]
    started = [t for e, t in zip(events, times, strict=True) if e.transition == "occurred"]
    last = after[-1] if after else None
    isolated = [name for d in last.diagnoses for name in d.faults] if last else []
    first = [name for d in last.diagnoses if d.rank == 1 for name in d.faults] if last else []
    true = [fault.name for fault in truth.fault]
    return Verdict(
        recording=truth.recording,
        faults=true,
        onset_s=onset,
        detected=bool(after),
        delay_s=round(origin_s + after[0].t_s - onset, 1) if after and onset is not None else None,
        isolated=list(dict.fromkeys(isolated)),
        first=list(dict.fromkeys(first)),
        contained=bool(true) and set(true) <= set(isolated),
        named=bool(true) and set(true) == set(first),
        tests=last.alarm if last else [],
        false_alarms=sum(onset is None or t < onset for t in started),
    )
