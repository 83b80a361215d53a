"""Frames over UDP multicast on this machine."""

import os
import select
import socket

import pytest

from service.bus import BusError, open_bus
from service.logs import Frame

GROUP = "239.74.163.2"


@pytest.fixture
def port() -> int:
    """A port that is free, and other than a running demo's."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def test_carries_frames_from_one_to_another(port: int) -> None:
    frames = [
        Frame(0.0, 0x18FF103D, True, bytes(range(8))),
        Frame(0.0, 0x123, False, b""),
        Frame(0.0, 1, True, b"x" * 12),
    ]
    with open_bus(f"udp_multicast:{GROUP}:{port}") as sender, open_bus(f"udp_multicast:{GROUP}:{port}") as receiver:
        assert receiver.receive() == []
        for frame in frames:
            sender.send(frame)
        received: list[Frame] = []
        while len(received) < len(frames) and select.select([receiver.fileno()], [], [], 5)[0]:
            received += receiver.receive()
        assert [frame[1:] for frame in received] == [frame[1:] for frame in frames]
        times = [frame.t for frame in received]
        assert times == sorted(times)
        assert (receiver.skipped, receiver.dropped) == (0, 0)


def test_never_leaves_the_machine(port: int) -> None:
    with open_bus(f"udp_multicast:{GROUP}:{port}") as bus:
        shared = socket.socket(fileno=os.dup(bus.fileno()))
        with shared:
            assert shared.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0


def test_counts_what_is_no_frame(port: int) -> None:
    with open_bus(f"udp_multicast:{GROUP}:{port}") as bus:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for content in (b"", b"hello", b"\xc1", b"\x81\xa1a\x01", b"\x93\x01\x02\x03"):
                stranger.sendto(content, ("127.0.0.1", port))
        skipped = 0
        while skipped < 5 and select.select([bus.fileno()], [], [], 5)[0]:
            assert bus.receive() == []
            skipped = bus.skipped
        assert skipped == 5


def test_a_taken_port_is_said(port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", port))
        with pytest.raises(BusError, match=f"udp_multicast:{GROUP}:{port}: .*Address already in use"):
            open_bus(f"udp_multicast:{GROUP}:{port}")


@pytest.mark.parametrize("rest", ["", "239.74.163.2", "10.0.0.1:43113", "ff15::1:43113", f"{GROUP}:0", f"{GROUP}:x"])
def test_only_a_multicast_group_with_a_port_is_a_bus(rest: str) -> None:
    with pytest.raises(BusError, match="give socketcan:NAME"):
        open_bus(f"udp_multicast:{rest}")
