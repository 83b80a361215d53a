"""A table as text: a header with the columns' names, then rows (CSV with a comma, a semicolon or a tab).

Units are in brackets behind the names or in a line of their own below them. With another delimiter than a comma,
numbers may have a decimal comma. Times are seconds, or in the header's unit, or dates (`service.logs.tables.dates`).
"""

import csv
from collections.abc import Collection, Iterator, Sequence
from functools import cached_property
from io import StringIO
from itertools import chain
from math import inf, isfinite, nan
from typing import NamedTuple

import numpy as np

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.delimited import find_table
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogError, LogReport, shown
from faultline.service.logs.tables.dates import date_s, is_ambiguous, is_month_first
from faultline.service.logs.tables.rows import TableRows, distinct, is_time, per_second, title

_HEAD_LINES = 20
_LONGEST_LINE = 1 << 20
_DELIMITERS = (",", ";", "\t")
_TRUTH = {"true": 1.0, "false": 0.0}
_NOTHING = frozenset(("", "-", "--", "nan", "null", "none", "na", "n/a", "#n/a"))


class TableHeader(NamedTuple):
    """A header: its line (from 1), the delimiter, titles, units, the number of the times, and the first row's line.

    Where there are no times it is -1, and `period_s` lies between two rows.
    """

    line: int
    delimiter: str
    names: list[str]
    units: list[str]
    time: int
    first: int
    period_s: float = 0.0


def find_header(head: bytes, time: str | float | None = None) -> TableHeader | None:
    """Return the header of a table in the first bytes of a file; None where it is none, or one of CAN frames.

    `time` names the column of the times, which is else known by its name; a number is the seconds from row to row.

    Raises:
        LogError: there is such a column, and what it holds is no time; the message does not name the file.
    """
    first = b"\n".join(head.removeprefix(b"\xef\xbb\xbf").split(b"\n", _HEAD_LINES + 2)[: _HEAD_LINES + 2])
    lines = first.decode("latin-1" if b"\xff" in first else "utf-8", "replace").splitlines()
    unread = ""
    for number, line in enumerate(lines[:_HEAD_LINES]):
        for delimiter in (each for each in _DELIMITERS if each in line):
            cells = _cells(line, delimiter)
            if isinstance(time, float):
                if len(cells) > 1 and (found := _counted(lines[number:], number + 1, delimiter, time)) is not None:
                    return found
                continue
            at = [k for k, cell in enumerate(cells) if (title(cell)[0] == time if time else is_time(title(cell)[0]))]
            if len(cells) < 2 or not at:
                continue
            rows = [_cells(each, delimiter) for each in lines[number + 1 : number + 3]]
            for skipped, row in enumerate(rows):
                if len(row) == len(cells) and _is_time(row[at[0]], delimiter):
                    return _header(number + 1, delimiter, cells, rows[0] if skipped else None, at[0])
            if not unread and rows and len(rows[-1]) == len(cells):
                unread = f"line {number + len(rows) + 1}: {rows[-1][at[0]]!r} in column {title(cells[at[0]])[0]!r}"
    if unread:
        raise LogError(
            f"{unread} is no time; give seconds, or dates as 2026-01-31T12:00:00, 31.1.2026 12:00:00 or 1/31/2026 12:00"
        )
    return None


def _counted(lines: Sequence[str], number: int, delimiter: str, period_s: float) -> TableHeader | None:
    """The header whose line, the first of these, is of words and has a row with numbers below, or below its units."""
    cells, *rows = [_cells(each, delimiter) for each in lines[:3]]
    if any(isfinite(_value(cell, delimiter)) for cell in cells):
        return None
    for skipped, row in enumerate(rows):
        if len(row) == len(cells) and any(isfinite(_value(cell, delimiter)) for cell in row):
            header = _header(number, delimiter, cells, rows[0] if skipped else None, -1)
            return header._replace(period_s=period_s)
    return None


def _header(line: int, delimiter: str, cells: list[str], below: list[str] | None, time: int) -> TableHeader:
    found = [title(cell) for cell in cells]
    units = [unit for _, unit in found]
    if below is not None and len(below) == len(cells):
        units = [each.strip("[]() ") or unit for each, unit in zip(below, units, strict=True)]
    return TableHeader(
        line, delimiter, distinct([name for name, _ in found]), units, time, line + (2 if below is not None else 1)
    )


class TextTable:
    """A table as text."""

    kind = "CSV table of values"

    def __init__(self, source: Source, header: TableHeader) -> None:
        self._source, self._header = source, header
        self.units = {
            name: unit
            for k, (name, unit) in enumerate(zip(header.names, header.units, strict=True))
            if k != header.time and name
        }

    @cached_property
    def _month_first(self) -> bool:
        """Return whether the month is first in dates; where one date does not show it, all rows are read."""
        header = self._header
        if header.period_s:
            return True
        dates = (cells[header.time] for cells in self._cells() if len(cells) > header.time)
        first = next((cell for cell in dates if _is_time(cell, header.delimiter)), "")
        return is_month_first(chain([first], dates)) if is_ambiguous(first) else True

    def _cells(self) -> Iterator[list[str]]:
        """Yield the cells of each line."""
        rest = b""
        for piece in self._source.pieces(LogReport()):
            *lines, rest = (rest + piece).split(b"\n")
            yield from (_cells(line.decode("utf-8", "replace"), self._header.delimiter) for line in lines)

    def streams(self, names: Collection[str], report: LogReport) -> Sequence[Iterator[TableRows]]:
        """Return the rows: see `TableFile`."""
        return [self._rows([name for name in self.units if name in names], report)]

    def _rows(self, names: Sequence[str], report: LogReport) -> Iterator[TableRows]:
        parser = _Parser(self._header, names, report, month_first=self._month_first)
        rest = b""
        for piece in self._source.pieces(report):
            whole, newline, rest = (rest + piece).rpartition(b"\n")
            if newline:
                yield parser.rows(whole + newline)
            elif len(rest) > _LONGEST_LINE:
                report.reject(parser.line, f"a line of more than {_LONGEST_LINE >> 20} MiB", len(rest))
                rest = b""
        if rest.strip(b"\0 \r"):
            report.truncated = True


class _Parser:
    """Rows of whole lines. State: the number of the next line."""

    def __init__(self, header: TableHeader, names: Sequence[str], report: LogReport, *, month_first: bool) -> None:
        self._header, self._names, self._report, self._month_first = header, names, report, month_first
        self._use = [max(header.time, 0), *(header.names.index(name) for name in names)]
        self._unit = 1.0 if header.period_s else per_second(header.names[header.time], header.units[header.time])
        self.line = 1

    def rows(self, text: bytes) -> TableRows:
        """Return the rows of a text of whole lines."""
        begin, count = self.line, text.count(b"\n")
        self.line += count
        if begin < self._header.first:
            skipped = min(count, self._header.first - begin)
            text = text.split(b"\n", skipped)[skipped]
            begin, count = begin + skipped, count - skipped
        lines = text.decode("utf-8", "replace")
        table = self._at_once(lines, begin, count)
        if table is None:
            table = self._one_by_one(lines.split("\n")[:-1], begin)
        return TableRows(table[:, 0], {name: table[:, k + 1] for k, name in enumerate(self._names)})

    def _at_once(self, text: str, begin: int, count: int) -> FloatArray | None:
        """Return the cells (N, 1 + n) from the line `begin` on, if all are numbers; else None."""
        header = self._header
        if text.count(header.delimiter) != count * (len(header.names) - 1) or not count:
            return None
        if header.delimiter != ",":
            text = text.replace(",", ".")
        try:
            found = np.loadtxt(StringIO(text), delimiter=header.delimiter, usecols=self._use, ndmin=2, comments=None)
        except ValueError:
            return None
        if len(found) != count or not np.isfinite(found[:, 0]).all():
            return None
        if header.period_s:
            found[:, 0] = header.period_s * np.arange(begin - header.first, begin - header.first + count)
            return found
        found[:, 0] /= self._unit if self._unit != 1.0 else unit_of_dates(float(found[-1, 0]))
        return found

    def _one_by_one(self, lines: Sequence[str], begin: int) -> FloatArray:
        header = self._header
        found = []
        for number, line in enumerate(lines, begin):
            cells = _cells(line, header.delimiter)
            if not line.strip("\0 \r") or distinct([title(cell)[0] for cell in cells]) == header.names:
                continue
            raw = line.encode()
            if len(cells) != len(header.names):
                reason = f"{len(cells)} cells, the header has {len(header.names)}: {shown(raw)}"
                self._report.reject(number, reason, len(raw) + 1)
            elif (t := self._time(cells, number)) is None:
                self._report.reject(number, f"no time: {shown(raw)}", len(raw) + 1)
            else:
                found.append([t, *(_value(cells[k], header.delimiter) for k in self._use[1:])])
        return np.array(found, np.float64).reshape(-1, len(self._use))

    def _time(self, cells: Sequence[str], number: int) -> float | None:
        """The time of a row [s]: by its line where none is in it."""
        header = self._header
        if header.period_s:
            return header.period_s * (number - header.first)
        return _time_s(cells[header.time], header.delimiter, self._unit, month_first=self._month_first)


def unit_of_dates(t: float) -> float:
    """Return how many units of a time without one are in a second: whole numbers that are dates only in ms, us or ns.

    >>> unit_of_dates(1.7e9), unit_of_dates(1.7e12), unit_of_dates(3.0)
    (1.0, 1000.0, 1.0)
    """
    return next((per_s for least, per_s in ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3)) if abs(t) >= least), 1.0)


def _cells(line: str, delimiter: str) -> list[str]:
    if '"' not in line:
        return [cell.strip() for cell in line.rstrip("\r").split(delimiter)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def _is_time(cell: str, delimiter: str) -> bool:
    return any(_time_s(cell, delimiter, month_first=first) is not None for first in (True, False))


def _time_s(cell: str, delimiter: str, unit: float = 1.0, *, month_first: bool = True) -> float | None:
    """Return a time [s]; None where it is none."""
    try:
        t = float(cell.replace(",", ".") if delimiter != "," else cell)
    except ValueError:
        return date_s(cell, month_first=month_first)
    if not -inf < t < inf:
        return None
    return t / (unit if unit != 1.0 else unit_of_dates(t))


def _value(cell: str, delimiter: str) -> float:
    """Return a number, or 1 or 0 of a truth; NaN where the cell is empty, infinity where it holds something else."""
    try:
        return float(cell.replace(",", ".") if delimiter != "," else cell)
    except ValueError:
        return _TRUTH.get(cell.lower(), nan if cell.lower() in _NOTHING else inf)


def text_table(source: Source, time: str | float | None = None) -> TextTable | None:
    """Return the table that a text file holds; None where it holds none, or CAN frames.

    Raises:
        LogError: it is a table whose times are not understood.
    """
    if find_table(source.head) is not None:
        return None
    try:
        header = find_header(source.head, time)
    except LogError as error:
        raise LogError(f"{source.path}: {error}") from error
    return None if header is None else TextTable(source, header)
