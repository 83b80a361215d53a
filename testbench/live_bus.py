"""A bus to play onto, through python-can, by its name: INTERFACE:CHANNEL[:PORT]."""

import logging
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ipaddress import AddressValueError, IPv4Address

import can

from faultline.testbench.errors import RigError
from faultline.testbench.traffic import Frame

INTERFACES = ("socketcan", "udp_multicast", "virtual")
SEND_S = 1.0  # s that a full queue is given to drain
WRITE_LIKE = "give socketcan:vcan0 or udp_multicast:239.74.163.2:43113"


@contextmanager
def on_bus(name: str) -> Iterator[Callable[[Frame], None]]:
    """Opens the bus called `name`, such as socketcan:vcan0, and gives what sends a frame there.

    Frames on udp_multicast stay on this machine.

    Raises:
        RigError: the name is malformed, there is no such bus here, or it does not take a frame.
    """
    bus = _opened(name)
    try:
        yield lambda frame: bus.send(can.Message(arbitration_id=frame.frame_id, data=frame.data), SEND_S)
    except can.CanError as error:
        raise RigError(f"{name}: does not take frames: {error}; is somebody else on the bus, and is it up?") from error
    finally:
        bus.shutdown()


def _opened(name: str) -> can.BusABC:
    interface, _, rest = name.partition(":")
    channel, colon, port = rest.partition(":")
    multicast = interface == "udp_multicast"
    if interface not in INTERFACES or not channel or bool(colon) != multicast:
        raise RigError(f"there is no bus {name!r}; {WRITE_LIKE}")
    if multicast and not _is_group(channel):
        raise RigError(f"{name}: {channel!r} is no multicast group; {WRITE_LIKE}")
    if multicast and not (port.isdecimal() and 0 < int(port) < 65_536):
        raise RigError(f"{name}: {port!r} is no port; {WRITE_LIKE}")
    logging.getLogger("can.bus").setLevel(logging.ERROR)  # it warns besides of each bus that did not open
    try:
        if multicast:
            bus = can.Bus(channel, interface=interface, port=int(port), hop_limit=0, fd=False)
            _keep_here(bus.fileno())
        else:
            bus = can.Bus(channel, interface=interface)
    except (can.CanError, OSError) as error:
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
        reason = getattr(cause, "strerror", None) or str(cause)
        raise RigError(f"{name}: {reason}; {_remedy(interface, channel)}") from error
    return bus


def _remedy(interface: str, channel: str) -> str:
    if interface == "socketcan":
        return f"is it there, and up? ip link add {channel} type vcan; ip link set {channel} up"
    return "it needs a route: ip link set lo up; ip route add 239.0.0.0/8 dev lo; or another port"


def _is_group(address: str) -> bool:
    try:
        return IPv4Address(address).is_multicast
    except AddressValueError:
        return False


def _keep_here(descriptor: int) -> None:
    """Sends over the loopback interface, where faultline listens; python-can would ask the routes."""
    with socket.socket(fileno=os.dup(descriptor)) as same:
        same.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
