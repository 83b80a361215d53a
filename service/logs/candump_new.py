"""Reads candump's text logs and salvages: a bad line costs that line, never what follows it.

Of `candump -L` and `-l` a line is `(1767225600.123456) can0 18FF103D#0011223344556677`; 3 digits of identifier are an
11-bit frame, 8 are a 29-bit one; `##F` with flags F before the data is CAN FD. On the screen it is
`(1767225600.123456)  can0  RX - -  18FF103D   [8]  00 11 22 33 44 55 66 77   '..."3DUfw'`, where all but channel,
identifier, length and data are options: the time may be a date, or of the frame before (`-t d`), or absent. Source of
the formats: can-utils, candump.c and lib.c.
"""

import re
from binascii import unhexlify
from datetime import UTC, datetime
from math import nan

from faultline.service.logs.batch import ERROR, EXTENDED, FD, REMOTE, SENT
from faultline.service.logs.report import LogReport, shown
from faultline.service.logs.text import Fields, Line

EXAMPLE = "(1767225600.123456) can0 18FF103D#0011223344556677"

_ID = rb"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
_CLASSIC = re.compile(rb"\((\d+\.\d+)\) +(\S+) +" + _ID + rb"#([0-9A-Fa-f]{0,16})(?:_[0-9A-Fa-f])?(?: ([RT]))?\s*")
_FD = re.compile(rb"\((\d+\.\d+)\) +(\S+) +" + _ID + rb"##[0-9A-Fa-f]([0-9A-Fa-f]{0,128})(?: ([RT]))?\s*")
_REMOTE = re.compile(rb"\((\d+\.\d+)\) +(\S+) +" + _ID + rb"#R[0-9A-Fa-f]*(?: ([RT]))?\s*")
_STAMP = re.compile(rb"\(\d+\.\d+\) +\S+ +")
_SCREEN = re.compile(
    rb" *(?:\((?:(\d+\.\d+)|(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+))\) +)?(\S+) +(?:(RX|TX) +[B-] +[E-] +)?" + _ID
    rb" +[\[{](\d+)[\]}] *((?:[0-9A-Fa-f]{2}(?: +|$))*)(remote request|ERRORFRAME)?(?: *'(.*)'| *)\s*"
)
"""Time, date, channel, direction, identifier, length, data, what else it is, the data as characters."""

_FD_SIZES = frozenset([*range(9), 12, 16, 20, 24, 32, 48, 64])  # bytes, ISO 11898-1
_LONGEST = 8
_ERROR_FLAG = 0x2000_0000
_TOP = 0x1FFF_FFFF


def read_line(line: bytes) -> Line | None:
    """The frame of a line of a log; raises `ValueError` where there is none."""
    match = _CLASSIC.fullmatch(line)
    if match is not None and len(match[4]) % 2 == 0:  # half a byte is no data
        identifier = int(match[3], 16)
        if identifier <= _TOP:
            return _line(match, unhexlify(match[4]), 0)
        if identifier & _ERROR_FLAG:
            return Line(match[2], float(match[1]), identifier & _TOP, ERROR | EXTENDED, unhexlify(match[4]))
        raise ValueError(f"identifier {identifier:08X} has more than 29 bits")
    return _other(line)


def _other(line: bytes) -> Line | None:
    """A line that is no classic data frame."""
    match = _FD.fullmatch(line)
    if match is not None:
        if len(match[4]) / 2 in _FD_SIZES and int(match[3], 16) <= _TOP:
            return _line(match, unhexlify(match[4]), FD)
        raise ValueError(f"no CAN FD frame has {len(match[4]) / 2:g} bytes under identifier {match[3].decode()}")
    match = _REMOTE.fullmatch(line)
    if match is not None:
        return Line(match[2], float(match[1]), int(match[3], 16) & _TOP, REMOTE | _flags(match), b"")
    if line.strip():
        raise ValueError(f"{'no frame after the time in' if _STAMP.match(line) else 'no candump line:'} {shown(line)}")
    return None


def _line(match: re.Match[bytes], data: bytes, flags: int) -> Line:
    fields = Fields(match.span(1), match.span(3), match.span(4))
    return Line(match[2], float(match[1]), int(match[3], 16), flags | _flags(match), data, fields)


def _flags(match: re.Match[bytes]) -> int:
    return (EXTENDED if len(match[3]) == 8 else 0) | (SENT if match[5] == b"T" else 0)


def read_screen_line(line: bytes) -> Line | None:
    """The frame of a line of the screen; raises `ValueError` where there is none. Without a time it is NaN."""
    match = _SCREEN.fullmatch(line)
    if match is None:
        if line.strip():
            raise ValueError(f"no candump line: {shown(line)}")
        return None
    stamp, date, channel, sent, identifier, length, raw, other, _ = match.groups()
    data, size = bytes.fromhex(raw.decode()), int(length)
    flags = (EXTENDED if len(identifier) == 8 else 0) | (SENT if sent == b"TX" else 0)
    can_id = int(identifier, 16)
    if other == b"ERRORFRAME" or can_id > _TOP and can_id & _ERROR_FLAG:
        return Line(channel, _time(stamp, date), can_id & _TOP, flags | ERROR, data)
    if other is not None:
        return Line(channel, _time(stamp, date), can_id, flags | REMOTE, b"")
    if len(data) != size or size not in _FD_SIZES:
        raise ValueError(f"says {size} bytes and has {len(data)}: {shown(line)}")
    flags |= FD if size > _LONGEST or len(length) == 2 else 0
    begin, end = match.start(7), match.start(7) + len(raw.rstrip())
    alike = stamp is not None and (size < 2 or raw[2:3] == b" " != raw[3:4])
    free = match.span(9) if match[9] is not None else (0, 0)
    fields = Fields(match.span(1), match.span(5), (begin, end), 3, free=free) if alike else None
    return Line(channel, _time(stamp, date), can_id, flags, data, fields)


def _time(stamp: bytes | None, date: bytes | None) -> float:
    """Of a date as if its clock had shown UTC: nothing says its time zone."""
    if date is not None:
        return datetime.fromisoformat(date.decode()[:26]).replace(tzinfo=UTC).timestamp()
    return nan if stamp is None else float(stamp)


def no_candump(content: bytes, report: LogReport) -> str:
    """Why a file without a frame is no log of this format, and what one looks like."""
