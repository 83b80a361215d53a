"""Two processes talk over the multicast bus, which says "heard"; a program of its own so that it can run in a network
of its own: talk.py WHO GROUP PORT, WHO being the one that answers: ours, python-can, or python-can-told, whose socket
is told to use the loopback interface.
"""

import os
import select
import socket
import subprocess
import sys
from contextlib import closing

import can
from can.interfaces.udp_multicast import UdpMulticastBus

from faultline.service.bus import open_bus
from faultline.service.logs import Frame

CALL = Frame(0.0, 0x18FF103D, True, b"abcdefgh")
ANSWER = Frame(0.0, 0x123, False, b"yes")


def ask(who: str, group: str, port: str) -> None:
    """A second process answers our call."""
    with (
        open_bus(f"udp_multicast:{group}:{port}") as bus,
        subprocess.Popen([sys.executable, __file__, f"answer-{who}", group, port], stdout=subprocess.PIPE) as other,
    ):
        assert other.stdout is not None
        assert other.stdout.readline() == b"ready\n"
        bus.send(CALL)
        heard: list[Frame] = []
        while len(heard) < 2 and select.select([bus.fileno()], [], [], 10)[0]:
            heard += bus.receive()
        assert [frame[1:] for frame in heard] == [CALL[1:], ANSWER[1:]], heard  # a sender hears itself too
        assert other.wait(10) == 0
    print("heard")


def answer(group: str, port: str) -> None:
    """As one of ours."""
    with open_bus(f"udp_multicast:{group}:{port}") as bus:
        print("ready", flush=True)
        assert select.select([bus.fileno()], [], [], 10)[0]
        assert [frame[1:] for frame in bus.receive()] == [CALL[1:]]
        bus.send(ANSWER)


def answer_by_python_can(group: str, port: str, told: bool) -> None:
    """As one of python-can's tools."""
    with UdpMulticastBus(group, int(port)) as bus:
        if told:
            loopback = socket.inet_aton("127.0.0.1")
            with closing(socket.socket(fileno=os.dup(bus.fileno()))) as shared:
                shared.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + loopback)
                shared.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        print("ready", flush=True)
        message = bus.recv(10)
        assert message is not None
        assert (message.arbitration_id, message.is_extended_id, bytes(message.data)) == CALL[1:]
        bus.send(can.Message(arbitration_id=ANSWER.can_id, is_extended_id=ANSWER.is_extended, data=ANSWER.data))


if __name__ == "__main__":
    role, where, at = sys.argv[1:]
    if role == "answer-ours":
        answer(where, at)
    elif role.startswith("answer-"):
        answer_by_python_can(where, at, told=role.endswith("told"))
    else:
        ask(role, where, at)
