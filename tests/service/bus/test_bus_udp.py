"""Frames over UDP multicast on this machine's loopback interface."""

import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from can.interfaces.udp_multicast.utils import pack_message, unpack_message
from hypothesis import given
from hypothesis import strategies as st
from ports import free_port

from faultline.service.bus import BusError, open_bus
from faultline.service.bus.udp import IP_MULTICAST_ALL, UdpMulticast, pack, unpack
from faultline.service.logs import Frame

GROUP = "239.74.163.2"
TALK = str(Path(__file__).with_name("talk.py"))

FRAMES = [
    Frame(0.0, 0x18FF103D, True, bytes(range(8))),
    Frame(0.0, 0x123, False, b""),
    Frame(0.0, 1, True, b"x" * 12),
]


@pytest.fixture
def port() -> int:
    """A port that is free, and other than a running demo's."""
    return free_port("")


@pytest.fixture
def bus(port: int) -> Iterator[UdpMulticast]:
    with UdpMulticast(GROUP, port) as opened:
        assert isinstance(opened, UdpMulticast)
        yield opened


def apart(setup: str) -> list[str]:
    """Runs what follows in a network of its own, set up by a shell command; empty where that is not permitted."""
    command = ["unshare", "-rn", "sh", "-c", f'{setup} && exec "$@"', "sh"]
    try:
        probe = subprocess.run([*command, "true"], capture_output=True, check=False)
    except FileNotFoundError:
        return []
    return command if probe.returncode == 0 else []


def test_carries_frames_from_one_to_another(port: int) -> None:
    with open_bus(f"udp_multicast:{GROUP}:{port}") as sender, open_bus(f"udp_multicast:{GROUP}:{port}") as receiver:
        assert receiver.receive() == []
        for frame in FRAMES:
            sender.send(frame)
        received: list[Frame] = []
        while len(received) < len(FRAMES) and select.select([receiver.fileno()], [], [], 5)[0]:
            received += receiver.receive()
        assert [frame[1:] for frame in received] == [frame[1:] for frame in FRAMES]
        times = [frame.t for frame in received]
        assert times == sorted(times)
        assert (receiver.counts.malformed, receiver.dropped) == (0, 0)


def test_processes_hear_each_other_without_any_route(port: int) -> None:
    """In a network that has the loopback interface and nothing else, where that may be made; else in this one."""
    command = [*apart("ip link set lo up"), sys.executable, TALK, "ours", GROUP, str(port)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "heard\n", "")


def test_python_can_joins_where_the_route_says_loopback(port: int) -> None:
    """The route of the module's docstring; where none may be set, python-can's socket is told the interface instead."""
    routed = apart("ip link set lo up && ip route add 239.0.0.0/8 dev lo")
    command = [*routed, sys.executable, TALK, "python-can" if routed else "python-can-told", GROUP, str(port)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "heard\n", "")


def test_never_leaves_the_machine(bus: UdpMulticast) -> None:
    with socket.socket(fileno=bus.fileno()) as sock:
        try:
            assert sock.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4) == socket.inet_aton("127.0.0.1")
            assert sock.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
            assert sock.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP) == 1
            assert sock.getsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL) == 0
        finally:
            sock.detach()


def test_counts_what_is_no_frame(bus: UdpMulticast, port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        for content in (b"", b"hello", b"\xc1", b"\x81\xa1a\x01", b"\x93\x01\x02\x03", b"x" * 9000):
            stranger.sendto(content, (GROUP, port))
    while bus.counts.malformed < 6 and select.select([bus.fileno()], [], [], 5)[0]:
        assert bus.receive() == []
    assert bus.counts.malformed == 6


def test_what_is_sent_to_the_port_but_not_to_the_group_is_not_heard(bus: UdpMulticast, port: int) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(pack(FRAMES[0]), ("127.0.0.1", port))
    assert not select.select([bus.fileno()], [], [], 0.1)[0]


def test_counts_what_the_kernel_dropped(bus: UdpMulticast) -> None:
    with socket.socket(fileno=bus.fileno()) as sock:
        try:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        finally:
            sock.detach()
    for _ in range(50):
        bus.send(FRAMES[0])
    assert len(bus.receive()) + bus.dropped == 50
    assert bus.dropped > 0


def test_a_taken_port_is_said(port: int, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", port))
        with pytest.raises(BusError, match=f"udp_multicast:{GROUP}:{port}: Address already in use; .*another port"):
            open_bus(f"udp_multicast:{GROUP}:{port}")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("rest", ["", "239.74.163.2", "10.0.0.1:43113", "ff15::1:43113", f"{GROUP}:0", f"{GROUP}:x"])
def test_only_a_multicast_group_with_a_port_is_a_bus(rest: str) -> None:
    with pytest.raises(BusError, match="give socketcan:NAME"):
        open_bus(f"udp_multicast:{rest}")


@pytest.mark.parametrize("frame", FRAMES)
def test_the_content_is_python_cans(frame: Frame) -> None:
    message = unpack_message(pack(frame), check=True)
    assert (message.arbitration_id, message.is_extended_id, bytes(message.data)) == frame[1:]
    assert unpack(pack_message(message), 0.0) == frame


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=1, is_remote_frame=True, dlc=0),
        can.Message(arbitration_id=1, is_error_frame=True),
        can.Message(arbitration_id=0x800, is_extended_id=False),
        can.Message(arbitration_id=1 << 29),
        can.Message(arbitration_id=1, data=bytes(9)),
        can.Message(arbitration_id=1, data=bytes(65), is_fd=True),
        can.Message(arbitration_id=1, data=bytes(3), dlc=4),
    ],
)
def test_what_is_no_data_frame_is_none(message: can.Message) -> None:
    assert unpack(pack_message(message), 0.0) is None


@given(st.binary(max_size=100))
def test_no_content_breaks_the_bus(content: bytes) -> None:
    frame = unpack(content, 1.0)
    assert frame is None or len(frame.data) <= 64


def test_no_depth_breaks_the_bus() -> None:
    assert unpack(b"\x81\xa1a" + b"\x91" * 4000 + b"\x01", 0.0) is None
