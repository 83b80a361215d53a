"""The recorder: what it holds, and what becomes of a frame whose time is gone."""

from pathlib import Path

import numpy as np
import pytest

from faultline.service.bundle.load import load_bundle
from faultline.service.core.memory.freeze import Recorder, Sample
from faultline.service.core.records.event import SCHEMA, Event
from faultline.service.core.signals.values import Quality

MANIFEST = load_bundle(Path(__file__).resolve().parents[2] / "golden" / "bundle").manifest
NZ, T = len(MANIFEST.inputs), len(MANIFEST.generators)


def sample(tick: int, quality: Quality = Quality.GOOD, value: float = 1.0) -> Sample:
    return Sample(
        tick=tick,
        mode=0,
        z=np.full(NZ, value),
        quality=np.full(NZ, quality, dtype=np.int8),
        r=np.full(T, float(tick)),
        y_hat=np.ones(T),
        sigma=np.ones(T),
        usable=np.ones(T, dtype=np.bool_),
        sums=np.zeros(T),
        alarm=["t02"],
        cannot_tell=[],
        diagnoses=[],
        suspected=True,
        suspicious=True,
        showing=["idle"],
    )


def event(tick: int) -> Event:
    return Event(
        schema=SCHEMA, id="truck-1", seq=1, tick=tick, t_s=0.2 * tick, wall=None, transition="occurred", diagnoses=[],
        alarm=["t02"], cannot_tell=[], since_tick=None, bundle="0" * 64,
    )  # fmt: skip


def test_a_frame_is_complete_once_as_much_came_after_it_as_before() -> None:
    recorder = Recorder(MANIFEST, 2.0)
    for tick in range(100):
        recorder.add(sample(tick))
    frame = recorder.frame(event(99), [], {"frames": 1})
    assert (frame.complete, frame.excerpt.first_tick, len(frame.excerpt.mode)) == (False, 89, 11)
    for tick in range(100, 109):
        recorder.add(sample(tick))
        assert recorder.completed(frame) is None
    for tick in range(109, 114):  # it is looked for once a second
        recorder.add(sample(tick))
    done = recorder.completed(frame)
    assert done is not None
    assert done.complete
    assert (done.excerpt.first_tick, len(done.excerpt.mode)) == (89, 21)
    assert done.excerpt.residuals["t02.ode"] == [float(tick) for tick in range(89, 110)]


def test_the_last_good_value_is_kept_with_its_age() -> None:
    recorder = Recorder(MANIFEST, 2.0)
    recorder.add(sample(0, value=7.0))
    for tick in range(1, 6):
        recorder.add(sample(tick, Quality.LATE, 7.0))
    frame = recorder.frame(event(5), [], {})
    assert {(each.value, each.age_s, each.quality) for each in frame.inputs} == {(7.0, 1.0, "late")}
    assert {*map(tuple, frame.excerpt.signals.values())} == {(7.0, None, None, None, None, None)}


def test_what_was_never_good_has_no_value() -> None:
    recorder = Recorder(MANIFEST, 2.0)
    recorder.add(sample(0, Quality.MISSING, float("nan")))
    frame = recorder.frame(event(0), [], {})
    assert {(each.value, each.age_s, each.quality) for each in frame.inputs} == {(None, None, "missing")}


@pytest.mark.parametrize("after", [0, 3000], ids=["begun anew", "a gap"])
def test_a_frame_whose_time_is_gone_stays_as_it_is(after: int) -> None:
    recorder = Recorder(MANIFEST, 2.0)
    for tick in range(100):
        recorder.add(sample(tick))
    frame = recorder.frame(event(99), [], {})
    recorder.add(sample(after))
    assert recorder.completed(frame) == frame
    assert not frame.complete
    assert len(recorder.frame(event(after), [], {}).excerpt.mode) == 1, "nothing of the time before"
