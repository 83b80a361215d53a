"""Vector's ASC text.

A classic frame is `0.015991 1 18FF103Dx Rx d 8 00 11 22 33 44 55 66 77`, with an `x` after identifiers of 29 bits; a
CAN FD frame begins `0.015991 CANFD 1 Rx`. Other events of a measurement are skipped. Source of the format: what
CANoe and python-can write.
"""

import re
from typing import ClassVar

from faultline.service.logs.batch import ERROR, EXTENDED, FD, REMOTE, SENT
from faultline.service.logs.example import Fields, Line, exact
from faultline.service.logs.report import LogReport, shown
from faultline.service.logs.text import TIME_ONLY

_BASE = re.compile(rb"base\s+(hex|dec)\b(.*)", re.IGNORECASE)
_HEADER = re.compile(rb"\s*(?:date\s.*|(?:no\s+)?internal\s+events\s+logged|//.*)?", re.IGNORECASE)
_TRIGGER = re.compile(rb"\s*(begin|end)\s+triggerblock\b.*", re.IGNORECASE)
_TIME = rb"\s*(\d+)\.(\d+)\s+"
_DATA = {16: rb"[0-9a-f]{2}", 10: rb"\d{1,3}"}  # a byte, by the base of the file's numbers
_CLASSIC, _FD = (
    {
        base: re.compile(_TIME + head + rb"((?:\s+" + byte + rb"(?!\S))*)(?:" + tail + rb")?\s*", re.IGNORECASE)
        for base, byte in _DATA.items()
    }
    for head, tail in (
        (rb"(\d+)\s+([0-9a-f]+)(x?)\s+(Rx|Tx)\s+d\s+([0-9a-f]+)", rb"\s+[a-z](.*)"),
        (
            rb"CANFD\s+(\d+)\s+(Rx|Tx)\s+([0-9a-f]+)(x?)\s+(?:[a-z_]\S*\s+)?[01]\s+[01]\s+[0-9a-f]+\s+(\d+)",
            rb"\s(.*)",
        ),
    )
)
_REMOTE = re.compile(_TIME + rb"(\d+)\s+([0-9a-f]+)(x?)\s+(Rx|Tx)\s+r\b(?:\s+([0-9a-f]+)(?!\S))?.*", re.IGNORECASE)
_ERROR = re.compile(_TIME + rb"(?:CANFD\s+)?(\d+)\s+(?:(?:Rx|Tx)\s+)?ErrorFrame\b.*", re.IGNORECASE)
_EVENT = re.compile(
    _TIME + rb"(?:\d+\s+J1939TP\b[ -~]*|(?!CANFD\b)(?!.*\s(?-i:[dr])\s+[0-9a-f]{1,2}\b)"
    rb"(?:[a-z]{2}[ -~]*|\d+\s+(?![0-9a-f]+x?(?:\s|$))[a-z](?!.*\s(?:Rx|Tx)\b)[ -~]*))\s*",
    re.IGNORECASE,
)
"""What is of another bus, or no frame; nothing that looks like the rest of a damaged frame, as an identifier does that
begins with a letter."""
_REQUEST = re.compile(_TIME + rb"(?:\d+\s+[0-9a-f]+x?|CANFD\s+\d+)\s+TxRq\b.*", re.IGNORECASE)  # not yet on the bus
_LONGEST = 8  # bytes of a classic frame
_DIGITS = 8  # of an identifier


class Asc:
    """The dialect. State: what the header says, and how many blocks of a measurement are open."""

    headers: ClassVar[tuple[bytes, ...]] = (b"base", b"Base", b"BASE")
    needs_newline: ClassVar[bool] = False  # a line says how many bytes it has

    def __init__(self) -> None:
        self.is_relative = False
        self._base = 16
        self._open = 0

    def header(self, line: bytes) -> None:
        """Read `base hex  timestamps absolute`."""
        match = _BASE.fullmatch(line)
        if match is None:
            raise ValueError(f"no base of numbers: {shown(line)}")
        self._base = 16 if match[1].lower() == b"hex" else 10
        self.is_relative = b"relative" in match[2].lower()

    def end(self, report: LogReport) -> None:
        """A block that nothing closes goes on."""
        if self._open > 0 and not report.missing:
            report.missing = "nothing closes its `Begin Triggerblock`"

    def read(self, line: bytes) -> Line | None:
        """Read a line: see `Dialect`."""
        if (match := _CLASSIC[self._base].fullmatch(line)) is not None:
            channel, identifier, extended, sent, length, data, _ = match.groups()[2:]
            size = min(_LONGEST, int(length, self._base))
            return self._frame(match, line, (channel, identifier, extended, sent), size, data, 4, 8)
        if (match := _FD[self._base].fullmatch(line)) is not None:
            channel, sent, identifier, extended, length, data, _ = match.groups()[2:]
            kept = b"".join(re.findall(rb"\s+\S+", data)[: int(length)])  # other numbers follow
            return self._frame(match, line, (channel, identifier, extended, sent), int(length), kept, 5, 8)
        return self._other(line)

    def _frame(
        self,
        match: re.Match[bytes],
        line: bytes,
        names: tuple[bytes, bytes, bytes, bytes],
        length: int,
        text: bytes,
        group: int,
        data_group: int,
    ) -> Line:
        """The frame of `names` (channel, identifier, `x`, direction), whose fields are in these groups of the match."""
        channel, identifier, extended, sent = names
        data = text.split()
        if len(data) != length:
            raise ValueError(f"says {length} bytes and has {len(data)}: {shown(line)}")
        values = bytes(int(byte, self._base) for byte in data)
        flags = (EXTENDED if extended else 0) | (SENT if sent.lower() == b"tx" else 0) | (FD if group == 5 else 0)
        fields = None
        begin = match.start(data_group) + 1
        is_even = len(text) == 3 * length and len(identifier) <= _DIGITS and self._base == 16
        if is_even and exact(match.span(1), match.span(2)):
            free = (match.span(9),) if match[9] else ()
            end = begin + max(0, 3 * length - 1)
            fields = Fields((match.start(1), match.end(2)), match.span(group), (begin, end), 3, free)
        return Line(channel, _seconds(match), int(identifier, self._base), flags, values, fields)

    def _other(self, line: bytes) -> Line | None:
        """A line without data."""
        if (match := _REMOTE.fullmatch(line)) is not None:
            channel, identifier, extended, sent, length = match.groups()[2:]
            flags = REMOTE | (EXTENDED if extended else 0) | (SENT if sent.lower() == b"tx" else 0)
            size = min(_LONGEST, int(length or b"0", self._base))
            return Line(channel, _seconds(match), int(identifier, self._base), flags, bytes(size))
        if (match := _ERROR.fullmatch(line)) is not None:
            return Line(match[3], _seconds(match), 0, ERROR, b"")
        if (match := _EVENT.fullmatch(line) or _REQUEST.fullmatch(line)) is not None:
            return Line(b"", _seconds(match), 0, TIME_ONLY, b"") if self.is_relative else None
        if (match := _TRIGGER.fullmatch(line)) is not None:
            self._open += 1 if match[1].lower() == b"begin" else -1
        elif _HEADER.fullmatch(line) is None:
            raise ValueError(f"no frame nor event: {shown(line)}")
        return None


def _seconds(match: re.Match[bytes]) -> float:
    return float(b".".join((match[1], match[2])))
