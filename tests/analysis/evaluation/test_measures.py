"""Blocks, facts, signature, ROC, equal signals and methods on made stories."""

import msgspec
import numpy as np
import pytest
from made_story import GOLDEN, bundle, event, known, story

from faultline.analysis.evaluation.blocks import blocks, cut, scored
from faultline.analysis.evaluation.measure.cases import Case, cases_of
from faultline.analysis.evaluation.measure.equal import equal_groups
from faultline.analysis.evaluation.measure.facts import BINS, EDGES
from faultline.analysis.evaluation.measure.methods import TOGETHER, methods
from faultline.analysis.evaluation.measure.roc import area, curve
from faultline.analysis.evaluation.measure.signature import cells, sensitive
from faultline.analysis.evaluation.sentence import summary
from faultline.analysis.evaluation.story import Array, Story, tell
from faultline.analysis.evaluation.truth import TrueFault, Truth
from faultline.analysis.model.display import Units
from faultline.service.bundle.load import load_bundle
from faultline.service.core.monitor import Monitor
from faultline.service.core.signals.modes import EDGE
from faultline.service.logs import open_log

IDLE, PARTIAL, MAXIMUM = 1, 2, 3  # indices of the dosing system's modes, behind the edge


MINUTE = 300
"""Ticks."""


def made(minutes: int = 4) -> tuple[Array, Array]:
    """Residuals and sums (K, 2), all zero."""
    return np.zeros((minutes * MINUTE, 2)), np.zeros((minutes * MINUTE, 2))


def with_a_fault() -> Story:
    """Four minutes: t02 alarms falsely in the first, truly from 10 s after the onset at 120 s; t08 never."""
    r, sums = made()
    r[2 * MINUTE :, 0] = 3.0
    r[:, 1] = 0.5
    sums[100:110, 0] = 12.0
    sums[2 * MINUTE + 50 :, 0] = -11.0
    return story(r, sums)


def test_the_alarms_of_a_story_are_those_of_the_decision() -> None:
    """For every tick of the golden log the tests with a detector that alarms are those that the vehicle says."""
    bundle, log = load_bundle(GOLDEN / "bundle"), open_log(GOLDEN / "log")
    said: list[list[str]] = []
    watch = Monitor(bundle.manifest, bundle.bank(), bundle.table, "x", bundle.id, lambda _, d: said.append(d.alarm))
    list(watch.log(log.relative()))
    told = tell(bundle, log)
    tests = [generator.test for generator in bundle.manifest.generators]
    assert [[test for test, is_so in zip(tests, row, strict=True) if is_so] for row in told.alarm] == said
    assert told.alarm.any()


def test_blocks_are_about_a_minute_and_do_not_cross_the_onset() -> None:
    whole = story(*made())
    assert [(b.start, b.stop) for b in cut(0, 450, whole)] == [(0, 225), (225, 450)]
    assert cut(0, 149, whole) == []
    assert len(cut(0, 151, whole)) == 1
    assert blocks(whole, 2 * MINUTE).faulty.tolist() == [False, False, True, True]


def test_a_block_counts_where_half_of_it_can_be_told() -> None:
    r, sums = made(2)
    usable = np.ones(r.shape, dtype=np.bool_)
    usable[:151, 0] = False
    found = blocks(story(r, sums, usable), 2 * MINUTE)
    assert found.tells.tolist() == [[False, True], [True, True]]


def test_scores_are_means_by_mode_and_edges_do_not_count() -> None:
    r, sums = made(1)
    mode = np.repeat([IDLE, PARTIAL, MAXIMUM, EDGE], [100, 100, 9, 91]).astype(float)
    r[:100, 0], r[100:200, 0], r[200:209, 0], r[209:, 0] = -2.0, 4.0, 100.0, 1e6
    score = blocks(story(r, sums, mode=mode), MINUTE).scores[0, :, 0]
    assert score[0] == pytest.approx((-200.0 + 400.0 + 900.0) / 209)
    assert score[1:3].tolist() == [2.0, 4.0]
    assert np.isnan(score[3])  # nine ticks are too few


def test_facts_count_what_is_there() -> None:
    one = known(with_a_fault(), ["fA_du"], 120.0)
    assert one.ticks.tolist() == [600, 600]
    assert one.hours.tolist() == pytest.approx([1 / 30, 1 / 30])
    assert one.free_hours == pytest.approx(1 / 30)
    assert one.modes[:, PARTIAL].tolist() == [600, 600]
    assert one.episodes.tolist() == [1, 0]
    assert one.delays_s[0] == pytest.approx(10.0)
    assert np.isnan(one.delays_s[1])
    assert one.square[:, 0].tolist() == [0.0, 600 * 9.0]
    assert one.histogram.shape == (2, 2, BINS)
    assert one.histogram.sum(axis=2).tolist() == [[600, 600], [600, 600]]
    [bin_of_three] = np.flatnonzero(one.histogram[1, 0])
    assert EDGES[bin_of_three] <= 3.0 < EDGES[bin_of_three + 1]
    assert one.products[1].tolist() == [[5400.0, 900.0], [900.0, 150.0]]


def test_an_alarm_that_stands_at_the_onset_is_no_detection_of_the_fault() -> None:
    r, sums = made(2)
    sums[250:, 0] = 12.0
    one = known(story(r, sums), ["fA_du"], 60.0)
    assert one.standing.tolist() == [True, False]
    assert np.isnan(one.delays_s).all()
    [t02, _] = cells([one], story(r, sums).bundle.manifest.generators, ["fA_du"], scored(bundle().manifest))
    assert (t02.standing, t02.delays_s, t02.alarm.hits) == (1, [], 1)


def test_what_is_kept_does_not_grow_with_the_ticks() -> None:
    """Ten times the minutes, at most ten times the blocks; everything else stays as it was."""

    def sizes(minutes: int) -> dict[str, int]:
        one = known(story(*made(minutes)), ["fA_du"], 60.0)
        return {name: value.nbytes for name, value in vars(one).items() if isinstance(value, np.ndarray)}

    assert sizes(2) == sizes(20)
    assert len(known(story(*made(20))).blocks.faulty) == 20


def test_hours_in_which_no_test_could_tell_are_no_peaceful_ones() -> None:
    """Two recordings of 24 minutes: of one nobody could tell in 18, of the other ever."""
    usable = np.ones((24 * MINUTE, 2), dtype=np.bool_)
    usable[: 18 * MINUTE] = False
    usable[: 20 * MINUTE, 1] = False
    told = [event(0)]
    some = known(story(*made(24), usable), events=told)
    assert float(some.hours[0]) == pytest.approx(0.4)
    assert some.free_hours == pytest.approx(0.1)
    none = known(story(*made(24), np.zeros_like(usable)))
    assert none.free_hours == 0.0
    said = summary([some, none])
    assert said.startswith("2 recordings, 0.8 h: 0 of 0 faults detected")
    assert said.endswith(
        "0 false alarms in 0.1 h (95 %: at most 30 an hour); t02, t08 could never tell in 1 of 2 recordings"
    )


def test_an_alarm_that_stands_while_its_test_cannot_tell_is_one_alarm() -> None:
    r, sums = made(2)
    sums[50:250, 0] = 20.0
    usable = np.ones(r.shape, dtype=np.bool_)
    usable[100:150, 0] = False
    one = known(story(r, sums, usable))
    assert one.episodes.tolist() == [1, 0]


def test_residuals_beyond_the_last_bin_are_in_it() -> None:
    r, sums = made(1)
    r[:, 0], r[:, 1] = 1e6, -1e6
    counts = known(story(r, sums)).histogram[0]
    assert (counts[0, -1], counts[1, 0]) == (MINUTE, MINUTE)


def test_the_signature_is_counted_in_blocks() -> None:
    """fA_du is seen by t02 and not by t08; t02 is quiet before the onset but in one block of two."""
    one = known(with_a_fault(), ["fA_du"], 120.0)
    generators = with_a_fault().bundle.manifest.generators
    t02, t08 = cells([one], generators, ["fA_du", "fA_t"], scored(bundle().manifest))
    assert (t02.generator, t02.case, t02.sensitive, t08.sensitive) == ("t02.ode", "fA_du", True, False)
    assert (t02.alarm.hits, t02.alarm.trials, t08.alarm.hits, t08.alarm.trials) == (2, 2, 0, 2)
    assert (t02.delays_s, t02.median_delay_s, t08.delays_s, t08.median_delay_s) == ([10.0], 10.0, [], None)
    assert (t02.cannot_tell, t02.recordings) == (0.0, 1)
    assert (t02.auc["all"], t02.auc["partial"], t02.auc["idle"], t08.auc["all"]) == (1.0, 1.0, None, 0.5)


def test_of_a_fault_that_nobody_knows_the_structure_cannot_say_who_sees_it() -> None:
    [t02, *_] = with_a_fault().bundle.manifest.generators
    assert sensitive(t02, ["leak"], ["fA_du", "fA_t"]) is None
    assert sensitive(t02, ["fA_t"], ["fA_du", "fA_t"]) is False
    assert sensitive(t02, ["fA_t", "fA_du"], ["fA_du", "fA_t"]) is True


def test_the_area_is_the_probability_of_the_larger_score() -> None:
    generator = np.random.default_rng(seed := 7)
    free, faulty = generator.integers(0, 6, 23).astype(float), generator.integers(2, 9, 17).astype(float)
    pairs = [(x > y) + 0.5 * (x == y) for x in faulty for y in free]
    assert area(free, faulty) == pytest.approx(np.mean(pairs)), f"seed {seed}"
    x, y = curve(free, faulty)
    assert np.trapezoid(y, x) == pytest.approx(np.mean(pairs)), f"seed {seed}"
    assert area(np.array([np.nan]), faulty) is None
    assert area(np.array([1.0, np.nan]), np.array([2.0])) == 1.0


def test_signals_are_equal_if_they_are_in_every_part() -> None:
    same = np.array([[1.0, 1.0, 0.5], [1.0, 1.0, 0.5], [0.5, 0.5, 1.0]])
    apart = np.array([[1.0, 0.9, 0.5], [0.9, 1.0, 0.5], [0.5, 0.5, 1.0]])
    silent = np.zeros((3, 3))
    assert equal_groups([same, silent]) == [0, 0, 2]
    assert equal_groups([same, apart]) == [0, 1, 2]
    assert equal_groups([silent]) == [0, 1, 2]
    assert equal_groups([]) == []


def test_methods_of_one_test_are_compared_alone_and_together() -> None:
    """Both generators are taken as ones of t02: one alarms from the onset on, the other in its second block alone."""
    r, sums = made()
    r[2 * MINUTE :, 0] = 3.0
    r[:, 1] = 2.0
    sums[2 * MINUTE :, 0] = 11.0
    sums[MINUTE + 10 : MINUTE + 20, 1] = 11.0
    one = known(story(r, sums), ["fA_du"], 120.0)
    first, second = story(r, sums).bundle.manifest.generators
    assert methods([one], [first, second], ["fA_du"]) == []
    network = msgspec.structs.replace(second, test="t02", name="t02.rnn", faults=first.faults)
    ode, rnn, both = methods([one], [first, network], ["fA_du"])
    assert [m.generator for m in (ode, rnn, both)] == ["t02.ode", "t02.rnn", TOGETHER]
    assert [(m.false.hits, m.false.trials) for m in (ode, rnn, both)] == [(0, 2), (1, 2), (1, 2)]
    assert [(m.found.hits, m.found.trials) for m in (ode, rnn, both)] == [(2, 2), (0, 2), (2, 2)]
    assert [m.crossed.trials for m in (ode, rnn, both)] == [0, 0, 0]
    assert (ode.rms, both.rms) == (0.0, None)
    assert rnn.rms == pytest.approx(2.0)
    assert (ode.auc, rnn.auc, both.auc) == (1.0, 0.5, None)


def test_sizes_of_a_fault_are_cases_of_their_own_unless_they_are_many() -> None:
    def truth(name: str, *faults: tuple[str, float]) -> Truth:
        there = [TrueFault(name=fault, size=size, onset_s=1.0, profile="abrupt", unit="1") for fault, size in faults]
        return Truth(schema=1, recording=name, fault=there)

    few = [truth("a", ("fA", 0.2)), truth("b", ("fA", 0.5)), truth("c", ("fB", 0.5)), truth("d")]
    found = cases_of(few, Units())
    assert [found[name].label for name in "abcd"] == ["fA 20 %", "fA 50 %", "fB", "fault-free"]
    many = [truth(str(k), ("fA", 0.1 * k)) for k in range(1, 5)]
    assert {case.label for case in cases_of(many, Units()).values()} == {"fA"}
    assert cases_of([truth("p", ("fB", 0.5), ("fA", 0.2))], Units())["p"] == Case(("fA", "fB"), "")


def test_the_modes_are_in_the_manifests_order() -> None:
    assert [bundle().manifest.modes.names[number] for number in (IDLE, PARTIAL, MAXIMUM, EDGE)] == [
        "idle",
        "partial",
        "maximum",
        "edge",
    ]
