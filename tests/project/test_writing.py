"""Files and folders are written whole or not at all, and by one module."""

import ast
import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from bad_conditions import Condition, Killed, started

from faultline.writing import check_file, check_folder, write_file, write_files, write_folder, written_whole

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("service", "analysis", "training", "testbench", "dbc", "systems", "src/faultline")

OTHERS = {
    "src/faultline/writing.py": "it does",
    "service/logs/writers.py": "a log, to a path that `written_whole` gives",
    "service/cli.py": "a closed output is given /dev/null",
    "analysis/discrepancy/add/bundle_effect.py": "a bundle in a temporary folder, to be loaded",
    "testbench/can_logger.py": "a log in a temporary folder, for python-can to read",
    "testbench/demo.py": "what its processes say, as they say it",
}
"""Modules that open files for writing, and why each may."""


def _content(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*")) if path.is_file()}


def _writes(path: Path) -> bool:
    for node in ast.walk(ast.parse(path.read_bytes())):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        modes = [each.value for each in ast.walk(node) if isinstance(each, ast.Constant)]
        if name in ("write_text", "write_bytes", "copyfile", "copytree", "copy2"):
            return True
        if name == "open" and any(isinstance(mode, str) and mode.rstrip("b+") in ("w", "a", "x") for mode in modes):
            return True
    return False


def test_nothing_else_writes_files() -> None:
    files = (path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    assert {str(path.relative_to(ROOT)) for path in files if _writes(path)} == {*OTHERS}


def _new_files(folder: Path, condition: Condition) -> None:
    condition()
    write_files({folder / name: "new" for name in "ab"})


def _new_folder(folder: Path, condition: Condition) -> None:
    condition()
    write_folder(folder, dict.fromkeys("ab", b"new"))


def _streamed(folder: Path, condition: Condition) -> None:
    condition()
    with written_whole(folder / "a") as path, path.open("a") as file:
        file.write("new")


@pytest.mark.parametrize("number", range(3))
def test_what_is_streamed_is_the_old_or_the_new_too(tmp_path: Path, number: int) -> None:
    write_folder(tmp_path / "f", {"a": b"old"})
    process = started(_streamed, tmp_path / "f", Killed(number))
    process.join()
    assert process.exitcode == (0 if number >= 2 else -9)
    assert (tmp_path / "f" / "a").read_text() == ("old" if number < 1 else "new")
    _streamed(tmp_path / "f", lambda: None)
    assert _content(tmp_path) == {"f/a": "new"}


@pytest.mark.parametrize("function", [_new_files, _new_folder])
@pytest.mark.parametrize("number", range(5))
def test_killed_at_any_time_it_is_the_old_or_the_new(
    tmp_path: Path, function: Callable[[Path, Condition], None], number: int
) -> None:
    folder = tmp_path / "f"
    old, new = ({"a": text, "b": text} for text in ("old", "new"))
    write_folder(folder, dict.fromkeys("ab", b"old"))
    process = started(function, folder, Killed(number))
    process.join()
    there = {name: text for name, text in _content(folder).items() if ".partial-" not in name}
    contents, last = (2, 3) if function is _new_files else (3, 4)  # synced before it counts, and all
    assert process.exitcode == (0 if number >= last else -9)
    assert there == (old if number < contents else new)
    function(folder, lambda: None)
    assert _content(tmp_path) == {f"f/{name}": text for name, text in new.items()}


class _KilledBetween:
    """At the second renaming."""

    def __call__(self) -> None:
        rename = Path.rename

        def once(path: Path, target: Path) -> Path:
            if ".partial-" in path.name:
                os.kill(os.getpid(), 9)
            return rename(path, target)

        Path.rename = once  # type: ignore[method-assign, assignment]


def test_killed_between_the_renamings_the_old_is_beside(tmp_path: Path) -> None:
    write_folder(tmp_path / "f", {"a": b"old"})
    process = started(_new_folder, tmp_path / "f", _KilledBetween())
    process.join()
    assert not (tmp_path / "f").exists()
    assert (tmp_path / f".f.old-{process.pid}" / "a").read_text() == "old"


def _full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("function", "broken", "named"),
    [
        (_new_files, (Path, "open"), "a"),
        (_new_files, (os, "fsync"), "a"),
        (_new_files, (Path, "replace"), "a"),
        (_streamed, (Path, "open"), "a"),
        (_streamed, (os, "fsync"), "a"),
        (_streamed, (Path, "replace"), "a"),
        (_new_folder, (Path, "open"), "a"),
        (_new_folder, (os, "fsync"), "a"),
        (_new_folder, (Path, "rename"), ""),
    ],
)
def test_a_failure_names_the_target_and_leaves_what_was_there(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    function: Callable[[Path, Condition], None],
    broken: tuple[object, str],
    named: str,
) -> None:
    folder = tmp_path / "f"
    write_folder(folder, {"a": b"old"})
    with monkeypatch.context() as patched:
        patched.setattr(*broken, _full)
        with pytest.raises(OSError, match="No space left") as raised:
            function(folder, lambda: None)
    assert raised.value.filename == str(folder / named)
    assert _content(tmp_path) == {"f/a": "old"}


def test_a_folder_that_fails_its_check_does_not_replace_the_old_one(tmp_path: Path) -> None:
    write_folder(tmp_path / "f", {"a": b"old"})

    def check(folder: Path) -> None:
        assert _content(folder) == {"a": "new"}
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        write_folder(tmp_path / "f", {"a": b"new"}, check)
    assert _content(tmp_path) == {"f/a": "old"}


def test_an_interrupt_between_the_renamings_gives_the_old_one_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_folder(tmp_path / "f", {"a": b"old"})
    rename = Path.rename

    def interrupted(path: Path, target: Path) -> Path:
        if ".partial-" in path.name:
            raise KeyboardInterrupt
        return rename(path, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "rename", interrupted)
        with pytest.raises(KeyboardInterrupt):
            write_folder(tmp_path / "f", {"a": b"new"})
    assert _content(tmp_path) == {"f/a": "old"}


def test_a_link_is_followed_and_permissions_stay(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    write_file(tmp_path / "real" / "a", "old", 0o600)
    (tmp_path / "link").symlink_to("real/a")
    write_file(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "a").read_text() == "new"
    assert (tmp_path / "real" / "a").stat().st_mode & 0o777 == 0o600


def test_what_is_no_file_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_file(tmp_path / "pipe", "new")
    assert os.read(reader, 9) == b"new"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
    (tmp_path / "full").symlink_to("/dev/full")
    with pytest.raises(OSError, match=f"No space left on device: '{tmp_path}/full'"):
        write_file(tmp_path / "full", "new")


def test_partials_of_the_dead_are_removed_and_of_the_living_are_left(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as dead:
        pass
    for process in (dead.pid, os.getppid()):
        (tmp_path / f".a.partial-{process}").touch()
    write_file(tmp_path / "a", "new")
    assert _content(tmp_path) == {f".a.partial-{os.getppid()}": "", "a": "new"}


def test_places_are_looked_at_and_nothing_is_made(tmp_path: Path) -> None:
    check_file(tmp_path / "new" / "file")
    check_folder(tmp_path / "new" / "folder")
    assert not [*tmp_path.iterdir()]
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match=f"'{tmp_path}/file'"):
        check_file(tmp_path / "file" / "x")
    with pytest.raises(NotADirectoryError, match=f"'{tmp_path}/file'"):
        check_folder(tmp_path / "file")
    with pytest.raises(IsADirectoryError, match=f"'{tmp_path}'"):
        check_file(tmp_path)
    check_file(Path("/dev/null"))
