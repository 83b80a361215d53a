"""The store's file keeps what it has acknowledged, whatever happens to the process, the disk or the file."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from faultline.service.store import file as module
from faultline.service.store.file import Record, StoreError, StoreFile


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.sqlite"


def records(first: int, last: int, about: module.About = "event") -> list[Record]:
    return [Record(seq, about, b'{"seq":%d}\n' % seq) for seq in range(first, last + 1)]


def filled(path: Path, count: int = 500) -> list[Record]:
    """A store of some pages, closed."""
    given = [Record(seq, "event", os.urandom(200)) for seq in range(1, count + 1)]
    store = StoreFile(path)
    store.append(given)
    store.close()
    return given


def test_what_was_added_is_there_again(path: Path) -> None:
    store = StoreFile(path)
    assert (store.last, store.before(None, 10), store.aside) == (0, [], None)
    assert store.health is None
    store.append(records(1, 3))
    store.append(records(4, 4, "health"))
    store.append(records(5, 6))
    store.append(records(7, 7, "context"))
    store.close()
    store = StoreFile(path, remembered=4)
    assert store.last == 7
    assert store.earlier == [*records(4, 4, "health"), *records(5, 6), *records(7, 7, "context")]
    assert store.health == records(4, 4, "health")[0]
    assert len(store.before(None, 100)) == 7
    store.close()


def test_what_is_added_twice_is_there_once(path: Path) -> None:
    """A try that failed may have come to the disk after all."""
    store = StoreFile(path)
    store.append(records(1, 3))
    store.append(records(2, 4))
    assert store.before(None, 9) == records(1, 4)
    store.close()


def test_one_process_has_it(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = StoreFile(path)
    monkeypatch.setattr(module, "LOCKED_S", 0.0)
    with pytest.raises(StoreError, match=r"events\.sqlite: cannot be used: another process has it"):
        StoreFile(path)
    store.append(records(1, 1))
    store.close()


def test_a_newer_faultlines_store_is_left_as_it_is(path: Path) -> None:
    filled(path)
    db = sqlite3.connect(path)
    db.execute("PRAGMA user_version=99")
    db.close()
    before = path.read_bytes()
    with pytest.raises(StoreError, match=r"is of a newer faultline \(version 99, this one knows 2\)"):
        StoreFile(path)
    assert path.read_bytes() == before


def damage_head(path: Path) -> None:
    path.write_bytes(b"no database at all" * 100)


def damage_middle(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[8192 : 8192 + 4096] = b"\xff" * 4096
    path.write_bytes(content)


def damage_end(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5000])


def changed(path: Path, sql: str) -> None:
    db = sqlite3.connect(path)
    db.execute("PRAGMA writable_schema=ON")
    db.execute(sql)
    db.commit()
    db.close()


def damage_tables(path: Path) -> None:
    changed(path, "DELETE FROM sqlite_schema WHERE name = 'record'")


def damage_one_row(path: Path) -> None:
    """A flipped bit that the check does not see: no text any more."""
    changed(path, "UPDATE record SET about = CAST(x'ff76656e74' AS TEXT) WHERE seq = 400")


def damage_version(path: Path) -> None:
    """Another program's, that has our number."""
    changed(path, "DROP TABLE record")


DAMAGES = [damage_head, damage_middle, damage_end, damage_tables, damage_one_row, damage_version]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_one_is_put_aside_whole_and_a_new_one_begun(path: Path, damage: object) -> None:
    filled(path)
    damage(path)  # type: ignore[operator]
    before = path.read_bytes()
    store = StoreFile(path, remembered=1000)
    assert store.aside == path.with_name("events.sqlite.damaged-1")
    assert store.aside.read_bytes() == before
    assert store.last == 0
    store.append(records(1, 2))
    store.close()
    store = StoreFile(path)
    assert (store.before(None, 9), store.aside) == (records(1, 2), None)
    store.close()


def test_another_programs_database_is_left_as_it_is(path: Path) -> None:
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE precious (x)")
    db.commit()
    db.close()
    before = path.read_bytes()
    with pytest.raises(StoreError, match="is another program's database; nothing was changed: give another path"):
        StoreFile(path)
    assert path.read_bytes() == before


def test_what_was_put_aside_is_said_though_no_new_one_can_be_made(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled(path)
    damage_head(path)
    opened = module._open

    def only_once(path: Path) -> sqlite3.Connection:
        monkeypatch.setattr(module, "_open", full)
        return opened(path)

    def full(_: Path) -> sqlite3.Connection:
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(module, "_open", only_once)
    with pytest.raises(StoreError, match=r"was damaged and is now .*damaged-1; a new one cannot be used: .* is full"):
        StoreFile(path)


def test_of_damaged_ones_the_latest_are_left(path: Path) -> None:
    for turn in range(12):
        path.write_bytes(b"%d " % turn * 1000)
        StoreFile(path).close()
    found = sorted(each.name for each in path.parent.glob("*.damaged-*"))
    assert found == [f"events.sqlite.damaged-{number}" for number in (10, 11, 12)]


@pytest.mark.parametrize("name", ["absent/events.sqlite", "."])
def test_a_place_that_cannot_be_used(path: Path, name: str) -> None:
    with pytest.raises(StoreError, match="mend that or give another path"):
        StoreFile(path.parent / name)


def test_a_full_disk_takes_nothing_and_loses_nothing(path: Path) -> None:
    store = StoreFile(path)
    store.append(records(1, 10))
    store._db.execute("PRAGMA max_page_count=8")
    big = [Record(seq, "event", b'{"x":"%s"}\n' % os.urandom(4500).hex().encode()) for seq in range(11, 30)]
    with pytest.raises(sqlite3.OperationalError, match="full"):
        store.append(big)
    assert store.before(None, 99) == records(1, 10)
    store._db.execute("PRAGMA max_page_count=100000")
    store.append(big)
    assert store.before(None, 99) == [*records(1, 10), *big]
    store.close()


def test_the_latest_of_each_kind_are_kept(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loose plug makes health records by the thousand: faults stay."""
    monkeypatch.setattr(module, "KEPT", {"event": 50, "health": 20, "fault": 20, "context": 20})
    monkeypatch.setattr(module, "PRUNED", 10)
    store = StoreFile(path)
    store.append(records(1, 5))
    for seq in range(6, 1000):
        store.append(records(seq, seq, "health"))
    left = store.before(None, 9999)
    assert left[:5] == records(1, 5)
    assert 20 <= len(left) - 5 <= 20 + 11
    assert left[-1].seq == 999
    store.append(records(1000, 1100))
    store.append(records(1101, 1101))
    assert sum(each.about == "event" for each in store.before(None, 9999)) == 50
    store.close()


def test_short_runs_keep_no_more_than_long_ones(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A vehicle that is driven for ten minutes at a time."""
    monkeypatch.setattr(module, "KEPT", {"event": 50, "health": 20, "fault": 20, "context": 20})
    for run in range(10):
        store = StoreFile(path)
        for seq in range(1 + 100 * run, 101 + 100 * run):
            store.append(records(seq, seq))
        left = len(store.before(None, 9999))
        store.close()
    assert left <= 50 + 100


WRITER = """
import os, sys
from pathlib import Path
from faultline.service.store.file import Record, StoreFile
store = StoreFile(Path(sys.argv[1]))
seq = store.last
while True:
    count = 1 + seq % 7
    lines = {k: b'{"x":"%s"}\\n' % (b"x" * (k % 3000)) for k in range(seq + 1, seq + count + 1)}
    store.append([Record(k, "event", line) for k, line in lines.items()])
    seq += count
    os.write(1, b"%d\\n" % seq)
"""


def test_a_killed_process_has_lost_nothing_that_it_acknowledged(path: Path) -> None:
    seed = int.from_bytes(os.urandom(4))
    print("seed", seed)
    chance = np.random.default_rng(seed)
    acknowledged = 0
    for _ in range(8):
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        said = process.stdout.readline()
        time.sleep(float(chance.uniform(0.0, 0.1)))
        process.send_signal(signal.SIGKILL)
        said += process.stdout.read()
        process.stdout.close()
        process.wait()
        acknowledged = int(said.rpartition(b"\n")[0].rpartition(b"\n")[2])
        store = StoreFile(path)
        assert store.aside is None
        assert store.last >= acknowledged
        left = store.before(None, store.last)
        store.close()
        assert [each.seq for each in left] == list(range(left[0].seq, left[-1].seq + 1))
        assert all(each.line == b'{"x":"%s"}\n' % (b"x" * (each.seq % 3000)) for each in left)
    assert acknowledged > 8


def test_rows_that_are_no_records_are_left_where_they_are_and_not_read(path: Path) -> None:
    """Somebody else's tool has written there: what is told from the store is a line of JSON each."""
    store = StoreFile(path)
    store.append(records(1, 3))
    rows: list[tuple[int, str, bytes]] = [
        (4, "event", b"xx\n"),
        (5, "event", b"[1]\n"),
        (6, "event", b'{"seq":6}'),
        (7, "event", b'{"a":1}\n{"b":2}\n'),
        (8, "weather", b"{}\n"),
        (9, "health", b'{"seq":9}\xff\n'),
        (2**63 - 1, "event", b"{}\n"),
    ]
    store._db.executemany("INSERT INTO record VALUES (?, ?, ?)", rows)
    store.append(records(10, 10))
    store.close()
    again = StoreFile(path, remembered=5)
    assert again.senseless
    assert again.earlier == [*records(1, 3), *records(10, 10)]
    assert (again.last, again.health) == (10, None)
    assert again.after(3, 1) == records(10, 10)
    assert again.before(10, 2) == records(2, 3)
    again.append(records(11, 11))
    assert again.after(10, 9) == records(11, 11)
    again.close()
