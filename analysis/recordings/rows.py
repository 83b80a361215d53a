"""Reads a logger's CSV with any usual separator and decimal sign; counts bad rows, refuses a clock that was set."""

import csv
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs import LogError

SEPARATORS = (";", "\t", ",")
MOST_BAD = 0.05
FEW = 20
"""More bad rows than these, as a share and a number, are no accidents."""
SET_BACK = 20
SHORTEST_S, LONGEST_S = 5e-4, 60.0  # between two rows of a logger
"""So many rows in a row before the latest time, in order among themselves, are a clock that was set."""


@dataclass
class Rows:
    """The rows of a CSV: `columns` (1 + names, N), time first and increasing, NaN where a cell holds no number.

    `bad` rows had no usable time or another number of cells; `told` is the first of them.
    """

    columns: FloatArray
    bad: int
    told: str


@dataclass
class _Reading:
    """Rows while they are read."""

    cells: list[list[float]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    bad: int = 0
    first: int = 0  # bad line
    told: str = ""

    def reject(self, line: int, reason: str) -> None:
        if not self.bad or line < self.first:
            self.told, self.first = f"line {line}: {reason}", line
        self.bad += 1


def read_rows(path: Path, time_column: str, names: list[str]) -> Rows:
    """The columns `time_column` and `names` of the CSV at `path`.

    Raises:
        LogError: it cannot be read, lacks a column, has no two usable rows, too many bad ones, or a clock that was set.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").replace("\0", "").splitlines()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    wanted = [time_column, *names]
    separator = next((mark for mark in SEPARATORS if mark in (lines or [""])[0]), ",")
    reader = csv.reader(lines, delimiter=separator)
    header = [name.strip() for name in next(reader, [])]
    absent = [name for name in wanted if name not in header]
    if absent:
        raise LogError(
            f"{path}: line 1: no column {', '.join(absent)}; recording.toml names it, the file has: "
            f"{', '.join(header)[:80] or 'nothing'}"
        )
    reading, places = _Reading(), [header.index(name) for name in wanted]
    for row in reader:
        if len(row) != len(header):
            reading.reject(reader.line_num, f"{len(row)} cells instead of {len(header)}")
            continue
        cells = [_number(row[place], separator) for place in places]
        if not np.isfinite(cells[0]):
            reading.reject(reader.line_num, f"time {row[places[0]][:20]!r} is no number")
            continue
        reading.cells.append(cells)
        reading.lines.append(reader.line_num)
    return _in_order(reading, path)


def _in_order(reading: _Reading, path: Path) -> Rows:
    """Only the rows whose time is after all before them; a single time that leaps ahead is left out, not the rest."""
    columns = np.array(reading.cells) if reading.cells else np.empty((0, 1))
    t = columns[:, 0]
    leap = np.zeros(len(t), dtype=bool)
    leap[1:-1] = (t[1:-1] > t[2:]) & (t[2:] > t[:-2])
    latest = np.maximum.accumulate(np.where(leap, -np.inf, t))
    good = ~leap & (np.diff(latest, prepend=-np.inf) > 0)
    run = 0
    for k in np.flatnonzero(~leap & ~good).tolist():
        reading.reject(reading.lines[k], f"time {t[k]:.10g} is not after the one before")
        run = run + 1 if k and not good[k - 1] and t[k] > t[k - 1] else 1
        if run == SET_BACK:
            first = k - SET_BACK + 1
            raise LogError(
                f"{path}: line {reading.lines[first]}: time goes back from {latest[first]:.10g} to {t[first]:.10g} s "
                "and on from there; the logger's clock was set, or two files were joined: split the file there"
            )
    for k in np.flatnonzero(leap).tolist():
        reading.reject(reading.lines[k], f"time {t[k]:.10g} leaps ahead of those after it")
    total = int(good.sum()) + reading.bad
    if good.sum() < 2:
        raise LogError(f"{path}: no two rows can be read{'; ' + reading.told if reading.told else ''}; record again")
    if reading.bad > max(FEW, MOST_BAD * total):
        raise LogError(
            f"{path}: {reading.bad} of {total} rows cannot be used (first: {reading.told}); export it again, with one "
            "header line and a time in seconds that increases"
        )
    period = float(np.median(np.diff(t[good])))
    if not SHORTEST_S <= period <= LONGEST_S:
        raise LogError(
            f"{path}: time goes on by {period:g} from row to row, which is no logger's period in seconds; export it "
            "again with the time in seconds"
        )
    return Rows(columns[good].T, reading.bad, reading.told)


def _number(cell: str, separator: str) -> float:
    """NaN for what is no finite number; a comma is a decimal sign where it does not separate the cells."""
    try:
        value = float(cell if separator == "," else cell.replace(",", "."))
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan
