"""Reads Vector's ASC logs; a line that should be a frame and cannot be read is counted.

A classic frame is `0.015991 1 18FF103Dx Rx d 8 00 11 22 33 44 55 66 77`, with an `x` after identifiers of 29 bits; a
CAN FD frame begins `0.015991 CANFD 1 Rx`. Other events of a measurement are skipped. Source of the format: what
CANoe and python-can write.
"""

import re
from collections.abc import Iterator

from faultline.service.logs.report import Frame, LogReport, OnChannel, read_lines, shown

_HEADER = re.compile(rb"date\s.*|base\s+(hex|dec)\b(.*)|(?:no\s+)?internal\s+events\s+logged|//.*|", re.IGNORECASE)
_TRIGGER = re.compile(rb"(begin|end)\s+triggerblock\b.*", re.IGNORECASE)
_DATA = {16: rb"[0-9a-f]{2}", 10: rb"\d{1,3}"}  # a byte, by the base of the file's numbers
_CLASSIC, _FD = (
    {
        base: re.compile(rb"(\d+\.\d+)\s+" + head + rb"((?:\s+" + byte + rb"(?!\S))*)" + tail, re.IGNORECASE)
        for base, byte in _DATA.items()
    }
    for head, tail in (
        (rb"(\d+)\s+([0-9a-f]+)(x?)\s+(?:Rx|Tx)\s+d\s+([0-9a-f]+)", rb"(?:\s+[a-z].*)?"),
        (
            rb"CANFD\s+(\d+)\s+(?:Rx|Tx)\s+([0-9a-f]+)(x?)\s+(?:[a-z_]\S*\s+)?[01]\s+[01]\s+[0-9a-f]+\s+(\d+)",
            rb"(?:\s+.*)?",
        ),
    )
)
_REMOTE = re.compile(rb"\d+\.\d+\s+\d+\s+[0-9a-f]+x?\s+(?:Rx|Tx)\s+r\b.*", re.IGNORECASE)
_ERROR = re.compile(rb"\d+\.\d+\s+(?:\d+|CANFD\s+\d+\s+(?:Rx|Tx))\s+ErrorFrame\b.*", re.IGNORECASE)
_EVENT = re.compile(
    rb"\d+\.\d+\s+(?:\d+\s+J1939TP\b[ -~]*|(?!CANFD\b)(?!.*\s(?-i:[dr])\s+[0-9a-f]{1,2}\b)"
    rb"(?:[a-z]{2}[ -~]*|\d+\s+(?![0-9a-f]+x?(?:\s|$))[a-z](?!.*\s(?:Rx|Tx)\b)[ -~]*))",
    re.IGNORECASE,
)
"""What is of another bus, or no frame; nothing that looks like the rest of a damaged frame, as an identifier does that
begins with a letter."""
_REQUEST = re.compile(rb"\d+\.\d+\s+(?:\d+\s+[0-9a-f]+x?|CANFD\s+\d+)\s+TxRq\b.*", re.IGNORECASE)  # not yet on the bus
_LONGEST = 8  # bytes of a classic frame


def read_asc(content: bytes, report: LogReport) -> Iterator[OnChannel]:
    """The data frames of a log in the file's order."""
    asc = _Asc(report)
    yield from read_lines(content, report, asc.take)
    if asc.open_blocks > 0:
        report.missing = "nothing closes its `Begin Triggerblock`"


class _Asc:
    """State: what the header says, and the last time, which the next one may be relative to."""

    def __init__(self, report: LogReport) -> None:
        self._report = report
        self._base = 16
        self._is_relative = False
        self._last_s = 0.0
        self.open_blocks = 0

    def take(self, line: bytes) -> OnChannel | None:
        if (match := _CLASSIC[self._base].fullmatch(line)) is not None:
            *_, length, data = match.groups()
            return self._frame(line, match, min(_LONGEST, int(length, self._base)), data.split())
        if (match := _FD[self._base].fullmatch(line)) is not None:
            *_, length, data = match.groups()
            return self._frame(line, match, int(length), data.split()[: int(length)])  # other numbers follow
        if (match := _TRIGGER.fullmatch(line)) is not None:
            self.open_blocks += 1 if match[1].lower() == b"begin" else -1
        elif (match := _HEADER.fullmatch(line)) is not None:
            if match[1]:
                self._base = 16 if match[1].lower() == b"hex" else 10
                self._is_relative = b"relative" in match[2].lower()
        elif _REMOTE.fullmatch(line):
            self._report.remote += 1
        elif _ERROR.fullmatch(line):
            self._report.errors += 1
        elif not (_EVENT.fullmatch(line) or _REQUEST.fullmatch(line)):
            raise ValueError(f"no frame nor event: {shown(line)}")
        self._time(line)
        return None

    def _frame(self, line: bytes, match: re.Match[bytes], length: int, data: list[bytes]) -> OnChannel:
        if len(data) != length:
            raise ValueError(f"says {length} bytes and has {len(data)}: {shown(line)}")
        channel, identifier, extended = match[2], match[3], match[4]
        values = bytes(int(byte, self._base) for byte in data)
        return channel, Frame(self._time(line), int(identifier, self._base), bool(extended), values)

    def _time(self, line: bytes) -> float:
        """The line's time [s] after the first, if it has one."""
        if line[:1].isdigit():
            t = float(line.split(None, 1)[0])
            self._last_s = self._last_s + t if self._is_relative else t
        return self._last_s
