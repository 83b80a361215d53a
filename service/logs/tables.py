"""Reads python-can's own logs: its CSV, and its SQLite database."""

import re
import sqlite3
import struct
from base64 import b64decode
from collections.abc import Iterator

from faultline.service.logs.report import Frame, LogReport, OnChannel, read_lines, shown

_ROW = re.compile(
    rb"(-?\d+(?:\.\d*)?(?:e[-+]?\d+)?),(?:0x)?([0-9a-f]+),([01]),([01]),([01]),(\d+),([\w+/=]*)", re.IGNORECASE
)
_HEADER = re.compile(rb"timestamp[a-z_,]*")

_MAGIC = b"SQLite format 3\0"
_PAGE_SIZE, _COUNTS = struct.Struct(">16xH"), struct.Struct(">24xLL60xL")  # change counter, pages, counter at that
_READ_VERSIONS = slice(18, 20)
_FILL = 20  # times longer than it is, a database that is cut off is filled up with zeros
_ROLLBACK = b"\1\1"  # as write-ahead logging cannot be opened in memory
_QUERY = "SELECT rowid, ts, arbitration_id, extended, remote, error, dlc, data FROM messages"


def read_csv(content: bytes, report: LogReport) -> Iterator[OnChannel]:
    """The data frames of a CSV log in the file's order."""

    def take(line: bytes) -> OnChannel | None:
        if not line or _HEADER.fullmatch(line):
            return None
        match = _ROW.fullmatch(line)
        if match is None:
            raise ValueError(f"no row of a log: {shown(line)}")
        stamp, identifier, extended, remote, error, length, text = match.groups()
        if error == b"1":
            report.errors += 1
        elif remote == b"1":
            report.remote += 1
        else:
            data = b64decode(text, validate=True)
            if len(data) != int(length):
                raise ValueError(f"says {int(length)} bytes and has {len(data)}: {shown(line)}")
            return b"", Frame(float(stamp), int(identifier, 16), extended == b"1", data)
        return None

    return read_lines(content, report, take)


def read_sqlite(content: bytes, report: LogReport) -> Iterator[OnChannel]:
    """The data frames of a database in the order of its rows. It is read in memory: the file is never written."""
    report.unit = "row"
    if not content.startswith(_MAGIC) or len(content) < _COUNTS.size:
        report.reject(1, "it is no SQLite database")
        return
    (stored,) = _PAGE_SIZE.unpack_from(content)
    size = 65536 if stored == 1 else max(stored, 1)
    changes, pages, counted_at = _COUNTS.unpack_from(content)
    whole = size * pages if changes == counted_at else 0
    if whole > len(content):
        report.missing = f"its header says {whole} bytes, it has {len(content)}"
    content = b"".join((content[: _READ_VERSIONS.start], _ROLLBACK, content[_READ_VERSIONS.stop :]))
    if len(content) < whole <= _FILL * len(content):  # SQLite opens none that is shorter than its header says
        content = content[: len(content) // size * size].ljust(whole, b"\0")
    row = 0
    connection = sqlite3.connect(":memory:")
    try:
        connection.text_factory = bytes  # damaged text is no error of its own
        connection.deserialize(content)
        for row, *values in connection.execute(_QUERY):
            if (frame := _frame(row, values, report)) is not None:
                yield b"", frame
        if not report.missing and (found := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != b"ok":
            report.reject(row, f"the database is damaged: {' '.join(found.decode(errors='replace').split())}")
    except (sqlite3.Error, OverflowError) as error:
        report.reject(row + 1, f"reading ends here: {error}")
    finally:
        connection.close()


def _frame(row: int, values: list[object], report: LogReport) -> Frame | None:
    match values:
        case [_, _, _, _, error, _, _] if error == 1:
            report.errors += 1
        case [_, _, _, remote, _, _, _] if remote == 1:
            report.remote += 1
        case [float(t), int(can_id), (0 | 1) as extended, 0, 0, int(length), bytes(data)] if len(data) == length:
            return Frame(t, can_id, bool(extended), data)
        case _:
            report.reject(row, "no frame, or another length than it says")
    return None
