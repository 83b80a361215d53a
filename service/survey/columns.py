"""What is in the columns of a table of values."""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.report import LogReport
from faultline.service.logs.tables.table import ValueTable
from faultline.service.logs.units import conversion
from faultline.service.survey.signals import SignalRow


class ColumnRow(msgspec.Struct):
    """A column: its values, by number, least and greatest in its unit, and cells that hold something else.

    `first_s` and `last_s` are log times of values [s], `period_s` is the median from one to the next.
    """

    name: str
    unit: str
    count: int
    not_numbers: int
    first_s: float | None
    last_s: float | None
    period_s: float | None
    least: float | None
    greatest: float | None


@dataclass
class _Column:
    count: int = 0
    not_numbers: int = 0
    first_s: float = np.inf
    last_s: float = -np.inf
    least: float = np.inf
    greatest: float = -np.inf
    period_s: float | None = None

    def add(self, time: FloatArray, values: FloatArray) -> None:
        self.not_numbers += int(np.isinf(values).sum())
        is_there = np.isfinite(values)
        if not is_there.any():
            return
        time, values = time[is_there], values[is_there]
        if self.period_s is None and len(time) > 1:  # of the first piece with several
            self.period_s = float(np.median(np.diff(time)))
        self.count += len(time)
        self.first_s, self.last_s = min(self.first_s, float(time[0])), max(self.last_s, float(time[-1]))
        self.least, self.greatest = min(self.least, float(values.min())), max(self.greatest, float(values.max()))


def columns_of(table: ValueTable) -> list[ColumnRow]:
    """Return what each column holds, in the file's order."""
    found = {name: _Column() for name in table.file.units}
    for stream in table.file.streams(list(found), LogReport()):
        for rows in stream:
            for name, values in rows.values.items():
                found[name].add(rows.time - table.start_s, values)
    return [_row(name, table.file.units[name], each) for name, each in found.items()]


def _row(name: str, unit: str, column: _Column) -> ColumnRow:
    spans = column.first_s, column.last_s, column.least, column.greatest
    first, last, least, greatest = (None if column.count == 0 else round(each, 9) for each in spans)
    period = None if column.period_s is None else round(column.period_s, 9)
    return ColumnRow(name, unit, column.count, column.not_numbers, first, last, period, least, greatest)


def signals_of(table: ValueTable, units: Mapping[str, str], columns: list[ColumnRow]) -> list[SignalRow]:
    """Return which of the signals in `units` (name to unit) the table gives, and why not."""
    counts = {each.name: each for each in columns}
    found = []
    for signal, unit in units.items():
        how = table.maps.get(signal)
        name = signal if how is None else how.column
        why = ""
        if name not in counts:
            why = "no such column"
        elif not counts[name].count:
            why = "the column holds no number"
        elif conversion((how and how.unit) or counts[name].unit or unit, unit) is None:
            why = f"its unit {counts[name].unit!r} cannot be converted to {unit!r}"
        found.append(SignalRow(signal, name if name in counts else "", "", not why, [], [], why))
    return found
