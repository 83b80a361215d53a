"""29-bit identifiers of SAE J1939-21: parameter group, source and destination address.

Layout, from the top: priority (3 bits), extended data page, data page, PDU format (8), PDU specific (8), source (8).
With a format below 240 the specific byte is the destination, else it belongs to the group and all are addressed.
"""

from typing import NamedTuple

NULL, GLOBAL = 254, 255
"""Addresses that nobody has: of a node that has none, and of all nodes."""

ACKNOWLEDGEMENT, REQUEST, TP_DT, TP_CM, ADDRESS_CLAIMED = 0xE800, 0xEA00, 0xEB00, 0xEC00, 0xEE00
DM1, DM2 = 0xFECA, 0xFECB
"""Parameter group numbers: 59392, 59904, 60160, 60416, 60928; 65226, 65227."""

ADDRESSED = 240
"""The first PDU format whose specific byte is no destination."""
FRAME = 8
"""Bytes; a longer message goes in parts."""

PRIORITY_MASK = 0x03FF_FFFF
"""Bits of an identifier below the priority."""
SOURCE_MASK, DESTINATION_MASK = 0xFF, 0xFF00
"""Bits of the source address, and of the destination where the group has one."""


class Address(NamedTuple):
    """Fields of an identifier but for the priority; `destination` is `GLOBAL` where the group addresses all."""

    pgn: int
    source: int
    destination: int


def is_addressed(pgn: int) -> bool:
    """True if messages of the group have a destination.

    >>> is_addressed(TP_DT), is_addressed(DM1)
    (True, False)
    """
    return pgn >> 8 & 0xFF < ADDRESSED


def group_of(identifier: int) -> int:
    """Return the parameter group number of an identifier.

    >>> f"{group_of(0x18FECA3D):X} {group_of(0x18EAF93D):X}"
    'FECA EA00'
    """
    pgn = identifier >> 8 & 0x3FFFF
    return pgn & 0x3FF00 if is_addressed(pgn) else pgn


def numbers_of(pgn: int) -> range:
    """Return what stands in the identifier of a group's frames in place of its number: that, with any destination."""
    return range(pgn, pgn + 256) if is_addressed(pgn) else range(pgn, pgn + 1)


def address_of(identifier: int) -> Address:
    """Return group, source and destination of an identifier."""
    pgn = group_of(identifier)
    return Address(pgn, identifier & 0xFF, identifier >> 8 & 0xFF if is_addressed(pgn) else GLOBAL)


def identifier_of(pgn: int, source: int, destination: int = GLOBAL, priority: int = 0) -> int:
    """Return the identifier; the destination is left out where the group has none.

    >>> f"{identifier_of(DM1, 0x3D, priority=6):08X} {identifier_of(REQUEST, 0xF9, 0x3D, 6):08X}"
    '18FECA3D 18EA3DF9'
    """
    return priority << 26 | (pgn | (destination if is_addressed(pgn) else 0)) << 8 | source


def named(address: int) -> str:
    """Return an address as people write it."""
    return f"0x{address:02X}"
