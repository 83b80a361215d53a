"""How far it is, kept: whole or not believed, on the disk or said not to be."""

import errno
import os
import re
import zlib
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from faultline.service.core.errors import InputError
from faultline.service.mqtt.cursor import Cursor, CursorFile
from faultline.service.mqtt.outbox import Passed
from faultline.service.mqtt.progress import KEPT_S, RETRY_S, Progress
from faultline.service.protocol.records import Record
from faultline.writing import ASIDE

SOME = Cursor(id="truck-17-5e0c72b1-12", seq=12, lost=3, vehicle="truck-17", faults=[1, 4])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "cursor"


@pytest.fixture
def file(path: Path) -> Iterator[CursorFile]:
    with closing(CursorFile(path)) as made:
        yield made


def test_what_was_kept_comes_back(file: CursorFile, path: Path) -> None:
    assert file.load() == (Cursor(), "")
    file.save(SOME)
    assert file.load() == (SOME, "")
    assert path.stat().st_mode & 0o777 == 0o600
    assert not [*path.parent.glob(".cursor.*")]


def test_it_is_on_the_disk_with_its_folder_before_it_counts(
    file: CursorFile, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced = list[str]()
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(str(Path(f"/proc/self/fd/{handle}").readlink())))
    file.save(SOME)
    assert synced == [str(path.with_name(f".cursor.partial-{os.getpid()}")), str(path.parent)]


@pytest.mark.parametrize("size", range(0, 116, 5))
def test_a_truncated_file_is_put_aside_and_nothing_of_it_believed(file: CursorFile, path: Path, size: int) -> None:
    file.save(SOME)
    whole = path.read_bytes()
    assert len(whole) > size
    path.write_bytes(whole[:size])
    kept, trouble = file.load()
    assert kept == Cursor()
    assert f"{path}: is damaged; it is now {path}.damaged-1; beginning with the oldest record there is" == trouble
    assert not path.exists()
    file.save(SOME)
    assert file.load() == (SOME, "")


def test_every_byte_that_changed_is_noticed(file: CursorFile, path: Path) -> None:
    file.save(SOME)
    whole = path.read_bytes()
    for place in range(len(whole) - 1):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert file.load()[0] == Cursor(), place


def _checked(line: bytes) -> bytes:
    return b"%s\n%08x\n" % (line, zlib.crc32(line))


@pytest.mark.parametrize(
    ("line", "trouble"),
    [
        (b'{"version":2,"where":1}', r"is of a newer faultline \(version 2, this one knows 1\); it is now"),
        (b"[]", "is no cursor: .*; it is now"),
        (b'{"version":1}', "is no cursor: .*; it is now"),
        (b'{"version":1,"cursor":{"id":1}}', "is no cursor: .*; it is now"),
        (b'{"version":1,"cursor":{"seq":-1}}', "is no cursor: .*; it is now"),
        (b'{"version":1,"cursor":{"sequence":1}}', "is no cursor: .*; it is now"),
        (b'{"version":1,"cursor":{"id":"\xff"}}', "is no cursor: .*; it is now"),
    ],
)
def test_a_file_of_another_program_or_a_newer_one_is_put_aside(
    file: CursorFile, path: Path, line: bytes, trouble: str
) -> None:
    path.write_bytes(_checked(line))
    kept, said = file.load()
    assert kept == Cursor()
    assert re.search(trouble, said), said


def test_of_the_files_put_aside_the_latest_are_left(file: CursorFile, path: Path) -> None:
    for number in range(ASIDE + 3):
        path.write_text(str(number))
        file.load()
    left = sorted(path.parent.glob("cursor.damaged-*"))
    assert [each.read_text() for each in left] == ["3", "4", "5"]


def test_a_folder_in_its_place_is_said_and_left(file: CursorFile, path: Path) -> None:
    path.mkdir()
    kept, trouble = file.load()
    assert kept == Cursor()
    assert trouble.startswith(f"{path}: cannot be read: Is a directory")
    with pytest.raises(OSError, match="directory"):
        file.save(SOME)


def test_only_one_process_has_it(file: CursorFile, path: Path) -> None:
    with pytest.raises(InputError, match="another faultline mqtt uses it; stop that one, or give each its own"):
        CursorFile(path)
    file.close()
    CursorFile(path).close()


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be kept there: No such file or directory; make the folder"):
        CursorFile(tmp_path / "nowhere" / "cursor")


@pytest.mark.parametrize("step", ["open", "fsync", "replace"])
def test_a_full_disk_leaves_what_was_kept(
    file: CursorFile, path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    file.save(SOME)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os if step == "fsync" else Path, step, full)
        with pytest.raises(OSError, match="No space left"):
            file.save(Cursor(id="x", seq=99))
    assert file.load() == (SOME, "")
    assert not [*path.parent.glob(".cursor.*")]


def test_a_full_disk_at_the_start_refuses_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "open", full)
    file = CursorFile(path)
    assert file.load() == (Cursor(), "")
    file.close()


def passed(seq: int, *, lost: int = 0, given_up: bool = False) -> list[Passed]:
    record = Record(id=f"truck-{seq}", seq=seq, schema="", wall=None, line=b"", lost=lost)
    return [Passed(record, given_up)]


def test_progress_is_kept_twice_a_second_at_most(file: CursorFile) -> None:
    progress = Progress(file, Cursor(), lambda *_: None)
    assert progress.keep(None, (), 10.0) is None
    progress.passed(passed(1))
    assert progress.keep("truck", {3, 1}, 10.0) == 10.0 + KEPT_S
    assert file.load()[0] == Cursor(id="truck-1", seq=1, vehicle="truck", faults=[1, 3])
    progress.passed(passed(2))
    assert progress.keep("truck", {3, 1}, 10.1) == 10.0 + KEPT_S
    assert file.load()[0].seq == 1
    progress.keep("truck", {3, 1}, 10.0 + KEPT_S)
    assert file.load()[0].seq == 2
    assert progress.keep("truck", {1, 3}, 11.0) is None


def test_what_was_lost_is_counted_with_the_record_after_it(file: CursorFile) -> None:
    progress = Progress(file, Cursor(id="truck-1", seq=1, lost=5), lambda *_: None)
    progress.passed([*passed(2, lost=3), *passed(3, given_up=True)])
    assert progress.lost == 9
    progress.keep(None, (), 0.0)
    assert file.load()[0] == Cursor(id="truck-3", seq=3, lost=9)


def test_a_disk_that_is_full_is_said_and_tried_again(file: CursorFile, monkeypatch: pytest.MonkeyPatch) -> None:
    said = list[str]()
    progress = Progress(file, Cursor(), lambda text, *_: said.append(text))

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    progress.passed(passed(1))
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        assert progress.keep(None, (), 10.0) == 10.0 + RETRY_S
    assert said == ["how far it is cannot be kept: No space left on device; after a restart records come twice"]
    progress.keep(None, (), 10.0 + RETRY_S - 0.1)
    assert file.load()[0] == Cursor()
    progress.keep(None, (), 10.0 + RETRY_S)
    assert file.load()[0].seq == 1
