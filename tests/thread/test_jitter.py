"""What a bus does to a recording, made on purpose: frames late by what a busy machine's scheduler adds."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from faultline.service.bundle.load import load_bundle
from faultline.service.core.decision.decision import RANKING
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import candidates, decode
from faultline.service.logs import Frame, open_log

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
OFFLINE = [decode(line) for line in (GOLDEN / "events.jsonl").read_bytes().splitlines()]

RANKING_TICKS = load_bundle(GOLDEN / "bundle").manifest.time.ticks(RANKING)
USUAL_S, SELDOM_S, SELDOM = 3e-4, 1e-2, 1e-3
"""Lateness [s, wall] of replayed frames as measured: the usual spread, and the worst of one frame in a thousand."""


def late(frames: list[Frame], speed: float, seed: int) -> Iterator[Frame]:
    """The frames as a bus delivers them: in order, each a little late, `speed` times as late in log time."""
    rng = np.random.default_rng(seed)
    wall = np.abs(rng.normal(0.0, USUAL_S, len(frames)))
    wall += np.where(rng.random(len(frames)) < SELDOM, rng.uniform(0.0, SELDOM_S, len(frames)), 0.0)
    arrival = np.maximum.accumulate([frame.t for frame in frames] + speed * wall)
    return (frame._replace(t=float(t - arrival[0])) for frame, t in zip(frames, arrival, strict=True))


@pytest.mark.parametrize("speed", [1.0, 20.0])
@pytest.mark.parametrize("seed", range(5))
def test_lateness_moves_no_event_by_more_than_two_samples_and_a_refinement_by_two_looks(
    speed: float, seed: int
) -> None:
    bundle, log = load_bundle(GOLDEN / "bundle"), open_log(GOLDEN / "log")
    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id)
    events = list(monitor.log(late(list(log.frames()), speed, seed)))
    seen, own = ([(e.transition, candidates(e.diagnoses)) for e in told] for told in (events, OFFLINE))
    assert seen == own, seed  # a probability is of the moment of telling
    for ours, theirs in zip(events, OFFLINE, strict=True):
        looks = (
            2 if ours.transition == "refined" else 0
        )  # which look sees it, and which says it again, hangs on a sample
        assert abs(ours.tick - theirs.tick) <= 2 + looks * RANKING_TICKS, (seed, ours, theirs)
