"""Frames as CSV: python-can's own, and tables of other loggers whose header names their columns.

Columns are known by their names (`_NAMES`), whatever their case, spaces and units; data are hexadecimal, in one column
or in a column a byte. An identifier is hexadecimal where the header or `0x` says so, or any of the first rows has a
letter or a leading zero, else decimal; it has 29 bits where a column says so, else where it needs them or has eight
digits. A time is in seconds, or in the unit that the header names; whole numbers without a unit are in the one that
makes them a date, or in microseconds where they are none, as in SavvyCAN's tables.
"""

import re
from base64 import b64decode
from datetime import UTC, datetime
from math import nan
from typing import ClassVar, NamedTuple

from faultline.service.logs.batch import ERROR, EXTENDED, FD, FD_SIZES, REMOTE, SENT, TOP
from faultline.service.logs.example import BASE64, NOWHERE, Fields, Line, Span, exact
from faultline.service.logs.report import LogReport, shown

_NAMES = {
    "time": ("time", "timestamp", "timestampepoch", "epoch", "ts", "timestamps", "timeoffset", "offset", "abstime"),
    "id": ("arbitrationid", "canid", "id", "identifier", "messageid", "msgid", "frameid", "arbid"),
    "data": ("data", "databytes", "payload", "datahex", "rawdata", "bytes"),
    "length": ("datalength", "dlc", "len", "length", "size"),
    "channel": ("channel", "bus", "buschannel", "ch", "interface", "iface"),
    "extended": ("extended", "ide", "ext", "isextended", "isextendedid", "xtd"),
    "remote": ("remote", "rtr", "isremote", "isremoteframe"),
    "error": ("error", "err", "iserrorframe"),
    "fd": ("fd", "edl", "fdf", "isfd"),
    "direction": ("dir", "direction", "rxtx"),
}
_FLAGS = {"extended": EXTENDED, "remote": REMOTE, "error": ERROR, "fd": FD, "direction": SENT}
_TRUE = frozenset((b"1", b"true", b"t", b"yes", b"x", b"tx"))
_FALSE = frozenset((b"0", b"false", b"f", b"no", b"r", b"rx", b"-", b""))
_UNITS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "ns": 1e9}
_DATES = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3))  # whole numbers from which on they are a date, and in which unit
_MICROSECONDS = 1e6

_PYTHON_CAN = re.compile(rb"timestamp[a-z_,]*")
_ROW = re.compile(
    rb"\s*(-?\d+(?:\.\d*)?(?:e[-+]?\d+)?),(?:0x)?([0-9a-f]+),([01]),([01]),([01]),(\d+),([\w+/=]*)\s*", re.IGNORECASE
)
_TITLE = re.compile(r"([^\[(]*)(?:[\[(]([^\])]*)[\])])?.*")
_BYTE = re.compile(r"(?:d|b|data|byte|databyte)(\d{1,2})")
_PLAIN = re.compile(rb"(\d+)(?:\.(\d+))?")
_HEX = re.compile(rb"(0[xX])?([0-9A-Fa-f]+)h?")
_DATA = re.compile(rb"(?:0[xX])?([0-9A-Fa-f]{2}(?:([ :.-]?)[0-9A-Fa-f]{2}(?:\2[0-9A-Fa-f]{2})*)?|)")
_HEAD_LINES, _HEAD_ROWS = 20, 200


class PythonCanCsv:
    """The dialect of python-can, with data as base64."""

    headers: ClassVar[tuple[bytes, ...]] = ()
    needs_newline: ClassVar[bool] = False
    is_relative: ClassVar[bool] = False

    def header(self, line: bytes) -> None:
        """There is none that matters."""

    def end(self, report: LogReport) -> None:
        """Nothing says where the end is."""

    def read(self, line: bytes) -> Line | None:
        """Read a line: see `Dialect`."""
        if not line.strip() or _PYTHON_CAN.fullmatch(line.strip()):
            return None
        match = _ROW.fullmatch(line)
        if match is None:
            raise ValueError(f"no row of a log: {shown(line)}")
        stamp, identifier, extended, remote, error, length, text = match.groups()
        flags = (EXTENDED if extended == b"1" else 0) | (REMOTE if remote == b"1" else 0)
        flags |= ERROR if error == b"1" else 0
        data = bytes(min(8, int(length))) if flags & REMOTE else b64decode(text, validate=True)
        size = len(data) if flags & (REMOTE | ERROR) else int(length)
        if len(data) != size or size not in FD_SIZES:
            raise ValueError(f"says {size} bytes and has {len(data)}: {shown(line)}")
        flags |= FD if size > 8 else 0
        plain = _PLAIN.fullmatch(stamp)
        fields = None
        if plain and exact(plain.span(1), plain.span(2) if plain[2] else NOWHERE) and len(identifier) <= 8:
            fields = (
                Fields(match.span(1), match.span(2), match.span(7), BASE64) if not flags & (REMOTE | ERROR) else None
            )
        return Line(b"", float(stamp), int(identifier, 16), flags, data, fields)


class _Cell(NamedTuple):
    """What a row has in a column, and where."""

    text: bytes
    span: Span


class Table(NamedTuple):
    """A header: its line, the delimiter, and the number of each column that matters, by what it holds.

    `each_byte` are the columns of the data where each byte has its own; `unit` is that of the times, as the header
    names it, and `is_hex` says that it names the identifier's base.
    """

    line: bytes
    delimiter: bytes
    columns: dict[str, int]
    each_byte: list[int]
    unit: str
    is_hex: bool

    def cells(self, line: bytes) -> list[_Cell]:
        """The cells of a row, without quotes and spaces around them."""
        found, begin = [], 0
        for raw in line.rstrip().split(self.delimiter):
            text = raw.strip(b'" \t')
            at = begin + (raw.find(text) if text else 0)
            found.append(_Cell(text, (at, at + len(text))))
            begin += len(raw) + 1
        return found


def find_table(head: bytes) -> Table | None:
    """The header in the first lines of a CSV file that names an identifier and data; None where there is none."""
    for line in head.lstrip(b"\xef\xbb\xbf").split(b"\n", _HEAD_LINES)[:_HEAD_LINES]:
        for delimiter in (each for each in (b",", b";", b"\t") if each in line):
            titles = [each.strip(' "\r') for each in line.decode("latin-1").split(delimiter.decode())]
            table = _table(line.strip(), delimiter, titles)
            if table is not None:
                return table
    return None


def _table(line: bytes, delimiter: bytes, titles: list[str]) -> Table | None:
    matches = [_TITLE.fullmatch(each.lower()) for each in titles]
    names = [(re.sub(r"[\s_]", "", match[1]), match[2] or "") if match else ("", "") for match in matches]
    columns = {}
    for what, known in _NAMES.items():
        there = [k for name in known for k, (title, _) in enumerate(names) if title == name]
        if there:
            columns[what] = there[0]
    bytes_ = sorted((int(match[1]), k) for k, (title, _) in enumerate(names) if (match := _BYTE.fullmatch(title)))
    if "id" not in columns or not ("data" in columns or bytes_):
        return None
    unit = names[columns["time"]][1] if "time" in columns else ""
    return Table(line, delimiter, columns, [k for _, k in bytes_], unit, names[columns["id"]][1].startswith("hex"))


class TableCsv:
    """The dialect of a table, as its head shows it."""

    headers: ClassVar[tuple[bytes, ...]] = ()
    needs_newline: ClassVar[bool] = False
    is_relative: ClassVar[bool] = False

    def __init__(self, table: Table, head: bytes) -> None:
        self._table = table
        self._count = 1 + max(table.columns.values())
        rows = [table.cells(line) for line in head.split(b"\n")[:_HEAD_ROWS] if line.strip() != table.line]
        rows = [row for row in rows if len(row) >= self._count]
        self.has_times = "time" in table.columns
        self._is_hex = table.is_hex or any(_shows_hex(row[table.columns["id"]].text) for row in rows)
        times = [row[table.columns["time"]].text for row in rows] if self.has_times else []
        self._divisor = _UNITS.get(table.unit) or _unit_of([each for each in times if each[:1].isdigit()])

    def header(self, line: bytes) -> None:
        """It was read from the head."""

    def end(self, report: LogReport) -> None:
        """Nothing says where the end is."""

    def read(self, line: bytes) -> Line | None:
        """Read a line: see `Dialect`."""
        if not line.strip() or line.strip().removeprefix(b"\xef\xbb\xbf") == self._table.line:
            return None
        cells = self._table.cells(line)
        if len(cells) < self._count:
            raise ValueError(f"no row of a log: {shown(line)}")
        row = {what: cells[k] for what, k in self._table.columns.items()}
        try:
            return self._frame(row, cells)
        except ValueError as error:
            raise ValueError(f"{error}: {shown(line)}") from error

    def _frame(self, row: dict[str, _Cell], cells: list[_Cell]) -> Line:
        flags = sum(flag for what, flag in _FLAGS.items() if what in row and _truth(row[what].text))
        identifier = _HEX.fullmatch(row["id"].text)
        if identifier is None:
            raise ValueError("no identifier")
        is_hex = self._is_hex or identifier[1] is not None
        can_id = int(identifier[2], 16 if is_hex else 10)
        if "extended" not in row:
            flags |= EXTENDED if can_id > TOP or (is_hex and len(identifier[2]) == 8) else 0
        channel = row["channel"].text if "channel" in row else b""
        length = int(row["length"].text) if "length" in row and row["length"].text else None
        time = self._time(row["time"].text) if "time" in row else nan
        if flags & (REMOTE | ERROR):
            return Line(channel, time, can_id, flags, bytes(min(8, length or 0)))
        data, inner = self._data(row, cells, length)
        if length not in (None, len(data)) or len(data) not in FD_SIZES:
            raise ValueError(f"says {length} bytes and has {len(data)}")
        flags |= FD if len(data) > 8 else 0
        fields = self._fields(row, identifier, inner) if inner is not None else None
        return Line(channel, time, can_id, flags, data, fields)

    def _data(
        self, row: dict[str, _Cell], cells: list[_Cell], length: int | None
    ) -> tuple[bytes, tuple[Span, int] | None]:
        """The data, and where they are and with which stride, where they are in one column."""
        if "data" not in row:
            texts = [cells[k].text for k in self._table.each_byte if k < len(cells)]
            there = [each for each in texts if each][:length]
            if any(_HEX.fullmatch(each) is None or int(each, 16) > 0xFF for each in there):
                raise ValueError("no data")
            return bytes(int(each, 16) for each in there), None
        match = _DATA.fullmatch(row["data"].text)
        if match is None:
            raise ValueError("no data")
        data = bytes.fromhex(re.sub(rb"[ :.-]", b"", match[1]).decode())
        begin = row["data"].span[0]
        return data, ((begin + match.start(1), begin + match.end(1)), 3 if match[2] else 2)

    def _time(self, text: bytes) -> float:
        """A number in the table's unit [s], or a date, which is UTC where it names no zone."""
        try:
            return float(text.replace(b",", b".")) / self._divisor
        except ValueError:
            date = datetime.fromisoformat(text.decode())
            return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()

    def _fields(self, row: dict[str, _Cell], identifier: re.Match[bytes], inner: tuple[Span, int]) -> Fields | None:
        """Where they are, in the usual form: what is in another column is the same in lines that are alike."""
        is_hex = self._is_hex or identifier[1] is not None
        begin = row["id"].span[0]
        where = begin + identifier.start(2), begin + identifier.end(2)
        shows_bits = "extended" in row or where[1] - where[0] == 8
        if not is_hex or where[1] - where[0] > 8 or not shows_bits:
            return None
        if "time" not in row:
            return Fields(NOWHERE, where, inner[0], inner[1])
        plain = _PLAIN.fullmatch(row["time"].text)
        if plain is None or not exact(plain.span(1), plain.span(2) if plain[2] else NOWHERE):
            return None
        return Fields(row["time"].span, where, inner[0], inner[1], divisor=self._divisor)


def _shows_hex(text: bytes) -> bool:
    match = _HEX.fullmatch(text)
    return match is not None and match[1] is None and (not match[2].isdigit() or (match[2][:1] == b"0" != match[2]))


def _truth(text: bytes) -> bool:
    if text.lower() in _TRUE:
        return True
    if text.lower() not in _FALSE:
        raise ValueError(f"neither yes nor no: {text.decode(errors='replace')}")
    return False


def _unit_of(times: list[bytes]) -> float:
    """The divisor of times [1/s] whose header names no unit."""
    if not times or not all(each.isdigit() for each in times):
        return 1.0
    largest = max(int(each) for each in times)
    return next((divisor for least, divisor in _DATES if largest >= least), _MICROSECONDS if largest < 1e9 else 1.0)
