"""Error frames of CAN controllers (linux/can/error.h)."""

from typing import NamedTuple

from faultline.service.bus.base import Trouble

BUS_OFF, RESTARTED, CONTROLLER = 0x40, 0x100, 0x04
"""Classes: bits of the identifier."""
OVERFLOW, WARNING, PASSIVE, ACTIVE = 0x01, 0x04 | 0x08, 0x10 | 0x20, 0x40
"""Of the controller, bits of the second byte: frames came faster than it could store; 96 errors; 128; well again."""
_STATUS = 1


class StateChange(NamedTuple):
    """Effect of an error frame: whether the bus is now in `trouble` or, None, well; and whether frames were lost."""

    changed: bool = False
    trouble: Trouble | None = None
    overflow: bool = False


def read_error(identifier: int, data: bytes) -> StateChange:
    """Decode an error frame; `identifier` without its flags."""
    if identifier & BUS_OFF:
        return StateChange(True, "bus-off")
    if identifier & RESTARTED:
        return StateChange(True)
    if not identifier & CONTROLLER or len(data) <= _STATUS:
        return StateChange()
    status = data[_STATUS]
    if status & PASSIVE:
        return StateChange(True, "error-passive", bool(status & OVERFLOW))
    return StateChange(bool(status & (WARNING | ACTIVE)), None, bool(status & OVERFLOW))
