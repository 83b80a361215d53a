"""What is usual without a fault is learnt anew: the mean of each mode, over visits, with no test that could tell."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from faultline.service.bundle.load import load_bundle
from faultline.service.core.decision.decision import Decision
from faultline.service.core.decision.offsets import shifted
from faultline.service.core.decision.relearning import SEEN, VISITS, Baseline, Relearning, Sums
from faultline.service.core.residuals.generators import Residuals

MANIFEST = load_bundle(Path(__file__).parents[2] / "golden" / "bundle").manifest
MODES, T = len(MANIFEST.modes.names), len(MANIFEST.generators)
EDGE, IDLE, PARTIAL, MAXIMUM = range(4)
OFFSET = np.array([detector.offset for detector in MANIFEST.detectors[:T]])  # (T, modes)
LEAST = MANIFEST.time.ticks(SEEN)


def residuals(mode: int, moved: float = 0.0, usable: bool = True) -> Residuals:
    """All residuals at their offset and so much further, in Pa."""
    r = OFFSET[:, mode] + moved
    shift = np.zeros((len(MANIFEST.evidence.hypotheses), len(MANIFEST.evidence.generators)))
    brought = np.zeros(len(MANIFEST.evidence.consequences), dtype=np.bool_)
    return Residuals(r, r, np.ones(T), np.full(T, usable), shift, brought)


def visits(of: Relearning, count: int, ticks: int, moved: float, *modes: int) -> None:
    for mode in modes * count:
        for _ in range(ticks):
            of.add(mode, residuals(mode, moved))
        of.add(EDGE, residuals(EDGE, moved))


def test_each_mode_is_wanted_several_times_and_long_enough() -> None:
    learning = Relearning(MANIFEST)
    assert learning.wanting == ["idle", "partial", "maximum"]
    visits(learning, 1, VISITS * LEAST, 0.0, IDLE)
    assert "idle" in learning.wanting
    visits(learning, VISITS - 1, 1, 0.0, IDLE)
    assert learning.wanting == ["partial", "maximum"]
    visits(learning, VISITS, LEAST // VISITS - 1, 0.0, PARTIAL, MAXIMUM)
    assert learning.wanting == ["partial", "maximum"]
    visits(learning, 1, LEAST, 0.0, PARTIAL, MAXIMUM)
    assert learning.wanting == []


def test_the_offsets_move_to_the_mean_and_those_of_the_edge_with_the_others() -> None:
    learning = Relearning(MANIFEST)
    visits(learning, VISITS, LEAST, 300.0, IDLE)
    visits(learning, VISITS, LEAST, -600.0, PARTIAL)
    visits(learning, VISITS, LEAST, 900.0, MAXIMUM)
    np.testing.assert_allclose(learning.moved(), np.tile([200.0, 300.0, -600.0, 900.0], (T, 1)), atol=1e-6)
    for _ in range(LEAST):
        learning.add(EDGE, residuals(EDGE, 50.0))
    assert learning.moved()[:, EDGE] == pytest.approx(200.0 - 150.0, abs=30.0)


def test_what_no_test_could_tell_is_not_learnt() -> None:
    learning = Relearning(MANIFEST)
    visits(learning, VISITS, LEAST, 0.0, IDLE, PARTIAL, MAXIMUM)
    for _ in range(LEAST):
        learning.add(IDLE, residuals(IDLE, 1e6, usable=False))
    np.testing.assert_allclose(learning.moved(), 0.0, atol=1e-6)


def test_it_goes_on_from_what_was_kept_and_begins_anew_where_that_is_of_another_bundle() -> None:
    before = Relearning(MANIFEST)
    visits(before, VISITS, LEAST, 300.0, IDLE, PARTIAL)
    kept = msgspec.json.encode(Baseline(bundle="b", begun=None, by="root", sums=before.sums))
    sums = msgspec.json.decode(kept, type=Baseline).sums
    after = Relearning(MANIFEST, sums)
    assert after.wanting == ["maximum"]
    visits(after, VISITS, LEAST, 300.0, MAXIMUM)
    np.testing.assert_allclose(after.moved()[:, 1:], 300.0, atol=1e-6)
    other = Sums(total=[[0.0]], ticks=[[10**6]], visits=[99])
    assert Relearning(MANIFEST, other).wanting == ["idle", "partial", "maximum"]


def test_a_moved_baseline_is_no_fault_once_it_has_been_learnt() -> None:
    """A step of all residuals by 30 kPa, as another sensor makes one."""
    learning, moved = Relearning(MANIFEST), 3e4
    visits(learning, VISITS, LEAST, moved, IDLE, PARTIAL, MAXIMUM)
    for manifest, is_told in ((MANIFEST, True), (shifted(MANIFEST, learning.moved()), False)):
        decision = Decision(manifest)
        for tick in range(400):
            decision.update(tick, IDLE, residuals(IDLE, moved))
        assert bool(decision.alarm) is is_told
