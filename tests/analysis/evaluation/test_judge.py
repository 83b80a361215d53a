"""Hand-made events against a hand-made truth: every field of the verdict is known beforehand."""

from collections.abc import Sequence

import msgspec
import pytest

from faultline.analysis.evaluation import judge as judging
from faultline.analysis.evaluation.judge import Verdict
from faultline.analysis.evaluation.truth import TrueFault, Truth
from faultline.service.core.records.event import SCHEMA, Diagnosis, Event, Transition

ORIGIN_S = 1.5
ONSET_S = 70.0


END_S = 120.0
TESTS = ["t02", "t06", "t08"]


def judge(truth: Truth, events: Sequence[Event], origin_s: float, known: Sequence[str] | None = None) -> Verdict:
    return judging.judge(truth, events, TESTS, origin_s, END_S, known)


def truth(*faults: str) -> Truth:
    made = [TrueFault(name=name, size=0.5, onset_s=ONSET_S, profile="abrupt") for name in faults]
    return Truth(schema=1, recording="r", fault=made)


def event(
    transition: Transition, log_s: float, told: Sequence[tuple[str, int]] = (), alarm: Sequence[str] = ()
) -> Event:
    """An event at log time `log_s`; `told` are diagnoses "fA+fB" with their ranks."""
    return Event(
        schema=SCHEMA,
        id="r-1",
        seq=1,
        tick=round((log_s - ORIGIN_S) / 0.2),
        t_s=log_s - ORIGIN_S,
        wall=None,
        transition=transition,
        diagnoses=[Diagnosis(faults=[n for n in names.split("+") if n], rank=rank, p=None) for names, rank in told],
        alarm=list(alarm),
        cannot_tell=[],
        since_tick=None,
        bundle="b",
    )


START = event("started", ORIGIN_S)


def blind(told: Event, tests: Sequence[str]) -> Event:
    return msgspec.structs.replace(told, cannot_tell=list(tests))


def test_a_fault_found_late_and_narrowed_down() -> None:
    events = [
        START,
        event("occurred", 78.0, [("fA_du", 1), ("fy_p_ap", 1), ("fA_ori", 1)], ["t02"]),
        event("refined", 95.0, [("fA_du", 1), ("fy_p_ap", 2)], ["t02", "t06"]),
    ]
    verdict = judge(truth("fA_du"), events, ORIGIN_S)
    assert (verdict.recording, verdict.faults, verdict.onset_s) == ("r", ["fA_du"], ONSET_S)
    assert verdict.detected
    assert verdict.delay_s == 8.0
    assert verdict.isolated == ["fA_du", "fy_p_ap"]
    assert verdict.first == ["fA_du"]
    assert verdict.contained
    assert verdict.named
    assert verdict.tests == ["t02", "t06"]
    assert verdict.false_alarms == 0


def test_a_true_fault_that_shares_the_first_rank_is_contained_but_not_named() -> None:
    told = [("fA_du", 1), ("fy_p_ap", 1), ("fA_ori", 3)]
    verdict = judge(truth("fA_du"), [event("occurred", 75.0, told, ["t02"])], ORIGIN_S)
    assert verdict.first == ["fA_du", "fy_p_ap"]
    assert (verdict.contained, verdict.named) == (True, False)


def test_a_true_fault_ranked_second_is_contained_but_not_named() -> None:
    verdict = judge(truth("fA_ori"), [event("occurred", 75.0, [("fA_du", 1), ("fA_ori", 2)])], ORIGIN_S)
    assert (verdict.contained, verdict.named) == (True, False)


def test_a_wrong_diagnosis_is_a_detection_without_the_fault() -> None:
    verdict = judge(truth("fA_t"), [event("occurred", 75.0, [("fA_du", 1)])], ORIGIN_S)
    assert (verdict.detected, verdict.contained, verdict.named) == (True, False, False)


def test_the_last_diagnosis_counts_not_the_best_one() -> None:
    events = [event("occurred", 75.0, [("fA_t", 1)], ["t08"]), event("refined", 90.0, [("fA_p", 1)], ["t06"])]
    verdict = judge(truth("fA_t"), events, ORIGIN_S)
    assert (verdict.isolated, verdict.contained, verdict.tests) == (["fA_p"], False, ["t06"])


def test_what_is_healed_while_the_fault_is_there_was_detected_but_is_not_isolated() -> None:
    events = [event("occurred", 75.0, [("fA_t", 1)], ["t08"]), event("healed", 90.0)]
    verdict = judge(truth("fA_t"), events, ORIGIN_S)
    assert (verdict.detected, verdict.isolated, verdict.delay_s) == (True, [], 5.0)
    assert (verdict.contained, verdict.good) == (False, False)


def test_a_false_alarm_that_stands_at_the_onset_is_not_the_detection() -> None:
    standing = [("fA_du", 1)]
    events = [START, event("occurred", 60.0, standing, ["t02"]), event("cannot_tell", 80.0, standing, ["t02"])]
    verdict = judge(truth("fA_du"), events, ORIGIN_S)
    assert (verdict.false_alarms, verdict.detected, verdict.contained) == (1, False, False)
    events.append(event("refined", 90.0, [("fA_du", 1), ("fA_t", 1)], ["t02"]))
    verdict = judge(truth("fA_du"), events, ORIGIN_S)
    assert (verdict.detected, verdict.delay_s, verdict.contained, verdict.good) == (True, 20.0, True, False)


def test_what_is_told_of_the_silence_after_the_recording_does_not_count() -> None:
    events = [START, event("occurred", END_S + 1.0, [("fA_du", 1)])]
    assert not judge(truth("fA_du"), events, ORIGIN_S).detected


def test_a_test_that_never_could_tell_is_blind_and_spoils_even_peace() -> None:
    quiet = [blind(START, TESTS), blind(event("cannot_tell", 61.5), ["t08"])]
    verdict = judge(truth(), quiet, ORIGIN_S)
    share = round((END_S - 61.5) / (END_S - ORIGIN_S), 3)
    assert verdict.could_tell == {"t02": share, "t06": share, "t08": 0.0}
    assert (verdict.false_alarms, verdict.blind, verdict.good) == (0, ["t08"], False)
    assert judge(truth(), [*quiet, event("cannot_tell", 100.0)], ORIGIN_S).good


def test_no_event_at_all_is_blindness_not_peace() -> None:
    verdict = judge(truth(), [], ORIGIN_S)
    assert (verdict.false_alarms, verdict.blind, verdict.good) == (0, TESTS, False)


@pytest.mark.parametrize("quiet", [[], [START], [START, event("cannot_tell", 80.0)]])
def test_a_missed_fault(quiet: list[Event]) -> None:
    verdict = judge(truth("fA_du"), quiet, ORIGIN_S)
    assert (verdict.detected, verdict.delay_s, verdict.isolated, verdict.first) == (False, None, [], [])
    assert (verdict.contained, verdict.named, verdict.tests, verdict.false_alarms) == (False, False, [], 0)


def test_an_alarm_before_the_onset_is_false_and_detects_nothing() -> None:
    events = [START, event("occurred", 60.0, [("fA_du", 1)], ["t02"]), event("healed", 65.0)]
    verdict = judge(truth("fA_du"), events, ORIGIN_S)
    assert (verdict.false_alarms, verdict.detected, verdict.contained) == (1, False, False)


def test_false_alarms_are_episodes_not_events() -> None:
    events = [
        event("occurred", 20.0, [("fA_t", 1)]),
        event("refined", 25.0, [("fA_t", 1)]),
        event("healed", 30.0),
        event("occurred", 40.0, [("fA_t", 1)]),
        event("healed", 50.0),
        event("occurred", 71.0, [("fA_du", 1)]),
    ]
    verdict = judge(truth("fA_du"), events, ORIGIN_S)
    assert (verdict.false_alarms, verdict.delay_s, verdict.named) == (2, 1.0, True)


@pytest.mark.parametrize(("log_s", "false_alarms", "detected"), [(69.9, 1, False), (70.0, 0, True)])
def test_the_onset_is_log_time_while_events_count_from_the_first_tick(
    log_s: float, false_alarms: int, detected: bool
) -> None:
    """Seconds of log before tick 0 must be added: without them an alarm just after the onset would be called false."""
    verdict = judge(truth("fA_du"), [event("occurred", log_s, [("fA_du", 1)])], ORIGIN_S)
    assert (verdict.false_alarms, verdict.detected) == (false_alarms, detected)


def test_a_fault_free_recording_in_peace() -> None:
    verdict = judge(truth(), [START], ORIGIN_S)
    assert (verdict.faults, verdict.onset_s, verdict.false_alarms) == ([], None, 0)
    assert (verdict.detected, verdict.contained, verdict.named) == (False, False, False)


def test_every_episode_of_a_fault_free_recording_is_a_false_alarm() -> None:
    events = [event("occurred", t, [("fA_du", 1)]) for t in (10.0, 70.0, 110.0)]
    verdict = judge(truth(), events, ORIGIN_S)
    assert (verdict.false_alarms, verdict.detected, verdict.isolated) == (3, False, [])


def test_two_faults_need_both_and_the_first_onset_counts() -> None:
    made = [
        TrueFault(name=name, size=0.5, onset_s=onset, profile="abrupt")
        for name, onset in (("fA_t", 90.0), ("fA_du", 70.0))
    ]
    both = Truth(schema=1, recording="r", fault=made)
    half = judge(both, [event("occurred", 75.0, [("fA_du", 1)])], ORIGIN_S)
    assert (half.onset_s, half.delay_s, half.contained, half.named) == (70.0, 5.0, False, False)
    whole = judge(both, [event("occurred", 95.0, [("fA_du+fA_t", 1), ("fA_du+fA_ori", 2)])], ORIGIN_S)
    assert (whole.contained, whole.named) == (True, True)
    assert whole.isolated == ["fA_du", "fA_t", "fA_ori"]


def test_an_unknown_cause_is_a_detection_that_names_nothing_and_right_of_a_fault_that_no_bundle_knows() -> None:
    told = [event("occurred", 75.0, [("", 1)], ["t02"])]
    verdict = judge(truth("fA_du"), told, ORIGIN_S)
    assert (verdict.detected, verdict.isolated, verdict.contained) == (True, ["unknown"], False)
    leak = judge(truth("leak_ap"), told, ORIGIN_S, known=["fA_du"])
    assert (leak.contained, leak.named, leak.good) == (True, True, True)
    assert not judge(truth("leak_ap"), [event("occurred", 75.0, [("fA_du", 1)])], ORIGIN_S, known=["fA_du"]).contained


def test_two_faults_told_one_by_one_are_not_the_pair() -> None:
    both = Truth(schema=1, recording="r", fault=[*truth("fA_du").fault, *truth("fA_t").fault])
    assert not judge(both, [event("occurred", 75.0, [("fA_du", 1), ("fA_t", 1)])], ORIGIN_S).contained


def test_a_bus_may_be_some_ticks_apart_but_must_tell_the_same_candidates() -> None:
    own = [START, event("occurred", 75.0, [("fA", 1), ("fB", 1)]), event("refined", 80.0, [("fA", 1)])]
    late = [START, event("occurred", 75.4, [("fB", 1), ("fA", 2)]), event("refined", 79.8, [("fA", 1)])]
    assert judging.apart(own, own, 1000) == 0
    assert judging.apart(late, own, 1000) == 2
    assert judging.apart([*late, event("healed", 150.0)], own, 600) == 2  # after the end
    assert judging.apart(late[:2], own, 1000) is None
    assert judging.apart([START, event("occurred", 75.0, [("fC", 1)]), own[2]], own, 1000) is None
    assert judging.apart([START], [START], 1000) == 0
