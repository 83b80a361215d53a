"""The baseline's filter and the likelihood ratios beside it, on data drawn from the very model."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from uds_time import IDLE, MAXIMUM, PARTIAL, TIME

from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel, signature
from faultline.service.core.decision.baseline_level import BaselineLevel
from faultline.service.core.decision.blocks import Block, BlockMeans, side_by_side
from faultline.service.core.decision.change_detector import ONSETS, ChangeDetector
from faultline.service.core.decision.drive_change import DriveChange, nats
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.straying import Means
from faultline.service.core.manifest import Evidence, Follower, Hypothesis, Twin
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE

Array = npt.NDArray[np.float64]

STRAY, OWN, NOISE, VISIT = 100.0, 5.0, 10.0, 3.0
NAMES = ["ta", "tb"]
NOTHING = np.zeros((1, 2))
FAULT = np.array([60.0, -60.0])  # no drift moves one up and the other down
TICKS = 15
SUSPECTED = nats(10.0, 1, TIME)
SMALL = 0.1


def evidence(**changed: Any) -> Evidence:
    given: dict[str, Any] = {
        "generators": NAMES,
        "offset": [[1000.0, 2000.0]] * 4,
        "spread": [[NOISE, NOISE]] * 4,
        "noise": [(NOISE**2 * np.eye(2)).tolist()] * 4,
        "visit": [(VISIT**2 * np.eye(2)).tolist()] * 4,
        "allowance": [[OWN, OWN]] * 4,
        "drifts": [[[STRAY, STRAY]] * 4],
        "operation": [[0.0, 0.0]] * 4,
        "followers": [],
        "graph": "faults.onnx",
        "hypotheses": [Hypothesis(fault="fA", size=1.0)],
    }
    return Evidence(**(given | changed))


MODEL = BaselineModel(evidence(), TIME)
SEGMENTS = Hypotheses(evidence()).segments


def block_of(end_s: float, mode: int, begins: bool, ticks: int, mean: Array) -> Block:
    """A block in which both generators could tell at all ticks."""
    return Block(
        end_s=np.array([end_s]),
        mode=np.array([mode]),
        begins=np.array([begins]),
        ticks=np.full((1, 2), float(ticks)),
        mean=mean,
        part=np.full((1, 2, 2), 1.0 / ticks),
        shift=FAULT[None, None],
        excess=NOTHING,
    )


def drawn(rng: np.random.Generator, blocks: int, onset: int = 10**9, size: float = 0.0) -> list[Block]:
    """Blocks of a drive, four a visit, drawn from the model; from the onset on with a fault."""
    x = rng.multivariate_normal(np.zeros(MODEL.states), MODEL.stationary[IDLE])
    made, end_s = [], 0.0
    for k in range(blocks):
        mode, begins = (IDLE, PARTIAL, MAXIMUM)[k // 4 % 3], k % 4 == 0
        end_s += TICKS * TIME.period_s
        F = np.exp(-TICKS * TIME.period_s / MODEL.tau)
        F[MODEL.visit] *= not begins
        P = MODEL.stationary[mode]
        x = F * x + rng.multivariate_normal(np.zeros(MODEL.states), P - F[:, None] * P * F)
        y = MODEL.offset[mode] + MODEL.observe[mode] @ x + NOISE / np.sqrt(TICKS) * rng.standard_normal(2)
        y = y + (size * FAULT if k >= onset else 0.0)
        made.append(block_of(end_s, mode, begins, TICKS, y[None]))
    return made


def test_innovations_without_a_fault_are_white_and_standard() -> None:
    white = []
    for seed in range(40):
        known = BaselineFilter(MODEL)
        white.append([known.step(block).white[0] for block in drawn(np.random.default_rng(seed), 60)])
    e = np.array(white)
    assert e.std() == pytest.approx(1.0, abs=0.04)
    assert np.mean(e[:, 1:] * e[:, :-1]) == pytest.approx(0.0, abs=0.04)
    assert np.mean(e[..., 0] * e[..., 1]) == pytest.approx(0.0, abs=0.05)


def test_the_clairvoyant_ratio_has_the_mean_and_the_variance_that_its_information_says() -> None:
    """Onset and size known: LLR ~ N(A / 2, A) under the fault, N(-A / 2, A) without."""
    size, found, information = 0.25, [], 0.0
    for seed in range(300):
        with_fault = seed % 2 == 0
        blocks = drawn(np.random.default_rng(seed), 50, 25 if with_fault else 10**9, size)
        known, effect, A, c = BaselineFilter(MODEL), np.zeros((1, 1, MODEL.states)), 0.0, 0.0
        for k, block in enumerate(blocks):
            innovation = known.step(block)
            if k >= 25:
                effect, g = signature(effect, innovation, size * block.shift, np.ones((1, 2)))
                A += float((g**2).sum())
                c += float(g[0, 0] @ innovation.white[0])
        found.append(c - A / 2.0)
        information = A
    there, none = np.array(found[::2]), np.array(found[1::2])
    assert there.mean() == pytest.approx(information / 2.0, abs=3.0 * np.sqrt(information / 150))
    assert none.mean() == pytest.approx(-information / 2.0, abs=3.0 * np.sqrt(information / 150))
    assert there.var() == pytest.approx(information, rel=0.35)


def test_the_detector_finds_fault_and_onset_and_is_quiet_without() -> None:
    quiet, found = [], []
    for seed in range(20):
        detector = ChangeDetector(MODEL, SEGMENTS, 1)
        quiet.append(max(float(detector.step(b).log_ratio[0]) for b in drawn(np.random.default_rng(seed), 150)))
        detector = ChangeDetector(MODEL, SEGMENTS, 1)
        for block in drawn(np.random.default_rng(seed), 60, 30, 0.6):
            change = detector.step(block)
        assert change.log_ratio[0] > SUSPECTED
        assert detector.faults[change.fault[0]] == "fA"
        found.append(detector.onset_s[0, change.onset[0]])
    assert max(quiet) < SUSPECTED
    assert np.median(found) == pytest.approx(30 * TICKS * TIME.period_s, abs=2 * TICKS * TIME.period_s)


def test_a_shift_that_no_hypothesis_makes_is_the_undeclared_fault() -> None:
    detector = ChangeDetector(MODEL, SEGMENTS, 1)
    for k, block in enumerate(drawn(np.random.default_rng(1), 60)):
        away = np.array([[0.0, 40.0 if k >= 30 else 0.0]])
        change = detector.step(block._replace(mean=block.mean + away))
    assert change.log_ratio[0] > SUSPECTED
    assert change.fault[0] == len(detector.faults)


APPARENT = Hypothesis(fault="fA", size=1.0, usual=[FAULT.tolist()] * 4)


def in_changing_operation(apparent: float, onset: int, size: float) -> list[Block]:
    """Blocks in which the fault's shift goes up and down with the operation; `apparent` of it is there throughout."""
    found = []
    for k, block in enumerate(drawn(np.random.default_rng(5), 600)):
        shift = block.shift * (1.0 + 0.5 * np.sin(0.7 * k))
        there = apparent + (size if k >= onset else 0.0)
        found.append(block._replace(shift=shift, mean=block.mean + there * shift[:, 0]))
    return found


def test_what_the_model_lacks_is_no_fault_from_the_start_however_long_it_lasts() -> None:
    largest = {}
    for name, hypothesis in (("without", Hypothesis(fault="fA", size=1.0)), ("with", APPARENT)):
        model = BaselineModel(evidence(hypotheses=[hypothesis]), TIME)
        detector = ChangeDetector(model, SEGMENTS, 1)
        ratios = [float(detector.step(block).log_ratio[0]) for block in in_changing_operation(0.1, 600, 0.0)]
        largest[name] = max(ratios)
    assert largest["without"] > 2.0 * SUSPECTED
    assert largest["with"] < SUSPECTED / 2.0


def test_a_fault_that_begins_in_such_a_drive_is_found() -> None:
    detector = ChangeDetector(BaselineModel(evidence(hypotheses=[APPARENT]), TIME), SEGMENTS, 1)
    found = []
    for block in in_changing_operation(0.1, 300, 0.3):
        change = detector.step(block)
        if change.log_ratio[0] > SUSPECTED:
            found.append((float(block.end_s[0]), float(detector.onset_s[0, change.onset[0]])))
    at, onset = found[0]
    began = 300 * TICKS * TIME.period_s
    assert began < at < began + 60.0
    assert onset == pytest.approx(began, abs=30.0)


def test_an_apparent_fault_moves_usual_means_as_far_as_the_baseline_does() -> None:
    model = BaselineModel(evidence(hypotheses=[APPARENT]), TIME)
    only = model.prior(1).covariance[0].copy()
    only[model.apparent] = only[:, model.apparent] = 0.0
    none = model.levels(model.prior(1)._replace(covariance=only[None]))[1][0]
    shift = np.tile(FAULT, 3) * model.apparent_part[0]
    assert shift @ np.linalg.solve(none, shift) == pytest.approx(1.0)
    both = model.levels(model.prior(1))[1][0]
    np.testing.assert_allclose(both - none, np.outer(shift, shift), atol=1e-9)
    tiny = Hypothesis(fault="fA", size=1.0, usual=[[1e-3, 0.0]] * 4)
    assert BaselineModel(evidence(hypotheses=[tiny]), TIME).apparent_part.tolist() == [1.0], "the size itself at most"
    still = evidence(hypotheses=[APPARENT], allowance=[[0.0, 0.0]] * 4, drifts=[])
    assert BaselineModel(still, TIME).apparent_part == pytest.approx([0.0], abs=1e-9), "nothing strays"


def test_a_window_has_the_level_of_its_own_operation() -> None:
    given = evidence(hypotheses=[APPARENT])
    model = BaselineModel(given, TIME)
    known = BaselineFilter(model)
    for block in in_changing_operation(0.1, 600, 0.0)[:100]:
        known.step(block)
    baseline = BaselineLevel(given, NAMES, model)
    baseline.follow(known.state)
    ticks = np.full((3, 2), 30.0)
    ticks[2] = 0.0  # a mode that was not visited is as usual
    shift = np.array([2.0, 0.5, 7.0])[:, None] * FAULT
    nothing = np.zeros((3, 2))
    means = Means(ticks, nothing, nothing, nothing, ticks * shift[None], np.zeros((0, 3, 2)), nothing)
    found = baseline.level.in_operation(means)
    H = model.usual.copy()
    H[:4, model.apparent] = model.apparent_part * shift[:2].reshape(4, 1)
    np.testing.assert_allclose(found.mean.ravel(), H @ known.state.mean[0], atol=1e-9)
    np.testing.assert_allclose(found.covariance, H @ known.state.covariance[0] @ H.T, atol=1e-9)


def test_onsets_grow_sparser_with_their_age_and_the_start_of_the_drive_stays() -> None:
    detector = ChangeDetector(MODEL, SEGMENTS, 1)
    for block in drawn(np.random.default_rng(2), 600):
        detector.step(block)
    onsets = detector.onset_s[0]
    assert len(onsets) == ONSETS
    assert onsets[0] == 0.0
    assert np.diff(onsets)[-3:] == pytest.approx(TICKS * TIME.period_s)
    assert np.diff(onsets)[0] > 20.0 * TICKS * TIME.period_s


def test_logs_side_by_side_give_what_each_gives_alone() -> None:
    logs = [drawn(np.random.default_rng(seed), length, 20, 0.4) for seed, length in ((3, 50), (4, 70))]
    together = ChangeDetector(MODEL, SEGMENTS, 1, logs=2)
    ratios = [together.step(block).log_ratio for block in side_by_side(logs)]
    for row, log in enumerate(logs):
        alone = ChangeDetector(MODEL, SEGMENTS, 1)
        expected = [alone.step(block).log_ratio[0] for block in log]
        np.testing.assert_allclose(np.array(ratios)[: len(log), row], expected, rtol=1e-9, atol=1e-9)


def test_a_block_is_of_one_visit_and_of_ticks_that_can_tell() -> None:
    blocks = BlockMeans(evidence(), NAMES, TIME)
    made = []
    modes = [IDLE] * 22 + [EDGE] * 5 + [IDLE] * 4 + [PARTIAL] * 15
    for tick, mode in enumerate(modes):
        r = np.array([1.0, np.nan if tick % 2 else 3.0])
        usable = np.array([True, tick % 2 == 0])
        block = blocks.add(tick, mode, Residuals(r, r, r, usable, np.zeros((1, 2))))
        made += [] if block is None else [block]
    assert [(int(b.mode[0]), bool(b.begins[0]), b.ticks[0].tolist()) for b in made] == [
        (IDLE, True, [15.0, 8.0]),
        (IDLE, False, [7.0, 0.0]),  # too few of one, and the four ticks after the edge are too few of both
        (PARTIAL, True, [15.0, 7.0]),
    ]
    assert made[0].mean[0].tolist() == [1.0, 3.0]
    assert float(made[0].end_s[0]) == pytest.approx(14 * TIME.period_s)
    np.testing.assert_allclose(made[0].part[0], [[1 / 15, 1 / 15], [1 / 15, 1 / 8]])
    assert made[2].part[0, 0, 1] == pytest.approx(7 / (15 * 7))


def test_noise_in_common_cancels_at_the_same_ticks_only() -> None:
    """Residuals with the same noise, each with other ticks missing: their difference is as large as is expected."""
    alike = (NOISE**2 * np.array([[1.0, 1.0 - 1e-6], [1.0 - 1e-6, 1.0]])).tolist()
    given = evidence(noise=[alike] * 4, visit=[np.zeros((2, 2)).tolist()] * 4, allowance=[[1e-3, 1e-3]] * 4)
    rng, model, white = np.random.default_rng(1), BaselineModel(given, TIME), []
    for _ in range(1000):
        blocks, known = BlockMeans(given, NAMES, TIME), BaselineFilter(model)
        lost = rng.choice(TICKS, 4, replace=False).reshape(2, 2)
        for tick in range(TICKS):
            r = np.array([1000.0, 2000.0]) + NOISE * rng.standard_normal()
            usable = np.array([tick not in lost[0], tick not in lost[1]])
            block = blocks.add(tick, IDLE, Residuals(r, r, r, usable, np.zeros((1, 2))))
        assert block is not None
        np.testing.assert_allclose(block.part[0], np.array([[13, 11], [11, 13]]) / 13**2)
        white.append(known.step(block).white[0])
    assert np.mean(np.square(white)[:, 1]) == pytest.approx(1.0, abs=0.15)


def test_detectors_see_what_is_unknown_of_the_baseline_as_their_own_spread_and_followers_go_with_it() -> None:
    follower = Follower(generator="tc", offset=[500.0] * 4, spread=[NOISE] * 4, drifts=[[-3.0 * STRAY] * 4])
    given = evidence(followers=[follower])
    baseline = BaselineLevel(given, [*NAMES, "tc"], MODEL)
    away = np.array([1080.0, 2080.0, 260.0])
    before = baseline.taken_off(IDLE, away) - [1000.0, 2000.0, 500.0]
    assert (np.abs(before) < NOISE).all()
    known = BaselineFilter(MODEL)
    for k in range(40):
        y = np.array([[1080.0, 2080.0]])
        known.step(block_of(3.0 * k, IDLE, k == 0, 15, y))
    baseline.follow(known.state)
    for mode in (EDGE, IDLE, PARTIAL):
        assert np.abs(baseline.taken_off(mode, away) - [1000.0, 2000.0, 500.0]).max() < 0.6 * NOISE
    faulty = away + np.array([0.0, 0.0, 300.0])
    assert 5.0 * NOISE < baseline.taken_off(PARTIAL, faulty)[2] - baseline.taken_off(PARTIAL, away)[2] <= 300.0


def test_a_network_goes_with_its_twin_but_for_how_far_the_two_stray_apart() -> None:
    twin = Twin(generator="na", twin=NAMES[0], offset=[50.0] * 4, spread=[NOISE] * 4, allowance=[0.0, 0.0, 0.0, 200.0])
    given = evidence(networks=[twin])
    baseline = BaselineLevel(given, [*NAMES, "na"], MODEL)
    known = BaselineFilter(MODEL)
    for k in range(40):
        y = np.array([[1080.0, 2080.0]])
        known.step(block_of(3.0 * k, IDLE, k == 0, 15, y))
    baseline.follow(known.state)
    level = baseline.taken_off(IDLE, np.array([1080.0, 2080.0, 130.0]))
    assert level[2] - 50.0 == pytest.approx(level[0] - 1000.0, abs=1e-6)
    idle, maximum = (baseline.taken_off(mode, np.array([1080.0, 2080.0, 430.0]))[2] - 50.0 for mode in (IDLE, MAXIMUM))
    assert 0.0 < 5.0 * maximum < idle, "where the two stray apart little is known of its level"


class Driven:
    """The change of a drive, fed as the decision does. State: the tick."""

    def __init__(self) -> None:
        made = evidence()
        self.change, self.tick = DriveChange(made, NAMES, Hypotheses(made), TIME), 0

    def drive(self, seconds: float, level: float, fault: float = 0.0, *, usable: bool = True) -> bool:
        """Whether it alarms at the end."""
        rng = np.random.default_rng(self.tick)
        for _ in range(round(seconds / TIME.period_s)):
            r = np.array([1000.0, 2000.0]) + level + fault * FAULT + NOISE * rng.standard_normal(2)
            seen = Residuals(r, 0.0 * r, r, np.full(2, usable), FAULT[None])
            self.change.extend(self.tick, IDLE, seen.in_a_row, suspected=self.change.alarm)
            if self.tick % TICKS == 0:
                self.change.look()
            self.tick += 1
        return self.change.alarm


def test_the_baseline_is_held_at_what_it_was_before_the_fault() -> None:
    driven = Driven()
    assert not driven.drive(120.0, 80.0)
    assert driven.drive(30.0, 80.0, fault=0.6)
    driven.change.hold()
    for _ in range(20):
        assert driven.drive(60.0, 80.0, fault=0.6)
    assert driven.change.level.mean[IDLE - 1] == pytest.approx([80.0, 80.0], abs=6.0)
    assert not driven.drive(120.0, 80.0), "it is over"


def test_a_small_fault_that_is_held_lasts_until_it_is_gone() -> None:
    """The last 30 s alone do not show it."""
    driven = Driven()
    driven.drive(240.0, 0.0)
    assert driven.drive(600.0, 0.0, fault=SMALL)
    driven.change.hold()
    assert all(driven.drive(60.0, 0.0, fault=SMALL) for _ in range(5))
    assert not driven.drive(900.0, 0.0)


def test_a_fault_from_the_start_that_no_drive_could_have_is_suspected() -> None:
    driven = Driven()
    assert driven.drive(60.0, -120.0, fault=0.8)
    assert np.abs(driven.change.level.mean).max() < 1e-9, "nothing is known of the baseline then"


def test_what_is_accepted_becomes_the_baseline() -> None:
    driven = Driven()
    driven.drive(120.0, 0.0)
    assert driven.drive(60.0, 0.0, fault=0.6)
    driven.change.accept()
    assert not driven.change.alarm


def test_evidence_that_could_not_tell_for_long_begins_anew() -> None:
    driven = Driven()
    driven.drive(120.0, 150.0)
    assert driven.drive(30.0, 150.0, fault=1.0)
    assert not driven.drive(310.0, 0.0, usable=False)
    assert not driven.drive(120.0, -150.0)
