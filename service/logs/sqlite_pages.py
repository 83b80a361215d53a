"""Rows of an SQLite database from its leaf pages alone, where the tree above them is damaged.

A leaf page of a table holds cells in order of their row numbers: size, number and record. python-can's rows are
numbered without a gap, so cell k of a page has the number of the first one plus k; a cell that has not is damaged.
Source: SQLite, "Database File Format", sections 1.6 and 2.1.
"""

import struct
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from itertools import islice, takewhile
from pathlib import Path
from typing import NamedTuple

Row = tuple[object, ...]
"""Row number, time, identifier, whether extended, remote, error, length, data."""

_TABLE_LEAF = 0x0D
_LEAF = struct.Struct(">B2xH3x")  # kind, number of cells
_COLUMNS = 7
_NO_ROW = -1
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}  # bytes, by serial type
_REAL, _ZERO, _ONE, _BLOB = 7, 8, 9, 12


class _Leaf(NamedTuple):
    """The row numbers of a page, and where it is."""

    first: int
    last: int
    at: int


class LeafPages:
    """The leaf pages of a file that hold rows of frames; `largest` is the highest row number in them, 0 where none."""

    def __init__(self, path: Path, page_size: int) -> None:
        self._path, self._size = path, page_size
        room = path.stat().st_size // 8  # no row is smaller
        self._leaves = sorted(each for each in self._found() if each.last <= room)
        self.largest = max((each.last for each in self._leaves), default=0)

    def rows(self, first: int, last: int) -> list[Row]:
        """Return the rows with these numbers that can be read, in order."""
        found: dict[int, Row] = {}
        with self._path.open("rb") as file:
            begin = max(0, bisect_right(self._leaves, first, key=lambda leaf: leaf.first) - 1)
            for leaf in takewhile(lambda leaf: leaf.first <= last, islice(self._leaves, begin, None)):
                file.seek(leaf.at)
                page = file.read(self._size)
                for number in range(max(first, leaf.first), min(last, leaf.last) + 1):
                    row = _row(page, number - leaf.first)
                    if row is not None and row[0] == number:
                        found[number] = row
        return [found[number] for number in sorted(found)]

    def _found(self) -> Iterator[_Leaf]:
        with self._path.open("rb") as file:
            at = 0
            while page := file.read(self._size):
                if page[0] == _TABLE_LEAF and len(page) >= _LEAF.size:
                    _, count = _LEAF.unpack_from(page)
                    begin = _first_number(page, count)
                    if begin > 0:
                        yield _Leaf(begin, begin + count - 1, at)
                at += self._size


def _first_number(page: bytes, count: int) -> int:
    """The number of the first row as most of three cells have it; `_NO_ROW` where they do not agree."""
    if not 0 < count <= len(page) // 8:
        return _NO_ROW
    rows = {k: _row(page, k) for k in (0, count // 2, count - 1)}
    begins = Counter(int(str(row[0])) - k for k, row in rows.items() if row is not None)
    (begin, votes), *_ = begins.most_common(1) or [(_NO_ROW, 0)]
    return begin if 2 * votes >= len(rows) else _NO_ROW


def _row(page: bytes, k: int) -> Row | None:
    """The row of a cell; None where it is none of python-can's."""
    try:
        (at,) = struct.unpack_from(">H", page, _LEAF.size + 2 * k)
        size, at = _varint(page, at)
        number, at = _varint(page, at)
        time, *others = _record(page[at : at + size])
        return (number, float(time) if isinstance(time, int) else time, *others)  # whole numbers are stored as such
    except (IndexError, ValueError, struct.error):
        return None


def _record(raw: bytes) -> list[object]:
    """The values of a record; raises `ValueError` where they are not as many as they should be."""
    head, at = _varint(raw, 0)
    kinds = []
    while at < head:
        kind, at = _varint(raw, at)
        kinds.append(kind)
    values = []
    for kind in kinds:
        value, at = _value(raw, at, kind)
        values.append(value)
    if len(values) != _COLUMNS or at != len(raw):
        raise ValueError("another record")
    return values


def _value(raw: bytes, at: int, kind: int) -> tuple[object, int]:
    """A value of this serial type, and where the next one begins."""
    if kind in (0, _ZERO, _ONE):
        return (None, 0, 1)[(0, _ZERO, _ONE).index(kind)], at
    if kind == _REAL:
        return struct.unpack_from(">d", raw, at)[0], at + 8
    if kind in _INTEGERS:
        end = at + _INTEGERS[kind]
        return int.from_bytes(raw[at:end], "big", signed=True), end
    if kind < _BLOB:
        raise ValueError("a reserved type")
    end = at + (kind - _BLOB) // 2
    return raw[at:end], end


def _varint(raw: bytes, at: int) -> tuple[int, int]:
    """A number of one to nine bytes, and where the next one begins."""
    number = 0
    for k in range(8):
        number = number << 7 | raw[at + k] & 0x7F
        if raw[at + k] < 0x80:
            return number, at + k + 1
    return number << 8 | raw[at + 8], at + 9
