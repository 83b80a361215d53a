"""python-can's SQLite databases.

Rows that SQLite does not find in a damaged one are taken from its leaf pages (`logs.sqlite_pages`); those that are gone
are counted, as rows are numbered without a gap.

The file itself is never written. A database that is cut off, or whose logger used a write-ahead log, is copied first,
as SQLite opens neither without changing it.
"""

import shutil
import sqlite3
import struct
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np

from faultline.service.logs.batch import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    EXTENDED_TOP,
    FD,
    FD_BYTES,
    REMOTE,
    TOP,
    Batch,
    Bytes,
)
from faultline.service.logs.channels import Channels
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogError, LogReport
from faultline.service.logs.sqlite_pages import LeafPages, Row

SQLITE_MAGIC = b"SQLite format 3\0"
_PAGE_SIZE, _COUNTS = struct.Struct(">16xH"), struct.Struct(">24xLL60xL")  # change counter, pages, counter at that
_VERSIONS = 18  # of writing and reading: byte of the header
_ROLLBACK, _WRITE_AHEAD = b"\1\1", 2
_FILL = 20  # times longer than it is, a database that is cut off is filled up with zeros
_QUERY = (
    "SELECT rowid, ts, arbitration_id, extended, remote, error, dlc, data FROM messages "
    "WHERE rowid BETWEEN ? AND ? ORDER BY rowid"
)
_ROWS = 8192  # read at once
_LEAST_ROW = 8  # bytes
_MOST_S = 60.0  # that a range may take
_INSTRUCTIONS = 100_000  # of SQLite's machine, after which the time is looked at


def read_sqlite(source: Source, report: LogReport, channels: Channels) -> Iterator[Batch]:
    """The frames of a database in the order of its rows.

    Raises:
        LogError: it cannot be copied.
    """
    report.unit = "row"
    channel = channels.index(b"")
    with source.plain(report) as path, _openable(path, report) as file:
        if file is None:
            return
        name = str(file).replace("%", "%25").replace("?", "%3f").replace("#", "%23")
        with closing(sqlite3.connect(f"file:{name}?mode=ro&immutable=1", uri=True)) as connection:
            connection.text_factory = bytes  # damaged text is no error of its own
            yield from (
                replace(batch, channel=np.full(len(batch), channel, np.uint8))
                for batch in _rows(connection, file, report)
            )


@contextmanager
def _openable(path: Path, report: LogReport) -> Iterator[Path | None]:
    """The path of a file that SQLite opens, None where there is no database in it."""
    length = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_COUNTS.size)
    if not head.startswith(SQLITE_MAGIC) or len(head) < _COUNTS.size:
        report.reject(1, "it is no SQLite database")
        yield None
        return
    (stored,) = _PAGE_SIZE.unpack_from(head)
    size = 65536 if stored == 1 else max(stored, 1)
    changes, pages, counted_at = _COUNTS.unpack_from(head)
    whole = size * pages if changes == counted_at else 0
    if whole > length:
        report.missing = f"its header says {whole} bytes, it has {length}"
    is_short = length < whole <= _FILL * length
    if not is_short and _WRITE_AHEAD not in head[_VERSIONS : _VERSIONS + 2]:
        yield path
        return
    try:
        with NamedTemporaryFile(prefix="faultline-") as copy:
            with path.open("rb") as file:
                shutil.copyfileobj(file, copy)
            if is_short:  # zeros take no room
                copy.truncate(length // size * size)
                copy.truncate(whole)
            copy.seek(_VERSIONS)
            copy.write(_ROLLBACK)
            copy.flush()
            yield Path(copy.name)
    except OSError as error:
        raise LogError(f"cannot be copied to read it: {error.strerror}") from error


def _rows(connection: sqlite3.Connection, path: Path, report: LogReport) -> Iterator[Batch]:
    """The frames of all rows. What SQLite does not find in a damaged database is taken from its leaf pages."""
    try:
        table = _Table(connection, path)
    except sqlite3.Error as error:
        report.reject(1, f"the database cannot be read: {error}")
        return
    there = first_absent = 0
    for first, last in table.ranges():
        rows = table.rows(first, last)
        if len(rows) < last - first + 1 and not first_absent:
            first_absent = next(k for k, row in enumerate([*rows, (0,)], first) if row[0] != k)
        there += len(rows)
        if rows:
            yield from _batch(rows, report)
    _report_damage(report, table, there, first_absent)


class _Table:
    """The rows of a database, numbered from 1.

    `known` is the highest number of a row, 0 where nobody knows one; rows may be gone behind it if `is_open`.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        """Raises `sqlite3.Error` where there is no such table."""
        self._connection, self._path = connection, path
        size, pages = (int(connection.execute(f"PRAGMA {name}").fetchone()[0]) for name in ("page_size", "page_count"))
        self._size, self._error = size, ""
        room = size * pages // _LEAST_ROW
        try:
            (found,) = connection.execute("SELECT max(rowid) FROM messages").fetchone()
            self.known = int(found or 0)
        except sqlite3.DatabaseError as error:
            if "no such table" in str(error):
                raise
            self.known, self._error = room + 1, str(error)
        self.is_open = self.known > room
        if self.is_open:
            counted = _counted(connection, room)
            self.known, self.is_open = counted or self._leaves.largest, not counted
        self._last = self.known or (room if self.is_open else 0)

    def ranges(self) -> Iterator[tuple[int, int]]:
        """The first and the last number of some rows after the other."""
        first = 1
        while first <= self._last:
            yield first, (last := min(self._last, first + _ROWS - 1))
            first = last + 1
            if first > self._last and self.why:
                self._last = self.known = max(self.known, self._leaves.largest)

    def rows(self, first: int, last: int) -> list[Row]:
        """The rows with these numbers that can be read."""
        try:
            rows = _read(self._connection, first, last)
        except (sqlite3.Error, OverflowError) as error:
            self._error, rows = self._error or str(error), []
        if len(rows) <= last - first and self.why:  # else the others were deleted
            found = self._leaves.rows(first, last)
            return found if len(found) > len(rows) else rows
        return rows

    @property
    def why(self) -> str:
        """Why SQLite takes the database for damaged; empty where it does not."""
        return self._error or self._checked

    @cached_property
    def _checked(self) -> str:
        """What its own check says."""
        try:
            (found,) = self._connection.execute("PRAGMA quick_check(1)").fetchone()
        except sqlite3.Error as error:
            return str(error)
        return "" if found == b"ok" else str(found.decode(errors="replace"))

    @cached_property
    def _leaves(self) -> LeafPages:
        """The leaf pages: looked for once something is wrong."""
        return LeafPages(self._path, self._size)


def _counted(connection: sqlite3.Connection, room: int) -> int:
    """The highest number that a row ever had, of a table that counts them; else 0."""
    try:
        (found,) = connection.execute("SELECT max(seq) FROM sqlite_sequence WHERE name = 'messages'").fetchone()
    except sqlite3.Error:  # nearly all have no such table
        return 0
    return found if isinstance(found, int) and 0 < found <= room else 0


def _report_damage(report: LogReport, table: _Table, there: int, first_absent: int) -> None:
    """Say what is damaged, and how many rows are not there, or that nobody knows; a whole one has deleted rows."""
    why, known = " ".join(table.why.split()), table.known
    if not (why or report.bad or report.missing):
        return
    absent = max(0, known - there) if known else 0
    words = [f"{absent} rows are not there"] if absent else []
    if table.is_open or report.missing:
        words.append(f"how many rows are gone{f' behind row {known}' if known else ''} is not known")
    words += [f"the database is damaged: {why}"] if why else []
    if words:
        report.reject_first(first_absent if absent else known + 1, "; ".join(words), max(absent, 1))


def _read(connection: sqlite3.Connection, first: int, last: int) -> list[Row]:
    began = time.monotonic()
    connection.set_progress_handler(lambda: time.monotonic() - began > _MOST_S, _INSTRUCTIONS)
    return connection.execute(_QUERY, (first, last)).fetchall()


def _batch(rows: list[Row], report: LogReport) -> Iterator[Batch]:
    """The frames among rows."""
    columns = [*zip(*rows, strict=True)]
    if not _are_frames(columns):
        good = [row for row in rows if _is_frame(row)]
        for row in rows if len(good) < len(rows) else []:
            if not _is_frame(row):
                report.reject(int(str(row[0])), "no frame, or another length than it says")
        if not good:
            return
        columns = [*zip(*good, strict=True)]
    _, times, identifiers, extended, remote, error, lengths, data = columns
    length = np.array(lengths, dtype=np.uint8)
    flags = np.array(extended, dtype=np.uint8) * EXTENDED | np.array(remote, dtype=np.uint8) * REMOTE
    flags |= np.array(error, dtype=np.uint8) * ERROR
    flags[length > CLASSIC_BYTES] |= FD
    channel, identifier = np.zeros(len(times), np.uint8), np.array(identifiers, dtype=np.uint32)
    yield Batch(np.array(times, dtype=np.float64), channel, identifier, flags, length, _data(data))


def _are_frames(columns: list[tuple[Any, ...]]) -> bool:
    """True if all rows are data frames for certain, seen column by column as nearly always."""
    kinds = [set(map(type, column)) for column in columns[1:]]
    if kinds != [{float}, *[{int}] * 5, {bytes}]:
        return False
    _, times, identifiers, extended, remote, error, lengths, data = columns
    return (
        not any(remote)
        and not any(error)
        and set(extended) <= {0, 1}
        and min(identifiers) >= 0
        and max(identifiers) <= (TOP if 0 in extended else EXTENDED_TOP)
        and bool(np.isfinite(times).all())
        and [*map(len, data)] == [*lengths]
        and max(lengths) <= FD_BYTES
    )


def _data(data: tuple[bytes | None, ...]) -> Bytes:
    width = CLASSIC_BYTES if all(each is None or len(each) <= CLASSIC_BYTES for each in data) else FD_BYTES
    raw = b"".join([(each or b"").ljust(width, b"\0") for each in data])
    return np.frombuffer(raw, np.uint8).reshape(len(data), width)


def _is_frame(row: Row) -> bool:
    match row:
        case [_, float(t), int(can_id), (0 | 1) as extended, (0 | 1) as remote, (0 | 1) as error, int(length), data]:
            if not (t - t == 0.0 and 0 <= can_id <= (EXTENDED_TOP if extended else TOP) and 0 <= length <= FD_BYTES):
                return False
            if remote or error:
                return data is None or (isinstance(data, bytes) and len(data) <= length)
            return isinstance(data, bytes) and len(data) == length
    return False
