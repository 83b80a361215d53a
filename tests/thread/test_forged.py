"""Forged frames beside the controller's own: no fault is told of them, and a second sender is, at once."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from faultline.service.bundle.load import load_bundle
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Event, candidates
from faultline.service.core.records.health import Conditions
from faultline.service.daemon.pipeline import watched
from faultline.service.logs import Frame, open_log

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FRAMES = list(open_log(GOLDEN / "log").relative())
ONSET_S = 70.0
ECU = 0x18FF103D
KILOPASCAL = 20  # raw values of y_p_du


def forged(every: int, later_s: float, begin_s: float = 45.0) -> list[Frame]:
    """Each `every`th frame of the controller has a twin so much later [s], with 100 kPa more in the dosing unit."""
    own = [frame for frame in FRAMES if frame.can_id == ECU and frame.t > begin_s]
    twins = [
        frame._replace(
            t=frame.t + later_s,
            data=(int.from_bytes(frame.data[:2], "little") + 100 * KILOPASCAL).to_bytes(2, "little") + frame.data[2:],
        )
        for frame in own[::every]
    ]
    return sorted([*FRAMES, *twins], key=lambda frame: frame.t)


def driven(frames: Iterable[Frame]) -> tuple[list[Event], dict[str, float]]:
    """The events on a bus, and when each kind of condition was told first [s]."""
    made, conditions = watched(load_bundle(GOLDEN / "bundle"), "truck", 1.0), Conditions()
    events: list[Event] = []
    told: dict[str, float] = {}
    due = 1.0
    for frame in frames:
        events += made.hear([frame])
        if frame.t >= due:
            due = frame.t + 1.0
            conditions.update(frame.t, made.look(frame.t))
            told |= {each.kind: frame.t for each in conditions.standing if each.kind not in told}
    return events, told


@pytest.mark.parametrize(("every", "later_s"), [(8, 0.001), (2, 0.001), (8, -0.001), (8, 0.12), (1, 0.1)])
def test_forged_frames_make_no_fault_and_a_second_sender_at_once(every: int, later_s: float) -> None:
    events, told = driven(frame for frame in forged(every, later_s) if frame.t < ONSET_S)
    assert [event.transition for event in events if event.diagnoses or event.suspected] == []
    assert 45.0 < told["second-sender"] < 47.5
    assert len(events[-1].cannot_tell) == 10


def test_a_fault_from_before_stands_while_frames_are_forged() -> None:
    events, told = driven(forged(8, 0.001, begin_s=90.0))
    assert "occurred" in {event.transition for event in events}
    assert told["second-sender"] > 90.0
    assert events[-1].diagnoses
    assert len(events[-1].cannot_tell) == 10


@pytest.mark.parametrize("seed", range(3))
def test_jitter_and_a_repeating_gateway_change_neither_health_nor_what_is_told(seed: int) -> None:
    rng = np.random.default_rng(seed)
    late = [frame._replace(t=frame.t + rng.uniform(0.0, 0.02)) for frame in FRAMES]
    again = [frame._replace(t=frame.t + rng.uniform(0.0, 0.02)) for frame in late]
    events, told = driven(sorted([*late, *again], key=lambda frame: frame.t))
    usual, _ = driven(FRAMES)
    assert "second-sender" not in told, seed
    assert [candidates(e.diagnoses) for e in events] == [candidates(e.diagnoses) for e in usual], seed


@pytest.mark.parametrize(("age_s", "last"), [(40.0, "withdrawn"), (5.0, "occurred")])
def test_a_fault_that_rests_on_samples_doubted_later_is_withdrawn(age_s: float, last: str) -> None:
    """Suspected at 72 s: a crowd found at 105 s that began at 65 s has made it; one that began at 100 s has not."""
    bundle = load_bundle(GOLDEN / "bundle")
    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, "truck", bundle.id)
    events = [event for frame in FRAMES if frame.t < 105.0 for event in monitor.frame(*frame)]
    monitor.doubt({"y_p_du": age_s})
    events += monitor.advance(110.0)
    assert [event.transition for event in events if event.transition != "cannot_tell"][-1] == last
    assert bool(events[-1].diagnoses) == (last == "occurred")
