"""When events are told: started once, changes after they have lasted, nothing for a flicker."""

from dataclasses import dataclass, field

import pytest
from uds_time import SETTLE_TICKS, TIME

from faultline.service.core.decision.telling import Teller
from faultline.service.core.records.event import Diagnosis, Event, decode
from faultline.service.core.records.line import encode


@dataclass
class Decided:
    """What the teller reads of a decision."""

    diagnoses: list[Diagnosis] = field(default_factory=list)
    cannot_tell: list[str] = field(default_factory=list)
    alarm: list[str] = field(default_factory=list)
    suspected: bool = False
    intermittent: bool = False
    settled: bool = False
    since: int | None = None
    withdrawn: bool = False

    @property
    def named(self) -> list[Diagnosis]:
        return self.diagnoses


def _diagnosis(*faults: str, rank: int = 1) -> Diagnosis:
    return Diagnosis(faults=list(faults), rank=rank, p=None)


def _tell(decisions: list[Decided]) -> list[Event]:
    teller = Teller("truck", "b" * 64, TIME)
    return [event for tick, decided in enumerate(decisions) for event in teller.update(tick, decided)]


def test_the_life_of_a_fault_is_told_in_order_and_numbered_without_gaps() -> None:
    quiet, wide, narrow = Decided(), Decided([_diagnosis("fA"), _diagnosis("fB")]), Decided([_diagnosis("fA")])
    wide.alarm, wide.since = ["t02"], 7
    events = _tell([d for d in (quiet, wide, narrow, quiet) for _ in range(20)])
    assert [event.transition for event in events] == ["started", "occurred", "refined", "healed"]
    assert [event.seq for event in events] == [1, 2, 3, 4]
    assert events[1].id == "truck-2"
    assert events[1].since_tick == 7
    assert events[1].tick == 20 + SETTLE_TICKS
    assert events[1].t_s == pytest.approx(0.2 * events[1].tick)
    assert events[3].diagnoses == []


def test_a_suspicion_is_told_and_either_dismissed_or_confirmed() -> None:
    quiet, suspicious = Decided(), Decided(suspected=True, alarm=["t02"])
    fault = Decided([_diagnosis("fA")], alarm=["t02"])
    events = _tell([d for d in (quiet, suspicious, quiet, suspicious, fault, quiet) for _ in range(20)])
    assert [event.transition for event in events] == [
        "started",
        "suspected",
        "dismissed",
        "suspected",
        "occurred",
        "healed",
    ]
    assert [event.diagnoses for event in events[:4]] == [[], [], [], []]
    assert events[1].alarm == ["t02"]


def test_a_probability_that_creeps_is_no_news() -> None:
    creeping = [Decided([Diagnosis(faults=["fA"], rank=1, p=tick / 100)]) for tick in range(100)]
    events = _tell([Decided(), *creeping])
    assert [(event.transition, [d.p for d in event.diagnoses]) for event in events] == [
        ("started", []),
        ("occurred", [SETTLE_TICKS / 100]),
    ]


def test_a_flicker_is_not_told() -> None:
    flicker = [Decided([_diagnosis("fA")]) if tick % 7 == 0 else Decided() for tick in range(200)]
    assert [event.transition for event in _tell(flicker)] == ["started"]


def test_blindness_is_told_apart_from_quiet() -> None:
    blind, seeing = Decided(cannot_tell=["t02", "t06"]), Decided()
    events = _tell([d for d in (blind, seeing, blind) for _ in range(20)])
    assert [(e.transition, e.cannot_tell) for e in events] == [
        ("started", ["t02", "t06"]),
        ("cannot_tell", []),
        ("cannot_tell", ["t02", "t06"]),
    ]


def test_flickering_blindness_does_not_hold_up_a_diagnosis() -> None:
    decisions = [Decided(cannot_tell=["t02"] if tick % 3 else []) for tick in range(60)]
    for tick in range(20, 60):
        decisions[tick].diagnoses = [_diagnosis("fA")]
    assert [event.transition for event in _tell(decisions)] == ["started", "occurred"]


def test_a_change_of_rank_is_a_refinement() -> None:
    before = Decided([_diagnosis("fA"), _diagnosis("fB")])
    after = Decided([_diagnosis("fA"), _diagnosis("fB", rank=2)])
    events = _tell([d for d in (Decided(), before, after) for _ in range(20)])
    assert [event.transition for event in events] == ["started", "occurred", "refined"]


def test_an_event_is_one_line_and_comes_back_as_it_was() -> None:
    [event] = _tell([Decided(cannot_tell=["t02"])])
    line = encode(event)
    assert line.count(b"\n") == 1
    assert decode(line) == event


def test_a_fault_that_rests_on_doubted_samples_is_withdrawn_and_does_not_heal() -> None:
    fault, none = Decided([_diagnosis("fA")]), Decided(withdrawn=True)
    told = _tell([fault, *[fault] * (2 * SETTLE_TICKS), *[none] * (2 * SETTLE_TICKS)])
    assert [event.transition for event in told] == ["started", "occurred", "withdrawn"]
    assert told[-1].diagnoses == []
