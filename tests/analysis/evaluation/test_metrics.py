"""Benchmarks' figures of hand-made events: every tick is counted by hand."""

import numpy as np
import pytest
from made_story import event

from faultline.analysis.evaluation.measure.isolation import columns
from faultline.analysis.evaluation.measure.metrics import NOTHING, PAIR, Told, scores, standing, told
from faultline.analysis.evaluation.weights import UNKNOWN, UNNAMED, true_explanation, weights
from faultline.service.core.records.event import Event

KNOWN = ("fA", "fB", "fC")


def of(*events: Event, faults: tuple[str, ...] = ("fA",), onset: int = 40, blind: slice = slice(0)) -> Told:
    telling = np.ones(100, dtype=np.bool_)
    telling[blind] = False
    return told(events, telling, onset=onset, period_s=0.2, faults=faults, known=KNOWN)


def test_a_fault_found_late_shared_and_then_alone() -> None:
    """Ticks 50 to 69: fA and fB share rank 1; 70 to 99: fA alone."""
    t = of(event(0), event(50, ("fA", 1), ("fB", 1), ("fC", 3)), event(70, ("fA", 1), ("fB", 2)))
    assert (t.free_ticks, t.false_ticks, t.faulty_ticks, t.detected_ticks) == (40, 0, 60, 50)
    assert (t.isolated_ticks, t.mistaken_ticks) == (30, 0)
    assert t.weight == pytest.approx(20 * 0.5 + 30 * 1.0)
    assert (t.detection_s, t.isolation_s) == (2.0, 6.0)
    assert (t.rank, t.p, t.alone, t.size, t.shared) == (1, None, True, 2, True)
    s = scores([t])
    assert (s.tdr, s.far) == (50 / 60, 0.0)
    assert s.fia == pytest.approx(40 / 50)
    assert (s.true_isolation, s.false_isolation) == (0.5, 0.0)


def test_a_false_alarm_counts_before_the_onset_and_a_wrong_name_after_it() -> None:
    t = of(event(10, ("fB", 1)), event(20), event(60, ("fB", 1), ("fA", 2)))
    assert (t.false_ticks, t.detected_ticks, t.mistaken_ticks, t.weight) == (10, 40, 40, 0.0)
    assert (t.rank, t.alone, t.isolation_s) == (2, False, None)
    assert scores([t]).far == 0.25


def test_ticks_in_which_no_test_could_tell_are_no_peace_and_no_false_alarm() -> None:
    t = of(event(10, ("fB", 1)), event(30), blind=slice(5, 20))
    assert (t.free_ticks, t.false_ticks, t.faulty_ticks) == (25, 10, 60)
    assert scores([t]).far == 10 / 25
    assert scores([of(event(0), blind=slice(0, 100))]).far is None


def test_probabilities_that_are_told_are_taken_as_told() -> None:
    t = of(event(40, ("fA", 1, 0.7), ("fB", 2, 0.2), ("", 3, 0.1)))
    assert t.weight == pytest.approx(60 * 0.7)
    assert (t.p, t.shared) == (0.7, False)
    assert t.standing == {"fA": 0.7, "fB": 0.2, UNNAMED: 0.1}


def test_what_is_lost_and_found_again_is_detected_when_it_was_found_again() -> None:
    """DAMADICS counts to the last rising edge."""
    t = of(event(45, ("fA", 1)), event(60), event(80, ("fA", 1)))
    assert (t.detection_s, t.detected_ticks) == (8.0, 35)
    lost = of(event(45, ("fA", 1)), event(60))
    assert (lost.detection_s, lost.isolation_s, lost.detected_ticks, lost.standing) == (None, None, 15, {NOTHING: 1.0})


def test_one_that_stands_from_the_onset_on_is_detected_at_once() -> None:
    assert of(event(30, ("fA", 1))).detection_s == 0.0


def test_the_right_answer_to_a_fault_that_nobody_knows_is_unknown() -> None:
    named = of(event(50, ("fA", 1)), faults=("leak",))
    assert (named.weight, named.mistaken_ticks, named.rank) == (0.0, 50, None)
    unknown = of(event(50, ("", 1)), faults=("leak",))
    assert (unknown.weight, unknown.isolated_ticks, unknown.alone) == (50.0, 50, True)
    assert true_explanation(("fA", "leak"), KNOWN) == UNKNOWN


def test_two_faults_are_told_by_the_pair_and_by_nothing_less() -> None:
    both = of(event(50, ("fA+fB", 1), ("fA+fC", 1)), faults=("fB", "fA"))
    assert (both.weight, both.rank, both.standing) == (25.0, 1, {"fA+fB": 0.5, PAIR: 0.5})
    assert of(event(50, ("fA", 1)), faults=("fA", "fB")).weight == 0.0
    assert standing([*event(0, ("fA+fB", 1)).diagnoses], frozenset({"fA"})) == {PAIR: 1.0}


def test_a_fault_free_recording_has_no_detection_and_nothing_at_its_end() -> None:
    t = of(event(0), event(90, ("fB", 1)), faults=(), onset=100)
    assert (t.free_ticks, t.false_ticks, t.faulty_ticks, t.rank, t.size) == (100, 10, 0, None, 0)
    s = scores([t])
    assert (s.tdr, s.far, s.fia, s.true_isolation) == (None, 0.1, None, None)


def test_what_is_told_after_the_last_tick_does_not_count() -> None:
    assert of(event(0), event(100, ("fA", 1))).detected_ticks == 0


def test_recordings_weigh_by_their_samples() -> None:
    found, missed = of(event(40, ("fA", 1))), of(event(0), onset=80)
    assert scores([found, missed]).tdr == 60 / 80


def test_equal_weights_are_of_rank_one_alone() -> None:
    diagnoses = event(0, ("fA", 1), ("fB", 1), ("fA+fC", 1), ("fC", 4)).diagnoses
    assert weights(diagnoses) == {frozenset(n.split("+")): pytest.approx(1 / 3) for n in ("fA", "fB", "fA+fC")}
    assert weights([]) == {}


def test_the_confusion_has_a_column_for_whatever_is_told() -> None:
    assert columns([], KNOWN) == [*KNOWN, PAIR, NOTHING]
