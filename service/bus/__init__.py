"""CAN buses: what the service listens to and replays onto."""

import re
from collections.abc import Iterable
from ipaddress import AddressValueError, IPv4Address

from faultline.service.bus.base import Bus, BusError
from faultline.service.core.signals.decode import Wanted

__all__ = ["Bus", "BusError", "open_bus", "socketcan_available"]


def open_bus(
    spec: str, wanted: Iterable[Wanted] | None = None, *, believe_local: bool = False, required: bool = True
) -> Bus:
    """Open a bus: `socketcan:NAME`, `udp_multicast:GROUP:PORT`, or `can:INTERFACE:CHANNEL[:BITRATE]`.

    Of SocketCAN the kernel gives the `wanted` frames only (`DecodeTable.wanted`), all where that is None. What
    processes of this machine send over a real interface is taken only with `believe_local`; an interface that is not
    `required` may come later.

    Raises:
        BusError: the spec is neither, or the bus is not there.
    """
    kind, _, rest = spec.partition(":")
    group, _, port = rest.partition(":")
    if kind == "socketcan" and re.fullmatch(r"[^\s/:]{1,15}", rest):
        from faultline.service.bus.socketcan import SocketCan  # only the kind that is asked for is loaded

        return SocketCan(rest, wanted, believe_local=believe_local, required=required)
    if kind == "udp_multicast" and _is_group(group) and port.isdecimal() and 0 < int(port) < 65_536:
        from faultline.service.bus.udp import UdpMulticast

        return UdpMulticast(group, int(port))  # there as long as this machine is
    if (other := re.fullmatch(r"can:(\w+):([^\s:]+)(?::(\d{1,8}))?", spec)) is not None:
        from faultline.service.bus.pythoncan import PythonCan

        interface, channel, bitrate = other.groups()
        if interface in _OWN:
            raise BusError(f"{spec}: give {interface}:NAME, which is told what the kernel loses")
        return PythonCan(interface, channel, int(bitrate) if bitrate else None, required=required)
    raise BusError(
        f"no bus {spec!r}; give socketcan:NAME (as socketcan:can0), can:INTERFACE:CHANNEL of python-can, or "
        "udp_multicast:239.74.163.2:43113"
    )


def socketcan_available(name: str) -> bool:
    """Return True if `socketcan:NAME` can be opened here and now."""
    try:
        open_bus(f"socketcan:{name}").close()
    except BusError:
        return False
    return True


_OWN = ("socketcan", "udp_multicast")


def _is_group(address: str) -> bool:
    try:
        return IPv4Address(address).is_multicast
    except AddressValueError:
        return False
