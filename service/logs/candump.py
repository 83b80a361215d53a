"""Candump's text, of a log and of the screen, in all dialects.

Of `candump -L` and `-l` a line is `(1767225600.123456) can0 18FF103D#0011223344556677`; 3 digits of identifier are an
11-bit frame, 8 are a 29-bit one; `##F` with flags F before the data is CAN FD. On the screen it is
`(1767225600.123456)  can0  RX - -  18FF103D   [8]  00 11 22 33 44 55 66 77   '..."3DUfw'`, where all but channel,
identifier, length and data are options. Data may be binary (`-i`: `00010001 00100010`), or from the last byte to the
first with grave accents between them (`-S`: 22`11). Identifiers of old versions have spaces in place of leading zeros.

The time of either may be a date (`-t A`), taken as UTC as nothing says its zone, or that after the frame before
(`-t d`), or on the screen absent. Source of the formats: can-utils, candump.c, lib.c.
"""

import re
from binascii import unhexlify
from datetime import UTC, datetime
from math import nan
from typing import ClassVar

from faultline.service.logs.batch import ERROR, EXTENDED, EXTENDED_TOP, FD, FD_SIZES, REMOTE, SENT
from faultline.service.logs.example import NOWHERE, Fields, Line, exact
from faultline.service.logs.report import LogReport, shown

EXAMPLE = "(1767225600.123456) can0 18FF103D#0011223344556677"

_TIME = rb"\((?:(\d+)\.(\d+)|(\d{4}-\d\d-\d\d \d\d:\d\d):(\d\d)\.(\d+))\) +"
_ID = rb"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})"
_LOG = re.compile(
    _TIME
    + rb"(\S+) +"
    + _ID
    + rb"(?:#([0-9A-Fa-f]{0,16})(?:_[0-9A-Fa-f])?|##[0-9A-Fa-f]([0-9A-Fa-f]{0,128})|#R([0-9A-Fa-f]?)(?:_[0-9A-Fa-f])?)"
    + rb"(?: ([RT]))?\s*"
)
"""Time, channel, identifier, data of a classic or of an FD frame, length of a remote frame, direction."""
_STAMP = re.compile(_TIME + rb"\S+ +")
_SCREEN = re.compile(
    rb"\s*(?:"
    + _TIME
    + rb")?(\S+) +(?:(RX|TX) +[B-] +[E-] +)?"
    + rb"([0-9A-Fa-f]{1,8}) +(?:\[(\d{1,2})\]|\{([0-9A-Fa-f])\}) {0,80}"
    + rb"((?:[0-9A-Fa-f]{2}(?: {1,80}|$))*|(?:[0-9A-Fa-f]{2}(?:`|\b)){1,64} {0,80}|(?:[01]{8}(?:[ `]|\b)){1,64} {0,80})"
    + rb"(remote request|ERRORFRAME)?(?: {0,80}['`](.*)['`])?"
)
"""Time, channel, direction, identifier, length (or its code), data, what else it is, the data as characters."""
_SHORT, _PADDED = 3, 10  # digits of an identifier of 11 bits; from a channel's name to the end of one of 29 bits
_COMMENT = re.compile(rb"\t[a-z][ -~]*", re.IGNORECASE)  # what an error frame means, below it
_REMARK = re.compile(rb"\s*#")  # as people write it into a log
_DROPPED = re.compile(rb"DROPCOUNT: dropped \d+ CAN frames? on '.*' socket.*")
_COLOUR = re.compile(rb"\x1b\[[0-9;]*m")

_LONGEST = 8
_ERROR_FLAG = 0x2000_0000


class CandumpLog:
    """The dialect of a log."""

    headers: ClassVar[tuple[bytes, ...]] = ()
    needs_newline: ClassVar[bool] = True  # nothing in a line says how long its data are

    def __init__(self, *, is_relative: bool = False) -> None:
        self.is_relative = is_relative

    def header(self, line: bytes) -> None:
        """There is none."""

    def end(self, report: LogReport) -> None:
        """Nothing says where the end is."""

    def read(self, line: bytes) -> Line | None:
        """Read a line: see `Dialect`."""
        match = _LOG.fullmatch(line)
        if match is None:
            if not line.strip() or _REMARK.match(line):
                return None
            place = "no frame after the time in" if _STAMP.match(line) else "no candump line:"
            raise ValueError(f"{place} {shown(line)}")
        channel, identifier, classic, fd, asked, sent = match.groups()[5:]
        can_id = int(identifier, 16)
        flags = (EXTENDED if len(identifier) == 8 else 0) | (SENT if sent == b"T" else 0)
        time, fields = _time(match, 7, 9 if fd is not None else 8, 2)
        if asked is not None:
            return Line(
                channel, time, can_id & EXTENDED_TOP, flags | REMOTE, bytes(min(_LONGEST, int(asked or b"0", 16)))
            )
        if fd is not None:
            if len(fd) / 2 not in FD_SIZES or can_id > EXTENDED_TOP:
                raise ValueError(f"no CAN FD frame has {len(fd) / 2:g} bytes under identifier {identifier.decode()}")
            return Line(channel, time, can_id, flags | FD, unhexlify(fd), fields)
        if len(classic) % 2:
            raise ValueError(f"no frame after the time in {shown(line)}")
        if can_id <= EXTENDED_TOP:
            return Line(channel, time, can_id, flags, unhexlify(classic), fields)
        if can_id & _ERROR_FLAG:
            return Line(channel, time, can_id & EXTENDED_TOP, flags | ERROR, unhexlify(classic))
        raise ValueError(f"identifier {can_id:08X} has more than 29 bits")


class CandumpScreen:
    """The dialect of the screen; `has_times` is False where its first frame has none."""

    headers: ClassVar[tuple[bytes, ...]] = ()
    needs_newline: ClassVar[bool] = False  # a line says how many bytes it has

    def __init__(self, *, is_relative: bool = False, has_times: bool = True) -> None:
        self.is_relative, self.has_times = is_relative, has_times

    def header(self, line: bytes) -> None:
        """There is none."""

    def end(self, report: LogReport) -> None:
        """Nothing says where the end is."""

    def read(self, line: bytes) -> Line | None:
        """Read a line: see `Dialect`."""
        coloured = b"\x1b" in line
        line = (_COLOUR.sub(b"", line) if coloured else line).rstrip()
        match = _SCREEN.fullmatch(line)
        if match is None:
            _check_no_frame(line)
            return None
        channel, sent, identifier, digits, code, raw, other, characters = match.groups()[5:]
        if self.has_times == (match[1] is None and match[3] is None):
            raise ValueError(f"{'no' if self.has_times else 'a'} time, unlike the first frame: {shown(line)}")
        can_id, data = int(identifier, 16), _data(raw)
        is_padded = len(identifier) < _SHORT and match.end(8) - match.end(6) >= _PADDED
        is_extended = len(identifier) > _SHORT or is_padded
        flags = (EXTENDED if is_extended else 0) | (SENT if sent == b"TX" else 0)
        time, fields = _time(match, 8, 11, 3)
        size = min(_LONGEST, int(code, 16)) if code is not None else int(digits)
        if other == b"ERRORFRAME" or (can_id > EXTENDED_TOP and can_id & _ERROR_FLAG):
            return Line(channel, time, can_id & EXTENDED_TOP, flags | ERROR, data)
        if other is not None:
            return Line(channel, time, can_id, flags | REMOTE, bytes(min(_LONGEST, size)))
        if len(data) != size or size not in FD_SIZES:
            raise ValueError(f"says {size} bytes and has {len(data)}: {shown(line)}")
        flags |= FD if digits is not None and len(digits) == 2 else 0
        if fields is not None:
            is_even = len(raw.rstrip()) == max(0, 3 * size - 1) and b"`" not in raw
            free = () if characters is None else (match.span(13),)
            begin = match.start(11)
            fields = fields._replace(data=(begin, begin + max(0, 3 * size - 1)), free=free) if is_even else None
        return Line(channel, time, can_id, flags, data, None if coloured else fields)


def _data(raw: bytes) -> bytes:
    """The bytes of the screen's data: hexadecimal, or binary, and swapped where they have grave accents."""
    spaced = raw.replace(b"`", b" ")
    is_binary = raw[2:3].isdigit()
    data = bytes(int(each, 2) for each in spaced.split()) if is_binary else bytes.fromhex(spaced.decode())
    return data if spaced == raw else data[::-1]


def _check_no_frame(line: bytes) -> None:
    if _DROPPED.fullmatch(line):
        raise ValueError(f"candump says: {line.decode(errors='replace')}")
    if line.strip() and not (_COMMENT.fullmatch(line) or _REMARK.match(line)):
        raise ValueError(f"no candump line: {shown(line)}")


def _time(match: re.Match[bytes], identifier: int, data: int, stride: int) -> tuple[float, Fields | None]:
    """The time of a line [s], and where its fields are; those of identifier and data are of these groups."""
    spans = match.span(identifier), match.span(data)
    if match[1] is not None:
        fields = Fields((match.start(1), match.end(2)), *spans, stride)
        return float(b".".join((match[1], match[2]))), fields if exact(match.span(1), match.span(2)) else None
    if match[3] is None:
        return nan, Fields(NOWHERE, *spans, stride)
    start = datetime.fromisoformat(match[3].decode()).replace(tzinfo=UTC).timestamp()
    fields = Fields((match.start(4), match.end(5)), *spans, stride, start=start)
    return start + float(b".".join((match[4], match[5]))), fields if exact(match.span(4), match.span(5)) else None
