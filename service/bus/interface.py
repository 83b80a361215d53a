"""State of a network interface from /sys/class/net, without a socket."""

from pathlib import Path
from typing import NamedTuple

SYS = Path("/sys/class/net")
IFF_UP = 1
_LOSSES = ("rx_over_errors", "rx_missed_errors", "rx_dropped")
_CAN_TYPE = 280  # ARPHRD_CAN
_CLASSIC_MTU = 16  # CAN_MTU: one classic frame


class Interface(NamedTuple):
    """`number` is new each time that one of this name is made; `virtual`: it leads to no wire (vcan, vxcan).

    Those have no device behind them, and take CAN FD frames; a serial line's (slcan) has no device, and never does.
    """

    number: int
    is_can: bool
    is_up: bool
    virtual: bool


def losses(name: str) -> int | None:
    """Return the frames that controller or driver have lost since it is there; None if nobody counts them."""
    folder = SYS / name / "statistics"
    try:
        return sum(int((folder / file).read_text()) for file in _LOSSES)
    except OSError:
        return None


def interface(name: str) -> Interface | None:
    """Return the interface of this name as it is now; None if there is none."""
    folder = SYS / name
    try:
        number, kind, flags, mtu = ((folder / file).read_text() for file in ("ifindex", "type", "flags", "mtu"))
        virtual = not (folder / "device").exists() and int(mtu) != _CLASSIC_MTU
        return Interface(int(number), int(kind) == _CAN_TYPE, bool(int(flags, 16) & IFF_UP), virtual)
    except OSError:  # not there, or removed between two reads
        return None
