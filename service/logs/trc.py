"""Reads PEAK's TRC logs, versions 1.0 to 2.1; a line that cannot be read is counted.

A frame is `1) 1841.3 Rx 0001 8 00 11 22 33 44 55 66 77`, with columns by the version, or by the header's `$COLUMNS`.
Source of the format: PEAK-System, PCAN trace file format.
"""

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from faultline.service.logs.report import Frame, LogError, LogReport, OnChannel, read_lines, shown

_COLUMNS = {
    b"1.0": b"NOILD",
    b"1.1": b"NOdILD",
    b"1.2": b"NOBdILD",
    b"1.3": b"NOBdIRLD",
    b"2.0": b"",
    b"2.1": b"",
}
"""Number, offset [ms], bus, direction or type, identifier, reserved, length code, data; from 2.0 on as the header says.
"""
_FRAMES = (b"DT", b"FD", b"FB", b"FE", b"BI")
_OTHERS = (b"ST", b"EC", b"EV", b"Warng", b"Event")  # state, error counters, events
_ERRORS = (b"ER", b"Error")
_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # bytes, by data length code
_EPOCH = datetime(1899, 12, 30, tzinfo=UTC)
_BUS_EVENT = b"FFFFFFFF"  # in place of an identifier, version 1.0
_STANDARD_DIGITS = 4  # more are of 29 bits


def read_trc(content: bytes, report: LogReport) -> Iterator[OnChannel]:
    """The data frames of a log in the file's order.

    Raises:
        LogError: it is of another version, or names no columns.
    """
    yield from read_lines(content, report, _Trc(report).take)
    if report.truncated:
        report.missing = "its last record is incomplete"


class _Trc:
    """State: what the header says."""

    def __init__(self, report: LogReport) -> None:
        self._report = report
        self._start_s = 0.0
        self._columns = tuple("NOILD")

    def take(self, line: bytes) -> OnChannel | None:
        if line.startswith(b";"):
            self._header(line)
            return None
        if not line:
            return None
        row = dict(zip(self._columns, line.split(None, len(self._columns) - 1), strict=False))
        if not re.fullmatch(rb"\d+\)?", row.get("N", b"")) or not re.fullmatch(rb"\d+(\.\d+)?", row.get("O", b"")):
            raise ValueError(f"no record: {shown(line)}")
        kind = row.get("T", row.get("d", b"Rx"))
        if kind in _ERRORS:
            self._report.errors += 1
        elif kind in _OTHERS or row.get("I") == _BUS_EVENT:
            pass
        elif kind == b"RR" or row.get("D", b"").startswith(b"RTR"):
            self._report.remote += 1
        elif kind in (*_FRAMES, b"Rx", b"Tx"):
            return self._frame(line, row)
        else:
            raise ValueError(f"no record of a known type: {shown(line)}")
        return None

    def _frame(self, line: bytes, row: dict[str, bytes]) -> OnChannel:
        try:
            length = int(row["l"]) if "l" in row else _LENGTHS[int(row["L"])]
            identifier = row["I"]
            data = bytes.fromhex(row.get("D", b"").decode())
            can_id, channel = int(identifier, 16), str(int(row.get("B", b"1"))).encode()
        except (KeyError, IndexError, ValueError) as error:
            raise ValueError(f"no frame: {shown(line)}") from error
        if len(data) != length:
            raise ValueError(f"says {length} bytes and has {len(data)}: {shown(line)}")
        t = self._start_s + float(row["O"]) / 1000
        return channel, Frame(t, can_id, len(identifier) > _STANDARD_DIGITS, data)

    def _header(self, line: bytes) -> None:
        key, _, value = line.partition(b"=")
        if key == b";$FILEVERSION":
            if value not in _COLUMNS:
                raise LogError(f"TRC version {value.decode(errors='replace')} is not known; save it as 2.1")
            self._columns = tuple(_COLUMNS[value].decode())
        elif key == b";$STARTTIME":
            try:
                self._start_s = (_EPOCH + timedelta(days=float(value))).timestamp()
            except (OverflowError, ValueError) as error:
                raise ValueError(f"no time: {shown(line)}") from error
        elif key == b";$COLUMNS":
            self._columns = tuple(value.decode().split(","))
