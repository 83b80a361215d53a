"""Reads the second logger's CSV and turns its volts into pascal; a bad row costs that row, a bad cell that cell."""

import csv
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from service.core.signals import Vector
from service.logs import LogError
from service.logs.recording import External, Table


@dataclass
class Samples:
    """Samples on the second logger's clock: `t` (N,) [s], increasing; per signal (N,) [Pa], NaN where it has none.

    `bad_rows` had no usable time or too few cells, `told` is the first of them; `bad_cells` held no number or lay
    outside the sensor's table.
    """

    t: Vector
    pressures: dict[str, Vector]
    bad_rows: int
    bad_cells: int
    told: str


@dataclass
class _Rows:
    """Rows while they are read."""

    cells: list[list[float]] = field(default_factory=list)
    bad: int = 0
    told: str = ""

    def reject(self, number: int, reason: str) -> None:
        self.bad += 1
        self.told = self.told or f"line {number}: {reason}"


def read_external(folder: Path, external: External) -> Samples:
    """The samples of a bench recording's second logger.

    Raises:
        LogError: the file is not such a CSV, lacks a column, or has no usable row.
    """
    path = folder / external.file
    rows = _read(path, [external.time_column, *(table.column for table in external.tables.values())])
    if len(rows.cells) < 2:
        raise LogError(f"{path}: no two rows can be read{'; ' + rows.told if rows.told else ''}; record again")
    columns = np.array(rows.cells).T  # (1 + signals, N)
    pressures = {
        signal: _pascal(volts, table)
        for (signal, table), volts in zip(external.tables.items(), columns[1:], strict=True)
    }
    blank = sum(int(np.isnan(pressure).sum()) for pressure in pressures.values())
    return Samples(columns[0], pressures, rows.bad, blank, rows.told)


def _read(path: Path, names: list[str]) -> _Rows:
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    reader = csv.reader(text.replace("\0", "").splitlines())
    header = [name.strip() for name in next(reader, [])]
    absent = [name for name in names if name not in header]
    if absent:
        raise LogError(
            f"{path}: line 1: no column {', '.join(absent)}; recording.toml names it, the file has: "
            f"{', '.join(header)[:80] or 'nothing'}"
        )
    places = [header.index(name) for name in names]
    rows, last = _Rows(), -np.inf
    for row in reader:
        number = reader.line_num
        if len(row) != len(header):
            rows.reject(number, f"{len(row)} cells instead of {len(header)}")
            continue
        cells = [_number(row[place]) for place in places]
        if not cells[0] > last:  # also where it is no number
            rows.reject(number, f"time {row[places[0]][:20]!r} is not after the one before")
            continue
        last = cells[0]
        rows.cells.append(cells)
    return rows


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan


def _pascal(volts: Vector, table: Table) -> Vector:
    """Piecewise linear; NaN outside the table, where the sensor or its wire is broken."""
    return np.interp(volts, table.volts, table.pascal, left=np.nan, right=np.nan)
