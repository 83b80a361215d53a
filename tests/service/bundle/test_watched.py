"""A bundle at work on a bus: what is doubted is not believed, and one bundle's failure is its own."""

from collections.abc import Iterator

import pytest
from made_bundle import GOLDEN

from service.bundle import Bundle, load_bundle
from service.bus import Bus, open_bus
from service.core.events import Event
from service.core.health import Condition
from service.core.monitor import Monitor
from service.core.traffic import Traffic
from service.logs import Frame, open_log
from service.watched import FAILED_S, Line, Watched, watched

BUNDLE = load_bundle(GOLDEN)
LOG = open_log(GOLDEN.parent / "log")
MESSAGES = {layout.name for layout in BUNDLE.table.layouts}


def recording(later_s: float = 0.0, until_s: float = 1e9) -> list[Frame]:
    """The golden one, some time later."""
    return [Frame(t + later_s, n, extended, data) for t, n, extended, data in LOG.relative() if t < until_s]


def looked_at(made: Watched, frames: list[Frame], until_s: float) -> dict[float, set[Condition]]:
    """What is wrong at every second, where these frames come."""
    found, waiting = {}, list(frames)
    for second in range(int(until_s)):
        while waiting and waiting[0].t <= second:
            made.frame(waiting.pop(0))
        found[float(second)] = made.look(float(second))
    return found


def test_waiting_for_the_ignition_makes_no_second_sender() -> None:
    """Frames of 30 s had been counted as of 10, and the first of them waited for as long as nothing came."""
    made = watched(load_bundle(GOLDEN), "truck", 1.0)
    found = looked_at(made, recording(60.0, 50.0), 100.0)
    assert {each.kind for second in range(31, 60) for each in found[float(second)]} == {"no-traffic"}
    assert not {each.kind for second in range(61, 100) for each in found[float(second)]} & {
        "second-sender",
        "no-traffic",
    }


def test_signals_of_two_senders_are_told_by_nobody() -> None:
    made = watched(load_bundle(GOLDEN), "truck", 1.0)
    events: list[Event] = []
    for k, frame in enumerate(recording(until_s=60.0)):
        events += made.frame(frame)
        if frame.t > 30.0:
            events += made.frame(frame)  # as somebody else would send it
        if k % 100 == 0:
            found = made.look(frame.t)
    assert {each.of for each in found if each.kind == "second-sender"} == MESSAGES
    assert events[-1].transition == "cannot_tell"
    assert set(events[-1].cannot_tell) == {each.test for each in BUNDLE.manifest.generators}


class Broken(Monitor):
    """One whose numbers fail at the second frame."""

    frames = 0

    def frame(self, t_s: float, can_id: int, is_extended: bool, data: bytes) -> list[Event]:
        self.frames += 1
        if self.frames == 2:
            raise ValueError("a matrix that\ncannot be inverted")
        return []


@pytest.fixture
def bus() -> Iterator[Bus]:
    with open_bus("udp_multicast:239.74.163.2:43197") as made:
        yield made


def test_a_bundle_that_fails_begins_anew_and_the_others_go_on(bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def breaks(bundle: Bundle) -> tuple[Monitor, Traffic]:
        made.append(bundle.id)
        monitor = Broken(bundle.manifest, bundle.bank(), bundle.table, "truck", bundle.id)
        return monitor, Traffic(bundle.table, bundle.manifest.inputs, 0.0)

    said: list[str] = []
    whole = watched(load_bundle(GOLDEN), "truck", 1.0)
    line = Line("powertrain", bus, [Watched(load_bundle(GOLDEN), breaks, 1.0), whole], said.append)
    frames = recording(until_s=20.0)
    monkeypatch.setattr(bus, "receive", lambda: frames[:])
    assert [event.transition for event in line.listen(frames[-1].t)] == ["started"]
    assert len(made) == 2
    assert said == ["bundle uds4 begins anew: a matrix that cannot be inverted"]
    failed = Condition("bundle-failed", "uds4")
    assert failed in line.look(frames[-1].t + 1.0)
    assert failed not in line.look(frames[-1].t + FAILED_S + 1.0)


def test_why_a_bus_cannot_be_opened_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    with open_bus("socketcan:nowhere0", required=False) as absent:
        line = Line("powertrain", absent, [], said.append)
        for second in range(10):
            absent.receive()
            assert {each.kind for each in line.look(float(second))} == {"bus-removed"}
    assert len(said) == 1
    assert said[0].startswith("socketcan:nowhere0: ")
