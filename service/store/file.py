"""The store's file: records of what was told, and what is remembered, in SQLite.

A commit that has returned survives a power cut (`journal_mode=WAL`, `synchronous=FULL`; with NORMAL all that was
acknowledged since the last checkpoint is lost). One process has it, exclusively: others ask the service.
"""

import os
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple, get_args

import msgspec

from faultline.service.core.errors import InputError

VERSION = 2  # 1 had no table `kept`

About = Literal["event", "health", "fault", "context"]
KEPT: dict[About, int] = {"event": 20_000, "health": 5_000, "fault": 20_000, "context": 5_000}
"""The latest so many are kept. Each kind has its own number: a loose plug must not push out faults."""
PRUNED = 256  # records between two looks whether there are too many
ASIDE = 3  # damaged files that are left
ENDLESS = 2**53  # larger than any number of a record
NOTHING: Mapping[str, bytes | None] = MappingProxyType({})
LOCKED_S = 5.0  # who looks at the file with a tool of his own has so long

_TABLES = """
CREATE TABLE record (
    seq INTEGER PRIMARY KEY,
    about TEXT NOT NULL,
    line BLOB NOT NULL
) STRICT;
CREATE INDEX record_about ON record (about, seq);
"""
_KEPT = """
CREATE TABLE kept (
    name TEXT PRIMARY KEY,
    value BLOB NOT NULL
) STRICT, WITHOUT ROWID;
"""

_NO_DAMAGE = (
    *(sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR),
    *(sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM, sqlite3.SQLITE_AUTH, sqlite3.SQLITE_NOMEM),
)
"""What is wrong is not the file, but what it is on, or who else has it: the last byte of SQLite's codes."""


class StoreError(InputError):
    """A store that cannot be opened; `is_locked` if another process has it, which may be over in a moment."""

    is_locked = False


class Record(NamedTuple):
    """One line of JSON that is told, newline included, with its number and what it is about."""

    seq: int
    about: About
    line: bytes


class StoreFile:
    """An open store; of one thread at a time.

    Of what is in it, `last` is the number of the latest record (0: none), `earlier` are the latest `remembered` ones,
    oldest first, `health` is the latest on health, and `kept` is what is remembered, by name. `aside` is where a
    damaged one was put, None where it was whole. Rows that are no records, or no names and values, stay where they are
    and are not read: `senseless` says that there are some.

    Raises:
        StoreError: it cannot be opened or made, or another process has it, or it is another program's or a newer one's.
    """

    def __init__(self, path: Path, remembered: int = 0) -> None:
        self.path, self._remembered = path, remembered
        self.last, self.earlier = 0, list[Record]()
        self.health: Record | None = None
        self.kept: dict[str, bytes] = {}
        self.aside: Path | None = None
        self.senseless = False
        self._size = 0  # of the file, when it was looked at last [bytes]
        self._since_pruned = PRUNED  # however short a run is
        self._db: sqlite3.Connection
        self._begin()

    def append(self, records: Sequence[Record], kept: Mapping[str, bytes | None] = NOTHING) -> None:
        """Adds the records, and sets or erases (None) what is `kept`, all or nothing; on return it is on the disk.

        A record that is there already stays as it is.

        Raises:
            sqlite3.Error: nothing was added, or all; `is_damage` says whether it is the file that is broken.
        """
        self._db.execute("BEGIN IMMEDIATE")
        try:
            self._db.executemany("INSERT OR IGNORE INTO record VALUES (?, ?, ?)", records)
            for name, value in kept.items():
                if value is None:
                    self._db.execute("DELETE FROM kept WHERE name = ?", (name,))
                else:
                    self._db.execute("INSERT OR REPLACE INTO kept VALUES (?, ?)", (name, value))
            if self._since_pruned >= PRUNED:
                self._prune()
            self._db.execute("COMMIT")
        except sqlite3.Error:
            with suppress(sqlite3.Error):  # SQLite may have rolled back by itself
                self._db.execute("ROLLBACK")
            raise
        self._since_pruned = self._since_pruned + len(records) if self._since_pruned < PRUNED else 0

    def again(self) -> None:
        """Opens it once more; what is damaged is put aside and a new one begun. Raises as the constructor."""
        self.close()
        self.aside = None
        self._begin()

    def is_gone(self) -> bool:
        """True if the file or its log was removed, replaced or cut off since it was opened; raises OSError."""
        if any(was is not None and _identity(path) != was for path, was in self._opened.items()):
            return True
        before, self._size = self._size, self.path.stat().st_size
        return self._size < before

    def restore(self) -> Path | None:
        """Writes all that is in it to its place anew; where what was found there instead was put, None for nothing.

        Raises:
            sqlite3.Error, OSError, StoreError: it cannot be written there.
        """
        copy, aside = self.path.with_name(f".{self.path.name}.new"), None
        copy.unlink(missing_ok=True)
        self._db.execute("VACUUM INTO ?", (str(copy),))
        for path in (copy, copy.parent):
            descriptor = os.open(path, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        self.close()
        log = _log(self.path)
        if _identity(log) == self._opened[log]:  # ours, and not of what was put there: SQLite would join them
            log.unlink(missing_ok=True)
        if self.path.exists():
            aside = _put_aside(self.path)
        log.unlink(missing_ok=True)
        copy.rename(self.path)
        self._begin()
        return aside

    def close(self) -> None:
        """Ends it; what was added stays whether it is called or not."""
        with suppress(sqlite3.Error):
            self._db.close()

    def before(self, seq: int | None, count: int) -> list[Record]:
        """The latest records, before number `seq` where that is given; oldest first."""
        rows = self._db.execute(
            "SELECT seq, about, line FROM record WHERE seq < ? ORDER BY seq DESC",
            (ENDLESS if seq is None else seq,),
        )
        return self._records(rows, count)[::-1]

    def after(self, seq: int, count: int) -> list[Record]:
        """The records after number `seq`, oldest first."""
        rows = self._db.execute("SELECT seq, about, line FROM record WHERE seq > ? ORDER BY seq", (seq,))
        return self._records(rows, count)

    def _records(self, rows: Iterable[tuple[object, ...]], count: int) -> list[Record]:
        """The first so many of the rows that are records."""
        found: list[Record] = []
        for row in rows if count else ():
            record = _record(row)
            if record is None:
                self.senseless = True
            else:
                found.append(record)
                if len(found) == count:
                    break
        return found

    def _prune(self) -> None:
        for about in get_args(About):
            self._db.execute(
                "DELETE FROM record WHERE about = ?1 AND seq <= "
                "(SELECT seq FROM record WHERE about = ?1 ORDER BY seq DESC LIMIT 1 OFFSET ?2)",
                (about, KEPT[about]),
            )

    def _begin(self) -> None:
        try:
            try:
                self._read()
            except sqlite3.Error as error:
                if not is_damage(error):
                    raise
                self.aside = _put_aside(self.path)
                self._read()
        except (OSError, sqlite3.Error) as error:
            is_locked = isinstance(error, sqlite3.Error) and _code(error) in (
                sqlite3.SQLITE_BUSY,
                sqlite3.SQLITE_LOCKED,
            )
            reason = "another process has it" if is_locked else str(error)
            before = f"was damaged and is now {self.aside}; a new one " if self.aside else ""
            failed = StoreError(f"{self.path}: {before}cannot be used: {reason}; mend that or give another path")
            failed.is_locked = is_locked
            raise failed from error
        self._opened = {path: _identity(path) for path in (self.path, _log(self.path))}
        self._size = self.path.stat().st_size

    def _read(self) -> None:
        """Opens it and reads what is in it; an error in that is damage that the check did not see."""
        self._db = _open(self.path)
        try:
            self.earlier = self.before(None, self._remembered)
            rows = self._db.execute("SELECT name, value FROM kept").fetchall()
            self.kept = {name: value for name, value in rows if isinstance(name, str) and isinstance(value, bytes)}
            self.senseless |= len(self.kept) < len(rows)
            greatest = self._db.execute("SELECT coalesce(max(seq), 0) FROM record WHERE seq < ?", (ENDLESS,))
            self.last = greatest.fetchone()[0]
            latest = self._db.execute("SELECT seq, about, line FROM record WHERE about = 'health' ORDER BY seq DESC")
            self.health = next(iter(self._records(latest, 1)), None)
        except sqlite3.Error:
            self.close()
            raise


def _record(row: tuple[object, ...]) -> Record | None:
    """The record in a row, None where it makes no sense: somebody else has written there."""
    match row:
        case (int(seq), ("event" | "health" | "fault" | "context") as about, bytes(line)) if 0 < seq < ENDLESS:
            try:
                msgspec.json.decode(line, type=dict[str, msgspec.Raw])
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                return None
            return Record(seq, about, line) if line.endswith(b"\n") and line.count(b"\n") == 1 else None
        case _:
            return None


def is_damage(error: sqlite3.Error) -> bool:
    """Whether it is the file that is broken."""
    return _code(error) not in _NO_DAMAGE


def _code(error: sqlite3.Error) -> int:
    code: int = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
    return code & 0xFF


def _log(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and inode of a file; None where there is none."""
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return found.st_dev, found.st_ino


def _open(path: Path) -> sqlite3.Connection:
    """The database, whole and ours alone; raises sqlite3.Error where it is damaged or cannot be used."""
    db = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=LOCKED_S)
    try:
        db.execute("PRAGMA locking_mode=EXCLUSIVE")  # also keeps the log's index in memory, not in a file
        db.execute("PRAGMA temp_store=MEMORY")
        is_new = _is_new(db, path)
        db.execute("PRAGMA journal_mode=WAL")
        db.execute("PRAGMA synchronous=FULL")
        if is_new:
            db.executescript(f"BEGIN EXCLUSIVE; {_TABLES} {_KEPT} PRAGMA user_version={VERSION}; COMMIT;")
        elif db.execute("PRAGMA user_version").fetchone()[0] < VERSION:
            db.executescript(f"BEGIN EXCLUSIVE; {_KEPT} PRAGMA user_version={VERSION}; COMMIT;")
        db.execute("BEGIN EXCLUSIVE")  # from now on it is ours
        db.execute("COMMIT")
    except BaseException:
        db.close()
        raise
    return db


def _is_new(db: sqlite3.Connection, path: Path) -> bool:
    """Whether nothing is in it; what is there must be whole, and of this faultline or an older one. Changes nothing."""
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if version > VERSION:
        raise StoreError(
            f"{path}: is of a newer faultline (version {version}, this one knows {VERSION}); "
            "nothing was changed: update, or give another path"
        )
    found = db.execute("PRAGMA quick_check(1)").fetchone()[0]
    if found != "ok":
        raise sqlite3.DatabaseError(found)
    if version == 0 and db.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
        raise StoreError(f"{path}: is another program's database; nothing was changed: give another path")
    return bool(version == 0)


def _put_aside(path: Path) -> Path:
    """Renames a damaged store and its log; of older ones the latest are left."""
    stem = f"{path.name}.damaged-"
    numbers = sorted(
        int(tail) for each in path.parent.glob(f"{stem}*") if (tail := each.name.removeprefix(stem)).isdecimal()
    )
    for number in numbers[: -(ASIDE - 1)]:
        for suffix in ("", "-wal"):
            path.with_name(f"{stem}{number}{suffix}").unlink(missing_ok=True)
    aside = path.with_name(f"{stem}{numbers[-1] + 1 if numbers else 1}")
    for suffix in ("", "-wal"):
        with suppress(FileNotFoundError):
            path.with_name(f"{path.name}{suffix}").rename(aside.with_name(f"{aside.name}{suffix}"))
    return aside
