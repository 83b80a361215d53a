"""Write-ahead journal: records are published once they are on the disk, which has a thread of its own.

A disk that is full, slow or broken keeps no alarm back: what it has not taken within `PATIENCE_S` is told all the
same, as is that it was not kept; the disk is tried again, with all of it. What is remembered besides goes to the disk
with the record that it was put with, or with a later one; all of it is in memory too, and is written anew where a store
had to be begun anew.
"""

import os
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from faultline.service.core.records.health import Condition
from faultline.service.store.file import NOTHING, Record, StoreFile, is_damage

OPENED_S = 10.0
"""So long the start waits for a disk that hangs, or a store that is locked; then it goes on without."""
AGAIN_S, LONGEST_S = 0.5, 60.0
"""A store that could not be opened is tried again after so long; twice as long each time, and `LONGEST_S` at most."""
LOOK_S = 5.0
"""So often it is looked whether the store's file is there still."""
PATIENCE_S = 2.0
"""So long a record waits for the disk before it is told without."""
RETRY_S = 5.0
ASKED = 100  # questions that wait for the disk
PENDING = 10_000  # records that wait for a disk that does not take them; then the oldest are given up


class Page(NamedTuple):
    """Page of records: those after a number, or the latest before one (before None: of all)."""

    most: int
    after: int | None = None
    before: int | None = None

    def of(self, file: StoreFile) -> list[Record]:
        """Return the records of a store; raises sqlite3.Error."""
        if self.after is not None:
            return file.after(self.after, self.most)
        return file.before(self.before, self.most)


class _Asked(NamedTuple):
    page: Page
    then: Callable[[list[Record] | None], None]


class Journal:
    """Journal of records in the order in which they were put. `path` None keeps nothing: all is published at once.

    Of earlier runs, `last` is the number of the latest record, `health` the latest on health, and `earlier` are the
    latest `remembered` of all. `kept` is what is remembered now, by name: of the thread that puts. A store that cannot
    be opened is tried again, and `take_up` says when that has come to something.
    """

    def __init__(
        self,
        path: Path | None,
        say: Callable[[str], None],
        remembered: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path, self._say, self._clock = path, say, clock
        self.last, self.earlier = 0, list[Record]()
        self.health: Record | None = None
        self.kept: dict[str, bytes] = {}
        self._dirty: dict[str, bytes | None] = {}  # what the disk has not taken of that
        self._asked: deque[_Asked] = deque()
        self._answers: deque[tuple[_Asked, list[Record] | None]] = deque()
        self._waiting: deque[tuple[float, Record]] = deque()  # not told yet, and since when
        self._pending: deque[Record] = deque()  # not on the disk yet
        self._kept = 0  # number up to which all is on the disk, or given up
        self._given_up = 0
        self._failing = self._late = self._ended = False
        self._reset = self._removed = False
        self._starting = True
        self._file: StoreFile | None = None  # opened, and not taken up yet
        self._opener: threading.Thread | None = None
        self._changed = threading.Condition()
        # Never closed: a disk that hangs may still wake us.
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread: threading.Thread | None = None
        if path is not None:
            self._begin(path, remembered)

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self.finish(0.0)

    def fileno(self) -> int:
        """Return the descriptor, readable when there may be something to take."""
        return self._wake

    @property
    def fresh(self) -> bool:
        """Return True if its thread is alive; a disk that hangs or fails is a condition and no defect."""
        return self._thread is None or self._ended or self._thread.is_alive()

    @property
    def is_open(self) -> bool:
        """True if there is a store that takes what is put, or none is wanted."""
        return self.path is None or self._thread is not None

    def put(self, *records: Record, kept: Mapping[str, bytes | None] = NOTHING) -> None:
        """Take records to store and then to publish, and rows to set, or to erase (None), from then on."""
        now = self._clock()
        with self._changed:
            for name, value in kept.items():
                if value is None:
                    self.kept.pop(name, None)
                else:
                    self.kept[name] = value
            self._waiting.extend((now, record) for record in records)
            if self._thread is None:
                return
            self._dirty.update(kept)
            self._pending.extend(records)
            while len(self._pending) > PENDING:
                self._kept = self._pending.popleft().seq
                self._given_up += 1
            self._changed.notify()

    def remember(self, kept: Mapping[str, bytes | None]) -> None:
        """Take rows to set, or to erase (None), without a record."""
        self.put(kept=kept)

    @property
    def kept_up_to(self) -> int:
        """Return the number up to which all that was put is on the disk, or was given up."""
        return max(self._kept, self.last)

    def has(self, seq: int) -> bool:
        """Return True if the record of that number, which was taken, is on the disk."""
        with self._changed:
            return self._thread is not None and not self._failing and seq <= self._kept

    def read(self, page: Page, then: Callable[[list[Record] | None], None]) -> None:
        """Ask for records of the store; `then` is called from within `take` with them, or with None."""
        with self._changed:
            if self._thread is not None and len(self._asked) < ASKED:
                self._asked.append(_Asked(page, then))
                self._changed.notify()
            else:
                self._answers.append((_Asked(page, then), None))
                os.eventfd_write(self._wake, 1)

    def take(self) -> list[Record]:
        """Return the records to publish now: they are on the disk, or it does not take them."""
        with suppress(BlockingIOError):
            os.eventfd_read(self._wake)
        while self._answers:
            asked, records = self._answers.popleft()
            asked.then(records)
        now, taken, was_late = self._clock(), list[Record](), self._late
        with self._changed:
            keeps = self._thread is not None and not self._failing
            while self._waiting:
                since, record = self._waiting[0]
                if keeps and record.seq > self._kept:
                    if now - since < PATIENCE_S:
                        break
                    self._late = True
                self._waiting.popleft()
                taken.append(record)
        if self._late and not was_late:
            self._say(f"{self.path}: takes longer than {PATIENCE_S:.0f} s; events are told before they are kept")
        return taken

    @property
    def conditions(self) -> set[Condition]:
        """Return the conditions of the store."""
        if self.path is None:
            return set()
        found = set()
        if self._thread is None or self._failing or self._late:
            found.add(Condition("store-failed", str(self.path)))
        if self._reset:
            found.add(Condition("store-reset", str(self.path)))
        if self._removed:
            found.add(Condition("store-removed", str(self.path)))
        if self._file is not None and self._file.senseless:
            found.add(Condition("rows-set-aside", str(self.path)))
        return found

    def finish(self, within_s: float) -> list[Record]:
        """Stop once what waits is stored, but after `within_s` [s] anyway; return what has not been published."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(within_s)
        with self._changed:
            left = [record for _, record in self._waiting]
            self._waiting.clear()
        return left

    def take_up(self) -> bool:
        """True once, if the store was opened since: `last` and `kept` are what it has, and all is kept from now on.

        What was put before has been told, and is not kept; of faults, the fault memory tells again what there is.
        """
        with self._changed:
            file = self._file
            if file is None or self._thread is not None or self._waiting:
                return False
            self.last, self.earlier, self.health, self.kept = file.last, file.earlier, file.health, file.kept
            file.earlier, file.kept = [], {}
            self._thread = self._opener
            self._changed.notify_all()
        self._note_aside(file)
        return True

    def _begin(self, path: Path, remembered: int) -> None:
        """Open the store in its thread, and wait for that."""

        def run() -> None:
            file = self._opened(path, remembered)
            with self._changed:
                self._file = file
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._thread is not None or self._ended)
            if self._thread is not None and file is not None:
                self._run(file)
            elif file is not None:
                file.close()

        self._opener = threading.Thread(target=run, name="store", daemon=True)
        self._opener.start()
        with self._changed:
            if not self._changed.wait_for(lambda: self._file is not None or not self._starting, OPENED_S):
                self._say(f"{path}: cannot be opened within {OPENED_S:.0f} s; events are told and not kept until it is")
            self._starting = False
        self.take_up()

    def _opened(self, path: Path, remembered: int) -> StoreFile | None:
        """Return the store, opened again and again; None if the journal ends before that."""
        wait_s, said = AGAIN_S, ""
        while True:
            failed: Exception
            try:
                return StoreFile(path, remembered)
            except Exception as error:  # noqa: BLE001 whatever it is, the service goes on without
                failed = error
            with self._changed:
                if not (self._starting and getattr(failed, "is_locked", False)):  # the start waits for a moment's lock
                    if str(failed) != said:
                        self._say(f"events are told and not kept until it can be opened: {failed}")
                    said, self._starting = str(failed), False
                    self._changed.notify_all()
                if self._changed.wait_for(lambda: self._ended, wait_s):
                    return None
            wait_s = min(2.0 * wait_s, LONGEST_S)

    def _note_aside(self, file: StoreFile) -> None:
        if file.aside is not None:
            self._reset = True
            self._say(f"{file.path}: was damaged, is now {file.aside}; a new store was begun")

    def _run(self, file: StoreFile) -> None:
        """Run the disk's thread."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._pending or self._dirty or self._asked or self._ended, LOOK_S)
                asked = self._asked.popleft() if self._asked else None
                batch, kept = [*self._pending], {**self._dirty}  # all of it: no state is newer than its last record
                is_last = self._ended and not (batch or kept or asked)
            failed = self._keep(file, batch, kept)
            if is_last and not failed:
                break
            for text in self._done(batch, kept, failed):
                self._say(text)
            if asked:
                self._answer(file, asked)
            if failed:
                with self._changed:
                    if self._changed.wait_for(lambda: self._ended, RETRY_S):
                        break
        file.close()

    def _answer(self, file: StoreFile, asked: "_Asked") -> None:
        try:
            records = asked.page.of(file)
        except sqlite3.Error as error:
            self._say(f"{self.path}: cannot be read: {error}")
            records = None
        self._answers.append((asked, records))
        os.eventfd_write(self._wake, 1)

    def _keep(self, file: StoreFile, batch: list[Record], kept: Mapping[str, bytes | None]) -> str:
        """Store records; return why the disk did not take them, or ""."""
        try:
            try:
                if file.is_gone():
                    aside = file.restore()
                    self._removed = True
                    instead = f"; what was there instead is now {aside}" if aside else ""
                    self._say(f"{self.path}: was removed or replaced while it was in use; written anew{instead}")
                if batch or kept:
                    file.append(batch, kept)
            except sqlite3.Error as error:
                if not is_damage(error):
                    raise
                try:
                    file.again()
                finally:
                    self._note_aside(file)
                    with self._changed:  # a new store has nothing of it, until it was written once
                        everything = self._dirty = {**self.kept, **self._dirty}
                file.append(batch, {**everything})
        except Exception as error:  # noqa: BLE001 the thread must not die of it: the next try may succeed
            return str(error) or type(error).__name__
        return ""

    def _done(self, batch: list[Record], kept: Mapping[str, bytes | None], failed: str) -> list[str]:
        """Handle the result of storing a batch; `failed` says why it did not. Return the messages for a person."""
        said = []
        with self._changed:
            if failed and not self._failing:
                said.append(f"{self.path}: {failed}; events are told and not kept, it is tried again")
            if not failed:
                while batch and self._pending and self._pending[0].seq <= batch[-1].seq:
                    self._pending.popleft()
                for name, value in kept.items():
                    if self._dirty.get(name, kept) is value:  # not put anew meanwhile
                        del self._dirty[name]
                self._kept = max(self._kept, *(each.seq for each in batch[-1:]), 0)
                if self._failing or self._late:
                    said.append(f"{self.path}: keeps events again")
                if self._given_up:
                    said.append(f"{self.path}: {self._given_up} events were told and are not kept, as too many waited")
                    self._given_up = 0
                self._late = False
            self._failing = bool(failed)
        os.eventfd_write(self._wake, 1)
        return said
