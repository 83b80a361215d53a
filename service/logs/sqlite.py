"""python-can's SQLite databases. Rows that cannot be read are left out by halving the range of rows around them.

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
_FAILURES = 2000  # ranges that cannot be read, at most
_MOST_S = 60.0  # that a range may take
Row = tuple[object, ...]
_INSTRUCTIONS = 100_000  # of SQLite's machine, after which the time is looked at


def read_sqlite(source: Source, report: LogReport, channels: Channels) -> Iterator[Batch]:
    """The frames of a database in the order of its rows.

    Raises:
        LogError: it cannot be copied.
    """
    report.unit = "row"
    channel = channels.index(b"")
    with source.plain(report) as path, _openable(path, report) as name:
        if name is None:
            return
        with closing(sqlite3.connect(f"file:{name}?mode=ro&immutable=1", uri=True)) as connection:
            connection.text_factory = bytes  # damaged text is no error of its own
            yield from (
                replace(batch, channel=np.full(len(batch), channel, np.uint8)) for batch in _rows(connection, report)
            )


@contextmanager
def _openable(path: Path, report: LogReport) -> Iterator[str | None]:
    """The name of a file that SQLite opens, None where there is no database in it."""
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
        yield str(path).replace("%", "%25").replace("?", "%3f").replace("#", "%23")
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
            yield copy.name
    except OSError as error:
        raise LogError(f"cannot be copied to read it: {error.strerror}") from error


def _rows(connection: sqlite3.Connection, report: LogReport) -> Iterator[Batch]:
    try:
        last, is_known = _last_row(connection)
    except sqlite3.Error as error:
        report.reject(1, f"the database cannot be read: {error}")
        return
    failures = absent = first_absent = 0
    waiting = [(1, last)]
    while waiting:
        first, last = waiting.pop()
        end = min(last, first + _ROWS - 1)
        waiting += [(end + 1, last)] if end < last else []
        try:
            rows = _read(connection, first, end)
        except (sqlite3.Error, OverflowError) as error:
            failures += 1
            if failures > _FAILURES:
                report.reject(first, f"reading ends here: {error}")
                return
            if first == end:
                report.reject(first, f"a row cannot be read: {error}")
            else:
                middle = (first + end) // 2
                waiting += [(middle + 1, end), (first, middle)]
            continue
        if missing := end - first + 1 - len(rows) if is_known else 0:
            first_absent = first_absent or next(k for k, row in enumerate([*rows, (0,)], first) if row[0] != k)
            absent += missing
        if rows:
            yield from _batch(rows, report)
    _check(connection, report)
    if absent and report.bad:  # else they were deleted
        report.reject(first_absent, f"{absent} rows are not there")
        report.bad += absent - 1


def _last_row(connection: sqlite3.Connection) -> tuple[int, bool]:
    """The highest number of a row, True; what the file has room for, False, where that row cannot be read."""
    size, pages = (int(connection.execute(f"PRAGMA {name}").fetchone()[0]) for name in ("page_size", "page_count"))
    room = size * pages // _LEAST_ROW
    try:
        (found,) = connection.execute("SELECT max(rowid) FROM messages").fetchone()
    except sqlite3.DatabaseError as error:
        if "no such table" in str(error):
            raise
        return room, False
    return min(int(found or 0), room), int(found or 0) <= room


def _read(connection: sqlite3.Connection, first: int, last: int) -> list[Row]:
    began = time.monotonic()
    connection.set_progress_handler(lambda: time.monotonic() - began > _MOST_S, _INSTRUCTIONS)
    return connection.execute(_QUERY, (first, last)).fetchall()


def _check(connection: sqlite3.Connection, report: LogReport) -> None:
    """Rows that are gone without a trace in their table show in SQLite's own check."""
    if report.missing or report.bad:
        return
    try:
        (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.Error as error:
        found = str(error).encode()
    if found != b"ok":
        report.reject(report.frames, f"the database is damaged: {' '.join(found.decode(errors='replace').split())}")


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
