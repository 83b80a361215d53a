"""The pure core: what counts as progress, and that no verdict is forced."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from workshop_service import FILTER, PUMP, ROUND, UDS, WHOLE, line, remembered, visits

from faultline.service.core.records.fault import Fault
from faultline.service.core.records.health import Standing
from faultline.service.protocol.live import LiveTick
from faultline.service.workshop.cycle import Cycle
from faultline.service.workshop.plan import Step, plan
from faultline.service.workshop.progress import Progress
from faultline.service.workshop.trace import MOST, Trace
from faultline.service.workshop.verdict import Seen, Verdict, judge
from faultline.service.workshop.words import order

NOTHING = Seen([], [])
PERIOD = 0.2
UNHURRIED = settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])

QUIET = [msgspec.convert(each, LiveTick) for each in visits(WHOLE)]


def followed(lines: Iterable[dict[str, Any]], patience_s: float = 600.0) -> Cycle:
    cycle = Cycle(UDS, plan(UDS.steady, 60.0), patience_s)
    for each in lines:
        cycle.take(msgspec.convert(each, LiveTick))
        if cycle.ended:
            break
    return cycle


def verdict(lines: Iterable[dict[str, Any]], seen: Seen = NOTHING) -> Verdict:
    cycle = followed(lines)
    return judge(cycle, cycle.ended or "interrupted", seen)


def said(found: Verdict) -> str:
    return "\n".join(found.reasons)


def test_a_whole_quiet_cycle_is_no_fault_found() -> None:
    cycle = followed(visits(WHOLE))
    assert cycle.ended == "complete"
    found = judge(cycle, "complete", NOTHING)
    assert (found.kind, found.candidates) == ("no-fault", [])
    assert "not a proof" in said(found)


@UNHURRIED
@given(st.permutations(WHOLE).filter(lambda order: all(one != two for one, two in pairwise(order))))
def test_the_order_of_the_steps_does_not_matter(order: list[str]) -> None:
    progress = Progress(plan(UDS.steady, 60.0))
    for mode in order:
        progress.add("edge", 8.0)
        for _ in range(61):
            progress.add(mode, 1.0)
    assert progress.complete
    assert progress.seconds == [60.0] * 6


@UNHURRIED
@given(st.lists(st.tuples(st.sampled_from((*ROUND, "edge")), st.integers(1, 400)), max_size=12))
def test_no_fault_found_needs_every_mode_twice(walk: list[tuple[str, int]]) -> None:
    lines = [line(k, mode) for k, mode in enumerate(mode for mode, ticks in walk for _ in range(ticks))]
    cycle = followed(lines)
    found = judge(cycle, cycle.ended or "interrupted", NOTHING)
    seconds = {mode: sum(each["mode"] == mode for each in lines) * PERIOD for mode in ROUND}
    if min(seconds.values()) < 120.0 - 1e-6:
        assert found.kind == "cannot-tell"
        assert "not done: mode" in said(found)


@UNHURRIED
@given(
    st.sampled_from(
        [
            {"anomaly": True},
            {"anomaly": True, "alarm": ["t1"]},
            {"alarm": ["t2"]},
            {"cannot_tell": ["t1"], "usable": [False, True]},
            {"diagnoses": [FILTER], "anomaly": True},
        ]
    ),
    st.integers(0, 74),
)
def test_never_no_fault_where_something_stands_at_the_end(fields: dict[str, Any], ticks: int) -> None:
    last = [line(len(QUIET) + k, "idle", **fields) for k in range(ticks + 1)]
    cycle = Cycle(UDS, plan(UDS.steady, 60.0), 600.0)
    for each in [*QUIET, *(msgspec.convert(each, LiveTick) for each in last)]:
        cycle.take(each)
    assert judge(cycle, "complete", NOTHING).kind == ("fault" if "diagnoses" in fields else "cannot-tell")


@pytest.mark.parametrize("mode", ROUND)
def test_a_mode_that_was_never_seen_is_named(mode: str) -> None:
    lines = visits([each for each in WHOLE if each != mode])
    found = verdict(lines)
    assert found.kind == "cannot-tell"
    assert f"not done: mode {mode}, time 1: 0 of 60 s" in said(found)
    assert f"t1 t2 could tell only: {mode} 0 s" in said(found)


def test_one_long_visit_is_not_two() -> None:
    progress = Progress(plan(UDS.steady, 60.0))
    for _ in range(300):
        progress.add("idle", 1.0)
        progress.add("edge", 0.0)
    assert progress.seconds[0] == 60.0
    assert progress.seconds[3] == 0.0


def test_short_visits_add_up() -> None:
    progress = Progress(plan(UDS.steady, 60.0))
    for _ in range(9):
        for mode in ROUND:
            progress.add(mode, 15.0)
    assert progress.complete


def test_time_in_which_a_test_cannot_tell_does_not_count_and_the_signal_is_named() -> None:
    blind: dict[str, Any] = {"usable": [True, False], "cannot_tell": ["t2"], "quality": ["good", "frozen"]}
    cycle = followed(visits(WHOLE, **blind))
    assert cycle.progress.seconds == [0.0] * 6
    assert cycle.seconds["t1"]["idle"] > 120.0
    found = said(judge(cycle, "patience", NOTHING))
    assert "t2 could tell only: idle 0 s, partial 0 s, maximum 0 s" in found
    assert "dc_dose does not change (frozen)" in found
    assert "t2 cannot tell at the end" in found
    assert "dc_dose does not change" in order(cycle)


def test_ticks_that_a_slow_reader_missed_count_and_long_gaps_do_not() -> None:
    cycle = followed(line(k * 5, "idle") for k in range(61))
    assert cycle.progress.seconds[0] == pytest.approx(60.0, abs=0.3)
    assert followed(line(k * 50, "idle") for k in range(6)).progress.seconds[0] == pytest.approx(1.2)
    assert followed([line(7), line(7), line(7)]).progress.seconds[0] == pytest.approx(0.2)


def test_a_fault_with_what_separates_its_candidates() -> None:
    apart = [{"between": [["fA_du"], ["fq"]], "telling": ["t1"], "waiting": []}]
    there: dict[str, Any] = {"diagnoses": [PUMP, FILTER], "alarm": ["t1"], "anomaly": True, "separating": apart}
    found = verdict([*visits(ROUND), *visits(ROUND, begin=2000, **there), *visits(["idle"], begin=4000, **there)])
    assert (found.kind, found.present) == ("fault", True)
    first = found.candidates[0].faults[0]
    assert (first.component, first.description, first.spn, first.fmi) == ("filter", "filter clogged", 3362, 7)
    assert [each.rank for each in found.candidates] == [1, 2]
    assert found.separating[0].telling == ["t1"]


def test_a_fault_that_has_gone_is_a_fault() -> None:
    there: dict[str, Any] = {"diagnoses": [FILTER], "alarm": ["t1"], "anomaly": True}
    found = verdict([*visits(ROUND, **there), *visits(ROUND, begin=2000)])
    assert (found.kind, found.present) == ("fault", False)
    assert "do the test once more" in said(found), "it stood before the test"
    found = verdict([*visits(["idle"]), *visits(ROUND, begin=500, **there), *visits(WHOLE, begin=2000)])
    assert (found.kind, found.present) == ("fault", False)
    assert "it comes and goes" in said(found)


def test_an_unknown_fault_is_told_with_what_it_is_near() -> None:
    unknown = {"faults": [], "rank": 1, "p": None, "near": ["e01"]}
    found = verdict(visits(["idle"], diagnoses=[unknown], anomaly=True))
    assert found.candidates[0].near == ["e01 (pump flow)"]


def test_a_suspicion_that_was_dismissed_is_said() -> None:
    found = verdict([*visits(["idle"], anomaly=True), *visits(WHOLE, begin=500)])
    assert found.kind == "no-fault"
    assert "suspected once, and dismissed" in said(found)


def test_what_is_remembered_as_there_is_not_no_fault() -> None:
    there = Seen([msgspec.convert(remembered(4, there=True), Fault)], [])
    assert "fault 4 is remembered as being there" in said(verdict(visits(WHOLE), there))
    gone = Seen([msgspec.convert(remembered(4), Fault)], [])
    assert verdict(visits(WHOLE), gone).kind == "no-fault"


def test_conditions_are_among_the_reasons() -> None:
    down = Seen([], [Standing(kind="bus-down", of="can0", since=None)])
    assert "can0 the interface is down" in said(verdict([], down))


def test_patience_is_log_time_and_silence() -> None:
    cycle = followed((line(k, "edge") for k in range(10_000)), patience_s=30.0)
    assert cycle.ended == "patience"
    assert cycle.elapsed_s == pytest.approx(30.0, abs=0.3)
    silent = Cycle(UDS, plan(UDS.steady, 60.0), 5.0)
    for _ in range(10):
        silent.silent(0.5)
    assert silent.ended == "patience"
    assert "not one sample came" in said(judge(silent, "patience", NOTHING))
    assert "nothing comes from the service" in order(silent)


def test_a_service_that_begins_anew_begins_the_cycle_anew() -> None:
    cycle = followed([*visits(ROUND), *visits(["idle"])])
    assert cycle.restarts == 1
    assert cycle.progress.seconds == [60.0, 0, 0, 0, 0, 0]


def test_the_trace_stays_small_and_keeps_the_largest_sums() -> None:
    trace = Trace()
    for k in range(20 * MOST):
        trace.add(k * PERIOD, msgspec.convert(line(k, sums=[2.0 if k == 777 else 0.1, None]), LiveTick))
    assert len(trace.samples) <= MOST + 1
    assert max(each.sums[0] or 0.0 for each in trace.samples) == 2.0


def test_a_second_visit_is_not_asked_for_before_the_first_is_left() -> None:
    progress = Progress([Step("idle", 1, 2.0), Step("idle", 2, 2.0), Step("partial", 1, 2.0)])
    asked = [progress.must_leave]
    for mode, ticks in (("idle", 5), ("idle", 15), ("partial", 1), ("idle", 1)):
        for _ in range(ticks):
            progress.add(mode, 0.2)
        asked.append(progress.must_leave)
    assert asked == [False, False, True, False, False]
