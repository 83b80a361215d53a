"""What of the connection no broker shows from outside."""

import socket
from types import SimpleNamespace
from typing import cast

from paho.mqtt.client import Client
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode

from faultline.service.mqtt import link as module
from faultline.service.mqtt.link import Link


def test_what_tls_has_read_already_is_taken_at_once() -> None:
    """No selector shows it: it would wait for the next turn, a second later, and the rest for the one after."""
    pending, read = [3, 2, 1, 0], []
    sock = SimpleNamespace(pending=lambda: pending.pop(0))
    client = SimpleNamespace(
        loop_read=lambda: read.append(len(pending)),
        socket=lambda: sock,
        want_write=lambda: False,
        loop_misc=lambda: None,
    )
    link = object.__new__(Link)
    link._is_down = False
    link._exchange(cast(Client, client))
    assert read == [4, 3, 2, 1]


def test_small_packets_do_not_wait_for_the_kernel_to_fill_one() -> None:
    with socket.socket() as sock:
        module._hurry(sock)
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_any_reason_code_may_be_in_a_puback() -> None:
    assert [ReasonCode(PacketTypes.PUBACK, identifier=code).value for code in range(256)] == list(range(256))
    assert ReasonCode(PacketTypes.PUBACK, identifier=0x87).getName() == "Not authorized"
