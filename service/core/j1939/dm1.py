"""The payload of DM1 (active trouble codes) and DM2 (previously active ones), SAE J1939-73.

Two bytes of lamps, then four of each code. Lamps, two bits each, the highest first: malfunction indicator (of
legislated emission faults), red stop, amber warning, protect; the second byte says in the same order how they flash.
This device never commands the malfunction indicator: its bits say that it has none. It lights the amber lamp only.

Of a code: SPN, 19 bits, of which the upper three are the upper bits of the third byte; below them FMI, 5 bits; the
conversion method, 1 bit, 0 for this layout (version 4); the occurrence count, 7 bits. Method 1 is one of three older
layouts, and the message does not say which: version 3 is the same one, 1 and 2 have other orders of the bits.
"""

from collections.abc import Sequence
from typing import NamedTuple

from faultline.service.core.j1939.transport import LARGEST

MOST_SPN, MOST_FMI = 0x7FFFF, 31
MOST_OC, NO_OC = 126, 127
"""An occurrence count ends there; and the one that says that nobody counts."""
MOST = (LARGEST - 2) // 4
"""Codes in one message."""

OFF, ON, NONE = 0b00, 0b01, 0b11
"""A lamp; `NONE`: the device has no such lamp, and of the second byte, that it does not flash."""
_EMPTY = bytes(4)  # in place of a code where there is none; readers ignore SPN 0
_FRAME = 8


class Code(NamedTuple):
    """A trouble code: suspect parameter (SPN), failure mode (FMI), and how often it has become active (OC).

    `is_old`: its conversion method is 1, so that the SPN may be one of `older_spns` instead.
    """

    spn: int
    fmi: int
    oc: int
    is_old: bool = False


class Lamps(NamedTuple):
    """The state of each lamp, and how it flashes: 0 slowly, 1 fast, 3 not at all."""

    malfunction: int = NONE
    red: int = OFF
    amber: int = OFF
    protect: int = OFF
    flash: tuple[int, int, int, int] = (NONE, NONE, NONE, NONE)


class Diagnostics(NamedTuple):
    """A message: lamps and codes."""

    lamps: Lamps
    codes: tuple[Code, ...]


def encode(codes: Sequence[Code], amber: bool) -> bytes:
    """The payload, of 8 bytes at least; of more than `MOST` codes the first ones.

    Raises:
        ValueError: a code whose numbers do not fit.

    >>> encode([], amber=False).hex(" ")
    'c0 ff 00 00 00 00 ff ff'
    >>> encode([Code(5245, 10, 1)], amber=True).hex(" ")
    'c4 ff 7d 14 0a 01 ff ff'
    """
    lamps = _packed((NONE, OFF, ON if amber else OFF, OFF))
    payload = bytes([lamps, 0xFF]) + (b"".join(map(_code, codes[:MOST])) or _EMPTY)
    return payload.ljust(_FRAME, b"\xff")


def decode(payload: bytes) -> Diagnostics:
    """Lamps and codes; SPN 0 and SPN 524287 say that there is none and are left out.

    Raises:
        ValueError: no length that such a message has.
    """
    body = payload[2:]
    if len(payload) == _FRAME:
        body = payload[2:6]  # then two bytes of filling
    if len(payload) < 6 or len(body) % 4:
        raise ValueError(f"{len(payload)} bytes are no DM1 or DM2: two of lamps and four of each code")
    states, flash = _unpacked(payload[0]), _unpacked(payload[1])
    rows = [body[k : k + 4] for k in range(0, len(body), 4)]
    there = [row for row in rows if _read(row).spn not in (0, MOST_SPN)]
    return Diagnostics(Lamps(*states, flash), tuple(map(_read, there)))


def older_spns(code: Code) -> tuple[int, int]:
    """Return what the SPN of a code is if its layout is version 1, and if it is version 2.

    The three upper bits of the third byte are the lowest of the SPN there; of the others the first byte has the upper
    (version 1) or the lower ones (version 2).

    >>> older_spns(Code(0x9700, 3, 10, True)), older_spns(Code(0x97, 3, 10, True))  # both may be 1208
    ((1208, 309248), (309248, 1208))
    """
    first, second, low = code.spn & 0xFF, code.spn >> 8 & 0xFF, code.spn >> 16
    return first << 11 | second << 3 | low, second << 11 | first << 3 | low


def _code(code: Code) -> bytes:
    spn, fmi, oc, _ = code
    if not (0 <= spn <= MOST_SPN and 0 <= fmi <= MOST_FMI and 0 <= oc <= NO_OC):
        raise ValueError(f"SPN {spn}, FMI {fmi}, OC {oc} do not fit in 19, 5 and 7 bits")
    return bytes([spn & 0xFF, spn >> 8 & 0xFF, spn >> 16 << 5 | fmi, oc])


def _read(row: bytes) -> Code:
    return Code(row[0] | row[1] << 8 | row[2] >> 5 << 16, row[2] & 0x1F, row[3] & 0x7F, bool(row[3] >> 7))


def _packed(four: tuple[int, int, int, int]) -> int:
    return four[0] << 6 | four[1] << 4 | four[2] << 2 | four[3]


def _unpacked(byte: int) -> tuple[int, int, int, int]:
    return byte >> 6, byte >> 4 & 3, byte >> 2 & 3, byte & 3
