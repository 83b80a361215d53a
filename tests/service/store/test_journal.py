"""Kept before it is told, and told even where it cannot be kept."""

import sqlite3
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from faultline.service.store import file as store_file
from faultline.service.store import journal as module
from faultline.service.store.file import Record, StoreFile
from faultline.service.store.journal import Journal


def records(first: int, last: int) -> list[Record]:
    return [Record(seq, "event", b'{"seq":%d}\n' % seq) for seq in range(first, last + 1)]


def kinds(journal: Journal) -> set[str]:
    return {each.kind for each in journal.conditions}


class Disk:
    """Stands before the file: takes what comes, waits, or fails, as it is told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.open = threading.Event()
        self.open.set()
        self.failure: Exception | None = None
        self.tries = 0
        append = StoreFile.append

        def through(file: StoreFile, given: list[Record], kept: Mapping[str, bytes | None]) -> None:
            self.tries += 1
            assert self.open.wait(30)
            if self.failure is not None:
                raise self.failure
            append(file, given, kept)

        monkeypatch.setattr(StoreFile, "append", through)
        monkeypatch.setattr(module, "RETRY_S", 0.01)


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.sqlite"


@pytest.fixture
def journal(path: Path, disk: Disk, clock: Clock, said: list[str]) -> Iterator[Journal]:
    with Journal(path, said.append, 10, clock) as made:
        yield made
        disk.open.set()
        made.finish(30)


def within(seconds: float, check: Callable[[], bool]) -> None:
    end = time.monotonic() + seconds
    while not check():
        assert time.monotonic() < end
        time.sleep(0.001)


def taken(journal: Journal, count: int) -> list[Record]:
    """So many records, as soon as they may be told."""
    found: list[Record] = []

    def enough() -> bool:
        found.extend(journal.take())
        return len(found) >= count

    within(10, enough)
    return found


def stored(path: Path) -> list[Record]:
    """What is in the file, after the journal has ended."""
    file = StoreFile(path)
    found = file.before(None, 9999)
    file.close()
    return found


def test_nothing_is_told_before_it_is_on_the_disk(journal: Journal, disk: Disk, path: Path) -> None:
    disk.open.clear()
    for each in records(1, 3):
        journal.put(each)
    within(10, lambda: disk.tries == 1)
    assert journal.take() == []
    disk.open.set()
    assert taken(journal, 3) == records(1, 3)
    assert journal.conditions == set()
    journal.finish(10)
    assert stored(path) == records(1, 3)


def test_without_a_path_all_is_told_at_once(said: list[str]) -> None:
    with Journal(None, said.append) as journal:
        journal.put(records(1, 1)[0])
        assert journal.take() == records(1, 1)
        assert (journal.last, journal.earlier, journal.health) == (0, [], None)
        assert journal.conditions == set()
        assert journal.fresh
    assert said == []


def test_it_goes_on_from_what_is_there(path: Path, said: list[str]) -> None:
    with Journal(path, said.append) as journal:
        for each in [*records(1, 20), Record(21, "health", b"{}\n")]:
            journal.put(each)
        assert len(taken(journal, 21)) == 21
        journal.finish(10)
    with Journal(path, said.append, 3) as journal:
        assert journal.last == 21
        assert journal.earlier == [*records(19, 20), Record(21, "health", b"{}\n")]
        assert journal.health == Record(21, "health", b"{}\n")
        journal.finish(10)
    assert said == []


def test_a_disk_that_fails_keeps_no_alarm_back(journal: Journal, disk: Disk, path: Path, said: list[str]) -> None:
    disk.failure = sqlite3.OperationalError("database or disk is full")
    for each in records(1, 3):
        journal.put(each)
    assert taken(journal, 3) == records(1, 3)
    assert kinds(journal) == {"store-failed"}
    journal.put(records(4, 4)[0])
    assert journal.take() == records(4, 4), "at once: it is known to fail"
    disk.failure = None
    within(10, lambda: kinds(journal) == set())
    journal.put(records(5, 5)[0])
    assert taken(journal, 1) == records(5, 5)
    journal.finish(10)
    assert stored(path) == records(1, 5), "all of it was tried again"
    assert said == [
        f"{path}: database or disk is full; events are told and not kept, it is tried again",
        f"{path}: keeps events again",
    ]


def test_a_disk_that_hangs_keeps_no_alarm_back_for_long(journal: Journal, disk: Disk, path: Path, clock: Clock) -> None:
    disk.open.clear()
    journal.put(records(1, 1)[0])
    within(10, lambda: disk.tries == 1)
    clock.now = 1.9
    assert journal.take() == []
    journal.put(records(2, 2)[0])
    clock.now = 2.1
    assert journal.take() == records(1, 1)
    assert kinds(journal) == {"store-failed"}
    assert journal.take() == [], "its own patience"
    disk.open.set()
    assert taken(journal, 1) == records(2, 2)
    within(10, lambda: kinds(journal) == set())
    journal.finish(10)
    assert stored(path) == records(1, 2)


def test_a_disk_that_hangs_or_is_not_there_is_no_reason_to_restart(
    journal: Journal, disk: Disk, clock: Clock, tmp_path: Path, said: list[str]
) -> None:
    """Restarted, it would hang again, and tell nothing at all."""
    disk.open.clear()
    journal.put(records(1, 1)[0])
    within(10, lambda: disk.tries == 1)
    clock.now += 3600.0
    assert journal.fresh
    for path in (None, tmp_path / "absent" / "events.sqlite"):
        with Journal(path, said.append, 0, clock) as other:
            clock.now += 3600.0
            assert other.fresh


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_died_is_one(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which nothing that is known can bring about."""
    assert journal.fresh
    monkeypatch.setattr(module.Journal, "_keep", lambda *_: sys.exit())
    journal.put(records(1, 1)[0])
    within(10, lambda: not journal.fresh)
    monkeypatch.undo()


@pytest.mark.parametrize("error", [MemoryError(), OverflowError("too large"), sqlite3.InterfaceError("odd")])
def test_no_error_ends_the_thread(journal: Journal, disk: Disk, error: Exception, path: Path) -> None:
    disk.failure = error
    journal.put(records(1, 1)[0])
    assert taken(journal, 1) == records(1, 1)
    assert kinds(journal) == {"store-failed"}
    disk.failure = None
    within(10, lambda: kinds(journal) == set())
    journal.finish(10)
    assert stored(path) == records(1, 1)


@pytest.mark.parametrize("hangs", [True, False])
def test_what_waits_is_bounded(
    journal: Journal,
    disk: Disk,
    path: Path,
    said: list[str],
    monkeypatch: pytest.MonkeyPatch,
    hangs: bool,
    clock: Clock,
) -> None:
    monkeypatch.setattr(module, "PENDING", 100)
    if hangs:
        disk.open.clear()
    disk.failure = None if hangs else sqlite3.OperationalError("disk I/O error")
    for each in records(1, 1000):
        journal.put(each)
        assert len(journal._pending) <= 100
    clock.now += 10.0
    assert taken(journal, 1000) == records(1, 1000), "told are all"
    disk.failure = None
    disk.open.set()
    within(10, lambda: kinds(journal) == set())
    journal.finish(10)
    kept = {each.seq for each in stored(path)}
    assert set(range(901, 1001)) <= kept
    assert any("events were told and are not kept, as too many waited" in text for text in said)


def test_a_disk_that_hangs_at_the_start_holds_nobody_up(
    path: Path, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "OPENED_S", 0.05)
    free, opened = threading.Event(), StoreFile.__init__

    def slow(file: StoreFile, *given: Any) -> None:
        free.wait(30)
        opened(file, *given)

    monkeypatch.setattr(StoreFile, "__init__", slow)
    with Journal(path, said.append) as journal:
        journal.put(records(1, 1)[0])
        assert journal.take() == records(1, 1)
        assert kinds(journal) == {"store-failed"}
        free.set()
    assert said == [f"{path}: cannot be opened within 0 s; events are told and not kept until it is"]
    monkeypatch.undo()
    within(10, lambda: not [thread for thread in threading.enumerate() if thread.name == "store"])
    assert stored(path) == []


def test_a_store_that_is_damaged_while_it_is_used_is_put_aside(
    journal: Journal, disk: Disk, path: Path, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    journal.put(records(1, 1)[0], kept={"fault/1": b"one"})
    assert taken(journal, 1) == records(1, 1)
    through, calls = StoreFile.append, list[int]()

    def damaged_once(file: StoreFile, given: list[Record], kept: Mapping[str, bytes | None]) -> None:
        calls.append(len(given))
        if len(calls) == 1:
            file.close()
            path.write_bytes(b"overwritten by somebody" * 1000)
            raise sqlite3.DatabaseError("database disk image is malformed")
        through(file, given, kept)

    monkeypatch.setattr(StoreFile, "append", damaged_once)
    journal.put(records(2, 2)[0], kept={"fault/2": b"two"})
    assert taken(journal, 1) == records(2, 2)
    assert kinds(journal) == {"store-reset"}
    journal.finish(10)
    assert stored(path) == records(2, 2)
    assert StoreFile(path).kept == {"fault/1": b"one", "fault/2": b"two"}  # what is remembered was not lost with it
    assert path.with_name("events.sqlite.damaged-1").read_bytes().startswith(b"overwritten")
    assert any("was damaged, is now" in text for text in said)


def test_one_that_cannot_be_opened_is_told(tmp_path: Path, said: list[str]) -> None:
    with Journal(tmp_path / "absent" / "events.sqlite", said.append) as journal:
        journal.put(records(1, 1)[0])
        assert journal.take() == records(1, 1)
        assert kinds(journal) == {"store-failed"}
    assert len(said) == 1
    assert said[0].startswith("events are told and not kept until it can be opened: ")


def test_at_the_end_what_is_left_is_given_back(journal: Journal, disk: Disk) -> None:
    disk.open.clear()
    for each in records(1, 2):
        journal.put(each)
    assert journal.finish(0.01) == records(1, 2)
    assert journal.finish(0.01) == []


def test_a_waiting_loop_is_woken(journal: Journal) -> None:
    import select

    assert select.select([journal.fileno()], [], [], 0)[0] == []
    journal.put(records(1, 1)[0])
    assert select.select([journal.fileno()], [], [], 10)[0]
    assert journal.take() == records(1, 1)
    assert select.select([journal.fileno()], [], [], 0)[0] == []


@pytest.fixture
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of milliseconds."""
    monkeypatch.setattr(module, "AGAIN_S", 0.01)
    monkeypatch.setattr(module, "LOOK_S", 0.01)
    monkeypatch.setattr(module, "RETRY_S", 0.01)
    monkeypatch.setattr(store_file, "LOCKED_S", 0.0)


def held(path: Path) -> StoreFile:
    """A store with a record and a row that somebody else has open."""
    other = StoreFile(path)
    other.append(records(1, 7), {"fault/1": b"one"})
    return other


@pytest.mark.usefixtures("patience")
def test_a_store_that_is_locked_for_a_moment_is_waited_for(path: Path, said: list[str]) -> None:
    other = held(path)
    threading.Timer(0.2, other.close).start()
    with Journal(path, said.append) as journal:
        assert (journal.last, journal.kept, journal.conditions) == (7, {"fault/1": b"one"}, set())
        journal.put(records(8, 8)[0])
        assert taken(journal, 1) == records(8, 8)
        assert journal.has(8)
        journal.finish(10)
    assert said == []


@pytest.mark.usefixtures("patience")
def test_one_that_is_locked_for_long_is_taken_up_once_it_is_free(
    path: Path, said: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "OPENED_S", 0.05)
    other = held(path)
    with Journal(path, said.append, 3) as journal:
        journal.put(records(1, 1)[0], kept={"fault/1": b"another"})
        assert journal.take() == records(1, 1)
        assert not journal.take_up()
        assert kinds(journal) == {"store-failed"}
        other.close()
        within(10, journal.take_up)
        assert not journal.take_up(), "once"
        assert (journal.last, journal.kept, journal.earlier) == (7, {"fault/1": b"one"}, records(5, 7))
        assert journal.conditions == set()
        journal.put(records(8, 8)[0])
        assert taken(journal, 1) == records(8, 8)
        journal.finish(10)
    assert stored(path) == records(1, 8)
    first, *later = said  # the opener may try once more, and name the cause, before the lock is gone
    assert first == f"{path}: cannot be opened within 0 s; events are told and not kept until it is"
    assert not later or (len(later) == 1 and "another process has it" in later[0])


def remove(path: Path) -> None:
    path.unlink()


def remove_both(path: Path) -> None:
    path.unlink()
    path.with_name(f"{path.name}-wal").unlink()


def remove_log(path: Path) -> None:
    path.with_name(f"{path.name}-wal").unlink()


def replace(path: Path) -> None:
    other = path.with_name("other")
    StoreFile(other).close()
    other.rename(path)


@pytest.mark.usefixtures("patience")
@pytest.mark.parametrize("act", [remove, remove_both, remove_log, replace])
def test_a_store_that_is_taken_away_is_noticed_and_written_anew(
    path: Path, said: list[str], act: Callable[[Path], None]
) -> None:
    """SQLite goes on writing into a file that has no name any more, and says nothing."""
    with Journal(path, said.append) as journal:
        journal.put(*records(1, 3), kept={"fault/1": b"one"})
        assert taken(journal, 3) == records(1, 3)
        act(path)
        within(10, lambda: kinds(journal) == {"store-removed"})
        journal.put(*records(4, 5), kept={"fault/2": b"two"})
        assert taken(journal, 2) == records(4, 5)
        journal.finish(10)
    assert stored(path) == records(1, 5)
    assert StoreFile(path).kept == {"fault/1": b"one", "fault/2": b"two"}
    instead = f"; what was there instead is now {path}.damaged-1" if act in (replace, remove_log) else ""
    assert said == [f"{path}: was removed or replaced while it was in use; written anew{instead}"]


@pytest.mark.usefixtures("patience")
def test_one_whose_folder_is_taken_away_is_written_once_there_is_a_place(tmp_path: Path, said: list[str]) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    path = folder / "events.sqlite"
    with Journal(path, said.append) as journal:
        journal.put(*records(1, 3), kept={"fault/1": b"one"})
        assert taken(journal, 3) == records(1, 3)
        folder.rename(tmp_path / "elsewhere")
        within(10, lambda: kinds(journal) == {"store-failed"})
        folder.mkdir()
        within(10, lambda: kinds(journal) == {"store-removed"})
        journal.finish(10)
    assert stored(path) == records(1, 3)
    assert StoreFile(path).kept == {"fault/1": b"one"}


def test_no_state_is_newer_than_its_last_record(journal: Journal, disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of what has waited, however much: a power cut between two commits would leave a state of lost records."""
    through, commits = StoreFile.append, list[tuple[int, int]]()

    def seen(file: StoreFile, given: list[Record], kept: Mapping[str, bytes | None]) -> None:
        through(file, given, kept)
        commits.append((given[-1].seq, int(kept["state"] or 0)))

    monkeypatch.setattr(StoreFile, "append", seen)
    disk.open.clear()
    for each in records(1, 1000):
        journal.put(each, kept={"state": str(each.seq).encode()})
    disk.open.set()
    assert taken(journal, 1000) == records(1, 1000)
    assert commits[-1] == (1000, 1000)
    assert all(state == last for last, state in commits)
