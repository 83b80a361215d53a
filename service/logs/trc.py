"""PEAK's TRC text, versions 1.0 to 2.1.

A frame is `1) 1841.3 Rx 0001 8 00 11 22 33 44 55 66 77`, with columns by the version, or by the header's `$COLUMNS`.
Source of the format: PEAK-System, PCAN trace file format.
"""

import re
from datetime import UTC, datetime, timedelta
from typing import ClassVar

from faultline.service.logs.batch import ERROR, EXTENDED, FD, FD_SIZES, REMOTE, SENT
from faultline.service.logs.example import Fields, Line, exact
from faultline.service.logs.report import LogError, LogReport, shown

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
_FD_FRAMES = (b"FD", b"FB", b"FE", b"BI")
_OTHERS = (b"ST", b"EC", b"EV", b"Warng", b"Event")  # state, error counters, events
_ERRORS = (b"ER", b"Error")
_LENGTHS = tuple(sorted(FD_SIZES))  # bytes, by data length code
_EPOCH = datetime(1899, 12, 30, tzinfo=UTC)
_BUS_EVENT = b"FFFFFFFF"  # in place of an identifier, version 1.0
_STANDARD_DIGITS, _DIGITS = 4, 8  # more than the former are of 29 bits
_LONGEST = 8
_MS = 1000.0

_VERSION = re.compile(rb"\d+\.\d+")
_NUMBER = re.compile(rb"(\d+)\)?")
_OFFSET = re.compile(rb"(\d+)(?:\.(\d+))?")
_HEX = re.compile(rb"[0-9A-Fa-f]+")
_WORD = re.compile(rb"\S+")


class Trc:
    """The dialect. State: what the header says.

    Raises:
        LogError: while its header is read, where it is of another version.
    """

    headers: ClassVar[tuple[bytes, ...]] = (b";",)
    needs_newline: ClassVar[bool] = False  # a line says how many bytes it has
    is_relative: ClassVar[bool] = False

    def __init__(self) -> None:
        self._start_s = 0.0
        self._columns = "NOILD"

    def header(self, line: bytes) -> None:
        """Read the version, the time of the start, or the columns; any other is a comment."""
        key, _, value = line.partition(b"=")
        if key == b";$FILEVERSION":
            if not _VERSION.fullmatch(value):
                raise ValueError(f"no version: {shown(line)}")
            if value not in _COLUMNS:
                raise LogError(f"TRC version {value.decode(errors='replace')} is not known; save it as 2.1")
            self._columns = _COLUMNS[value].decode()
        elif key == b";$STARTTIME":
            try:
                self._start_s = (_EPOCH + timedelta(days=float(value))).timestamp()
            except (OverflowError, ValueError) as error:
                raise ValueError(f"no time: {shown(line)}") from error
        elif key == b";$COLUMNS":
            self._columns = "".join(value.decode(errors="replace").split(","))

    def end(self, report: LogReport) -> None:
        """An incomplete last record shows that the end is missing."""
        if report.truncated and not report.missing:
            report.missing = "its last record is incomplete"

    def read(self, line: bytes) -> Line | None:
        """Read a line: see `Dialect`."""
        words = [match.span() for match in _WORD.finditer(line)]
        if not words:
            return None
        spans = dict(zip(self._columns, words, strict=False))
        if "D" in spans:
            spans["D"] = (spans["D"][0], words[-1][1])
        row = {column: line[begin:end] for column, (begin, end) in spans.items()}
        offset = _OFFSET.fullmatch(row.get("O", b""))
        if offset is None or not _NUMBER.fullmatch(row.get("N", b"")):
            raise ValueError(f"no record: {shown(line)}")
        kind = row.get("T", row.get("d", b"Rx"))
        if kind in _OTHERS or row.get("I") == _BUS_EVENT:
            return None
        time = self._start_s + float(row["O"]) / _MS
        if kind in _ERRORS:
            return Line(_bus(row), time, 0, ERROR, b"")
        if kind not in (*_FRAMES, b"RR", b"Rx", b"Tx"):
            raise ValueError(f"no record of a known type: {shown(line)}")
        try:
            return self._frame(row, spans, time, kind)
        except (KeyError, IndexError, ValueError) as error:
            words_ = str(error) if str(error).startswith("says") else "no frame"
            raise ValueError(f"{words_}: {shown(line)}") from error

    def _frame(self, row: dict[str, bytes], spans: dict[str, tuple[int, int]], time: float, kind: bytes) -> Line:
        """A data or remote frame; raises where a column is missing or cannot be read."""
        length = int(row["l"]) if "l" in row else _LENGTHS[int(row["L"])]
        identifier, text = row["I"], row.get("D", b"")
        if not _HEX.fullmatch(identifier):
            raise ValueError
        can_id, channel = int(identifier, 16), _bus(row)
        flags = EXTENDED if len(identifier) > _STANDARD_DIGITS else 0
        flags |= SENT if b"Tx" in (kind, row.get("d")) else 0
        if kind == b"RR" or text.startswith(b"RTR"):
            return Line(channel, time, can_id, flags | REMOTE, bytes(min(_LONGEST, length)))
        data = bytes.fromhex(text.decode())
        if len(data) != length or length not in FD_SIZES:
            raise ValueError(f"says {length} bytes and has {len(data)}")
        flags |= FD if kind in _FD_FRAMES else 0
        return Line(channel, time, can_id, flags, data, self._fields(row, spans, length))

    def _fields(self, row: dict[str, bytes], spans: dict[str, tuple[int, int]], length: int) -> Fields | None:
        """Where they are, in the usual form."""
        offset, number = _OFFSET.fullmatch(row["O"]), _NUMBER.fullmatch(row["N"])
        assert offset is not None
        assert number is not None
        data = spans.get("D", (0, 0))
        is_even = data[1] - data[0] == max(0, 3 * length - 1) and not row.get("D", b"")[2::3].strip()
        if not is_even or len(row["I"]) > _DIGITS:
            return None
        if not exact(offset.span(1), (0, 0) if offset[2] is None else offset.span(2)):
            return None
        counted = spans["N"][0], spans["N"][0] + number.end(1)
        return Fields(spans["O"], spans["I"], data, 3, (), counted, self._start_s, _MS)


def _bus(row: dict[str, bytes]) -> bytes:
    return str(int(row.get("B", b"1"))).encode()
