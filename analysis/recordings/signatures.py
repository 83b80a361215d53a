"""A fault signature matrix as another tool writes it: a CSV whose rows are residuals, and whose columns are faults.

The first line names the faults, the first cell of every other line a residual. A cell is 1, X or any other number than
zero where the residual is sensitive to the fault, and 0, a dot or nothing where it is not. A matrix that lies on its
side, with a row for each fault, is turned.
"""

import csv
import re
from collections.abc import Collection
from pathlib import Path

from faultline.service.core.errors import InputError

NOT_SENSITIVE = ("", "0", ".", "-", "no", "false")
SENSITIVE = ("1", "x", "yes", "true")


def read_signatures(path: Path, signals: Collection[str]) -> dict[str, tuple[str, ...]]:
    """The faults that each residual, one of the `signals` of a log, is sensitive to.

    Raises:
        InputError: the file cannot be read, is no matrix, or has a cell, a residual or a fault that cannot be used.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read: {error}; give a CSV in UTF-8") from error
    rows = [
        [cell.strip() for cell in row]
        for row in csv.reader(lines, delimiter=max(";\t,", key=lines[0].count) if lines else ",")
        if any(row)
    ]
    if len(rows) < 2 or any(len(row) != len(rows[0]) for row in rows) or len(rows[0]) < 2:
        raise InputError(f"{path}: no matrix: give a line of faults, and a line of as many cells for each residual")
    if not any(row[0] in signals for row in rows[1:]) and any(name in signals for name in rows[0][1:]):
        rows = [list(row) for row in zip(*rows, strict=True)]
    found: dict[str, tuple[str, ...]] = {}
    for row in rows[1:]:
        if row[0] not in signals:
            raise InputError(
                f"{path}: residual {row[0]!r}: the log has no such signal; it has {', '.join(signals)}: rename it here"
            )
        faults = tuple(name for name, cell in zip(rows[0][1:], row[1:], strict=True) if _is_sensitive(cell, path, row))
        if not faults or row[0] in found:
            raise InputError(
                f"{path}: residual {row[0]}: {'is there twice' if faults else 'no fault moves it'}; remove it"
            )
        found[row[0]] = faults
    return found


def _is_sensitive(cell: str, path: Path, row: list[str]) -> bool:
    if cell.lower() in NOT_SENSITIVE:
        return False
    if cell.lower() in SENSITIVE:
        return True
    try:
        return float(cell.replace(",", ".")) != 0.0
    except ValueError as error:
        raise InputError(f"{path}: residual {row[0]}: cell {cell!r} is neither sensitive (1) nor not (0)") from error


def name_of(fault: str) -> str:
    """A fault's name as a model can have it.

    >>> name_of("pump worn"), name_of("f_1"), name_of("2 leaks")
    ('f_pump_worn', 'f_1', 'f_2_leaks')
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", fault).strip("_")
    return name if re.match(r"f_?[A-Z0-9_]", name) else f"f_{name}"
