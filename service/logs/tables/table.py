"""The signals of a table: which column is which signal, in which unit, and on which clock."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from math import isfinite
from typing import NamedTuple

import msgspec
import numpy as np

from faultline.service.core.signals.merging import MergedPart, MergedSignals
from faultline.service.core.signals.received import Column, Received, Signals
from faultline.service.core.signals.units import MORE
from faultline.service.core.signals.values import Quality
from faultline.service.logs.order import Ordering
from faultline.service.logs.report import LogError, LogReport
from faultline.service.logs.tables.rows import TableFile, TableRows
from faultline.service.logs.units import conversion

_ERROR = int(Quality.ERROR)
_SHOWN = 20  # columns in an error


class ColumnMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which column a signal is: it is `scale * column + offset` in `unit`, or else in the unit that the file says."""

    column: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0


class _Pick(NamedTuple):
    """A signal of a column: its value is `factor * column + shift`."""

    signal: str
    column: str
    factor: float
    shift: float


@dataclass(frozen=True)
class ValueTable:
    """A table beside a log, or as one.

    `where` is the file's path. `maps` says which columns are signals; without an entry a column is the signal of its
    own name. `start_s` is the file's time at log time 0 [s]. `report` says what a first pass found; `span` are the
    first and the last time of the file [s].
    """

    where: str
    file: TableFile = field(repr=False)
    maps: Mapping[str, ColumnMap]
    start_s: float
    report: LogReport
    span: tuple[float, float]

    def has(self, signal: str) -> bool:
        """Return True if the table gives the signal."""
        return signal in self.maps or signal in self.file.units

    def lacking(self, units: Mapping[str, str]) -> str:
        """Return a sentence that names the signals which the table does not give; empty where it gives all."""
        absent = [name for name in units if not self.has(name)]
        if not absent:
            return ""
        there = ", ".join([*self.file.units][:_SHOWN]) + (", ..." if len(self.file.units) > _SHOWN else "")
        return (
            f"{self.where}: no column is {', '.join(absent)}; its columns are {there}: say which is which under "
            "[table.signals] in recording.toml"
        )

    def signals(self, units: Mapping[str, str]) -> Signals:
        """Return those of the signals in `units` (name to unit) that it gives, with log times.

        Raises:
            LogError: the unit of one cannot be converted.
        """
        self._check_names(units)
        picks = [self._pick(name, unit) for name, unit in units.items() if self.has(name)]
        return _TableSignals(self, picks)

    def _check_names(self, units: Mapping[str, str]) -> None:
        """Refuse an entry whose signal nobody wants, and whose name is nearly that of one that has no entry."""
        open_names = [name for name in units if name not in self.maps]
        for name in self.maps.keys() - units.keys():
            if near := get_close_matches(name, open_names, 1, 0.8):
                raise LogError(f"{self.where}: [table.signals] {name} is none of the signals: did you mean {near[0]}?")

    def _pick(self, signal: str, unit: str) -> _Pick:
        how = self.maps.get(signal, ColumnMap(signal))
        if not (isfinite(how.scale) and isfinite(how.offset)):
            raise LogError(f"{self.where}: scale and offset of {signal} under [table.signals] must be numbers")
        given = how.unit or self.file.units[how.column] or unit
        found = conversion(given, unit)
        if found is None:
            raise LogError(
                f"{self.where}: {how.column} is in {given!r}, which cannot be converted to {unit!r}, the unit of "
                f"{signal}; give `unit` under [table.signals.{signal}] in recording.toml{MORE}"
            )
        return _Pick(signal, how.column, how.scale * found.factor, how.offset * found.factor + found.offset)


class _TableSignals:
    def __init__(self, table: ValueTable, picks: list[_Pick]) -> None:
        self._table, self._picks = table, picks

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        """Yield all of the table: see `Signals`. A column is of one source: there is nothing to judge."""
        columns = {pick.column for pick in self._picks}
        report = LogReport()  # the first pass has said what is lost
        streams = self._table.file.streams(columns, report) if columns else []
        if len(streams) == 1:
            yield from self._received(streams[0])
        else:
            parts = [MergedPart(_Given(self._received(stream))) for stream in streams]
            yield from MergedSignals(parts).pieces(judged=judged)

    def strangers(self) -> list[str]:
        """Return nothing: which columns there are is known before."""
        return []

    def _received(self, stream: Iterator[TableRows]) -> Iterator[Received]:
        ordering = Ordering(LogReport())
        last = -np.inf
        for rows in stream:
            if not len(rows.time):
                continue
            time = ordering.times(rows.time) - self._table.start_s
            before = np.concatenate([[last], time[:-1]])
            last = float(time[-1])
            yield Received(float(time[0]), last, time, before, self._columns(rows))

    def _columns(self, rows: TableRows) -> dict[str, Column]:
        found = {}
        for pick in self._picks:
            if pick.column not in rows.values:
                continue
            value = rows.values[pick.column]
            row = np.flatnonzero(~np.isnan(value))
            value = value[row]
            is_number = np.isfinite(value)
            quality = np.where(is_number, 0, _ERROR).astype(np.int8)
            value = np.where(is_number, value, np.nan) * pick.factor + pick.shift
            if len(row):
                found[pick.signal] = Column(row, value, quality)
        return found


class _Given(NamedTuple):
    """Pieces that are read once."""

    received: Iterator[Received]

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        del judged
        return self.received

    def strangers(self) -> list[str]:
        return []


def open_table(
    where: str,
    file: TableFile,
    maps: Mapping[str, ColumnMap] | None = None,
    offset_s: float | None = None,
    start_s: float | None = None,
) -> ValueTable:
    """Read a table once, for what is in it and what was lost.

    `start_s` is the file's time at the CAN log's first frame, None where there is no CAN log: then log time begins with
    the table. With `offset_s` log time is `offset_s` plus the file's time instead.

    Raises:
        LogError: it has no row with a time; a column that is named is not there; it ends before the CAN log begins.
    """
    report = LogReport(what="rows", unit="line")
    first, last = np.inf, -np.inf
    for stream in file.streams((), report):
        ordering = Ordering(report)
        for rows in stream:
            if len(rows.time):
                time = ordering.times(rows.time)
                report.frames += len(time)
                first, last = min(first, float(time[0])), max(last, float(time[-1]))
    if not report.frames:
        losses = "; ".join(report.losses())
        raise LogError(f"{where}: no row with a time could be read" + (f" ({losses})" if losses else ""))
    report.length_s = last - first
    if offset_s is not None:
        start_s = -offset_s
    table = ValueTable(where, file, maps or {}, first if start_s is None else start_s, report, (first, last))
    for signal, each in table.maps.items():
        if each.column not in file.units:
            there = ", ".join([*file.units][:_SHOWN])
            raise LogError(f"{where}: no column {each.column!r} for {signal}; its columns are {there}")
    return table
