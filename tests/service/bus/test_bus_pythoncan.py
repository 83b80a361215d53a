"""Any interface of python-can's: its virtual one, which needs nothing, and one that fails when it is told."""

from collections.abc import Iterator
from typing import Any

import can
import pytest

from faultline.service.bus import BusError, open_bus
from faultline.service.bus.pythoncan import LONGEST_RETRY_S, PythonCan
from faultline.service.logs import Frame


@pytest.fixture
def ends(request: pytest.FixtureRequest) -> Iterator[tuple[PythonCan, can.BusABC]]:
    channel = request.node.name
    bus = open_bus(f"can:virtual:{channel}")
    assert isinstance(bus, PythonCan)
    with bus, can.Bus(interface="virtual", channel=channel, ignore_config=True) as other:
        yield bus, other


def message(can_id: int, data: bytes = b"ab", **more: Any) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, **more)


def test_receives_and_sends(ends: tuple[PythonCan, can.BusABC]) -> None:
    bus, other = ends
    assert (bus.fileno(), bus.is_asked, bus.dropped, bus.receive()) == (-1, True, 0, [])
    for can_id, extended in ((0x18FF103D, True), (0x123, False)):
        other.send(message(can_id, is_extended_id=extended))
    other.send(message(0x123, b"", is_extended_id=False, is_remote_frame=True))
    assert [frame[1:] for frame in bus.receive()] == [(0x18FF103D, True, b"ab"), (0x123, False, b"ab")]
    assert (bus.counts.frames, bus.counts.remote) == (2, 1)
    bus.send(Frame(0.0, 0x1ABCDEF, True, bytes(12)))
    sent = other.recv(1.0)
    assert sent is not None
    assert (sent.arbitration_id, sent.is_extended_id, sent.is_fd, bytes(sent.data)) == (
        0x1ABCDEF,
        True,
        True,
        bytes(12),
    )


class Loose:
    """An interface that is there or not."""

    there = True
    opened = 0

    def __init__(self) -> None:
        type(self).opened += 1

    def recv(self, _timeout: float) -> None:
        if not self.there:
            raise can.CanOperationError("pulled out")

    def send(self, _message: can.Message, timeout: float) -> None:
        raise can.CanOperationError("no room")

    def shutdown(self) -> None:
        if not self.there:
            raise can.CanOperationError("pulled out")


def test_an_interface_that_is_pulled_out_is_taken_again(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]

    def make(**_options: object) -> Loose:
        if not Loose.there:
            raise can.CanInitializationError("not there")
        return Loose()

    monkeypatch.setattr(can, "Bus", make)
    bus = PythonCan("loose", "1", 250_000, clock=lambda: now[0])
    with pytest.raises(BusError, match="can:loose:1: does not take frames: no room"):
        bus.send(Frame(0.0, 1, False, b""))
    monkeypatch.setattr(Loose, "there", False)
    assert bus.receive() == []
    assert (bus.trouble, bus.counts.removals) == ("removed", 1)
    for _ in range(100):
        now[0] += 1.0
        assert bus.receive() == []
    with pytest.raises(BusError, match="can:loose:1: is not there"):
        bus.send(Frame(0.0, 1, False, b""))
    monkeypatch.setattr(Loose, "there", True)
    now[0] += LONGEST_RETRY_S
    bus.receive()
    assert [bus.trouble, Loose.opened] == [None, 2]
    bus.close()


@pytest.mark.parametrize("spec", ["can:nothing:0", "can:pcan:NOWHERE"])
def test_an_interface_that_is_not_there_is_said(spec: str) -> None:
    with pytest.raises(BusError, match=rf"{spec}: .*; name an interface that python-can has") as caught:
        open_bus(spec)
    assert "\n" not in str(caught.value)
    bus = open_bus(spec, required=False)
    assert bus.trouble == "removed"
    bus.close()
