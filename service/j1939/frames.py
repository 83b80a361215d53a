"""29-bit identifiers of SAE J1939-21: parameter group, priority, source and destination address.

Layout, from the top: priority (3 bits), extended data page, data page, PDU format (8), PDU specific (8), source (8).
With a format below 240 the specific byte is the destination, else it belongs to the group and all are addressed.
"""

from typing import NamedTuple

from faultline.service.logs import Frame

NULL, GLOBAL = 254, 255
"""Addresses that nobody has: of a node that has none, and of all nodes."""

ACKNOWLEDGEMENT, REQUEST, TP_DT, TP_CM, ADDRESS_CLAIMED = 0xE800, 0xEA00, 0xEB00, 0xEC00, 0xEE00
DM1, DM2 = 0xFECA, 0xFECB
"""Parameter group numbers: 59392, 59904, 60160, 60416, 60928; 65226, 65227."""

PRIORITY, TP_PRIORITY = 6, 7
"""Default of requests, acknowledgements, claims and diagnostics; and of what carries a message in parts."""

ADDRESSED = 240  # first PDU format whose specific byte is no destination
FRAME = 8  # bytes; a longer message goes in parts
_EXTENDED_PAGE = 1 << 25  # identifiers of ISO 15765-3, which are not J1939's


class Message(NamedTuple):
    """Message to send from our address, whatever that is; at most `FRAME` bytes."""

    pgn: int
    data: bytes
    destination: int = GLOBAL
    priority: int = PRIORITY

    def frame(self, source: int, t: float) -> Frame:
        """Return the frame that carries the message, `t` [s]."""
        return Frame(t, identifier(self.pgn, source, self.destination, self.priority), True, self.data)


class Heard(NamedTuple):
    """Decoded frame; `destination` is `GLOBAL` where the group addresses all."""

    pgn: int
    source: int
    destination: int
    data: bytes


def identifier(pgn: int, source: int, destination: int = GLOBAL, priority: int = PRIORITY) -> int:
    """Return the identifier; the destination is left out where the group has none.

    >>> f"{identifier(DM1, 0x3D):08X} {identifier(REQUEST, 0xF9, 0x3D):08X}"
    '18FECA3D 18EA3DF9'
    """
    specific = destination if pgn >> 8 & 0xFF < ADDRESSED else 0
    return priority << 26 | (pgn | specific) << 8 | source


def parse(frame: Frame) -> Heard | None:
    """Decode a frame; None if it is 11-bit, longer than 8 bytes, or not of J1939."""
    if not frame.is_extended or frame.can_id & _EXTENDED_PAGE or len(frame.data) > FRAME:
        return None
    group, source = frame.can_id >> 8 & 0x1FFFF, frame.can_id & 0xFF
    if group >> 8 & 0xFF < ADDRESSED:
        return Heard(group & 0x1FF00, source, group & 0xFF, frame.data)
    return Heard(group, source, GLOBAL, frame.data)


def pgn_bytes(pgn: int) -> bytes:
    """Return the group's number as in requests and announcements: three bytes, the lowest first."""
    return pgn.to_bytes(3, "little")
