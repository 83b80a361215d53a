"""CAN buses: what the service listens to and replays onto."""

import re
from collections.abc import Iterable
from ipaddress import AddressValueError, IPv4Address

from service.bus.base import Bus, BusError

__all__ = ["Bus", "BusError", "open_bus", "socketcan_available"]


def open_bus(spec: str, identifiers: Iterable[int] = ()) -> Bus:
    """The bus that `spec` names: `socketcan:NAME` or `udp_multicast:GROUP:PORT`.

    `identifiers` are those of `DecodeTable.identifiers`: 29-bit ones without priority, an 11-bit one n as -1 - n. If
    there are any, SocketCAN takes no other frames from the kernel.

    Raises:
        BusError: the spec is neither, or the bus is not there.
    """
    kind, _, rest = spec.partition(":")
    group, _, port = rest.partition(":")
    if kind == "socketcan" and re.fullmatch(r"[^\s/:]{1,15}", rest):
        from service.bus.socketcan import SocketCan, can_socket  # only the kind that is asked for is loaded

        return SocketCan(can_socket(rest, identifiers), rest)
    if kind == "udp_multicast" and _is_group(group) and port.isdecimal() and 0 < int(port) < 65_536:
        from service.bus.udp import UdpMulticast

        return UdpMulticast(group, int(port))
    raise BusError(f"no bus {spec!r}; give socketcan:NAME (as socketcan:can0) or udp_multicast:239.74.163.2:43113")


def socketcan_available(name: str) -> bool:
    """Whether `socketcan:NAME` can be opened here and now."""
    try:
        open_bus(f"socketcan:{name}").close()
    except BusError:
        return False
    return True


def _is_group(address: str) -> bool:
    try:
        return IPv4Address(address).is_multicast
    except AddressValueError:
        return False
