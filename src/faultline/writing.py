"""Write files and folders whole or not at all, after every failure, interrupt, kill or power cut.

Content goes to `.NAME.partial-PID` beside its target, then onto the disk (fsync), and then it gets its name (rename).
The partial is removed after an error or an interrupt. That of a process that was killed stays; the next writer of NAME
removes it. Every OSError names the target.
"""

import errno
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of the errors of a disk, a quota or a file size that is used up."""

ASIDE = 3
"""Damaged files of one name that are left."""

PROBE = bytes(4096)
"""A block: a full disk often has room for an empty file."""


def write_file(path: Path, content: bytes | str, mode: int | None = None) -> None:
    """Write one file, as `write_files` does."""
    write_files({path: content}, mode)


def write_files(files: Mapping[Path, bytes | str], mode: int | None = None) -> None:
    """Write files, text as UTF-8: none gets its name before all are on the disk. The folders they are in are made.

    A link is followed, a device is written as it is. A file that is replaced keeps its permissions unless `mode` is
    given.

    Raises:
        OSError: one cannot be written, `filename` says which. What was there before is unchanged.
    """
    raw = {path: text.encode() if isinstance(text, str) else text for path, text in files.items()}
    partials: dict[Path, tuple[Path, Path]] = {}
    try:
        for path, content in raw.items():
            with _naming(path):
                target = Path(os.path.realpath(path))
                if target.exists() and not target.is_file():
                    target.write_bytes(content)
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                partials[path] = _partial(target), target
                _put(*partials[path], content, mode)
        for path, (partial, target) in partials.items():
            with _naming(path):
                partial.replace(target)
        for folder in {target.parent for _, target in partials.values()}:
            sync(folder)
    finally:
        for partial, _ in partials.values():
            with suppress(OSError):  # the error that is on its way says more
                partial.unlink(missing_ok=True)


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A path to write to: what is there when the context ends without an error gets the name `path`.

    For content that is too large to be held. A link is followed, a device is written as it is.

    Raises:
        OSError: it cannot be written, `filename` is `path`. What was there before is unchanged.
    """
    with _naming(path):
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            yield target
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = _partial(target)
        try:
            partial.touch(exist_ok=False)
            if target.exists():
                shutil.copymode(target, partial)
            yield partial
            sync(partial)
            partial.replace(target)
            sync(target.parent)
        finally:
            partial.unlink(missing_ok=True)


def write_folder(
    folder: Path, files: Mapping[str, bytes], check: Callable[[Path], object] | None = None, mode: int | None = None
) -> None:
    """Write a folder of files, which takes the place of `folder` and of all that was in it.

    `check` is called with the new folder before that, and may raise. With `mode`, of the files, who may read them may
    also look into the folder.

    Raises:
        OSError: it cannot be written; `folder` is as it was. A kill between the two renames of a replacement leaves
            what was there as `.NAME.old-PID`.
    """
    target = Path(os.path.realpath(folder))
    with _naming(folder):
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = _partial(target)
        try:
            partial.mkdir()
            if mode is not None:
                partial.chmod(mode | (mode & 0o444) >> 2)
            for name, content in files.items():
                with _naming(folder / name):
                    _put(partial / name, target / name, content, mode)
            sync(partial)
            if check is not None:
                check(partial)
            _exchange(partial, target)
            sync(target.parent)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def check_file(path: Path) -> None:
    """Raise the OSError now that writing `path` would raise after minutes of computing.

    Nothing is left behind, no folder is made.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not path.exists() or path.is_file():
        _probe(Path(os.path.realpath(path)).parent, path)


def check_folder(folder: Path) -> None:
    """Raise the OSError now that writing into `folder`, which need not exist, would raise; as `check_file`."""
    _probe(folder, folder)


def _probe(folder: Path, target: Path) -> None:
    """Write a block into the nearest folder there is, without a name; an error names it, or a target without room."""
    place = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    try:
        with TemporaryFile(dir=place) as probe:
            probe.write(PROBE)
    except OSError as error:  # its file name is that of the probe
        raise OSError(error.errno, error.strerror, str(target if error.errno in FULL else place)) from error


@contextmanager
def _naming(target: Path) -> Iterator[None]:
    """Name the target in an error that names no file, or the partial: those of write(2) and of rename(2)."""
    try:
        yield
    except OSError as error:
        if error.errno is None or not (error.filename is None or ".partial-" in str(error.filename)):
            raise
        raise OSError(error.errno, error.strerror, str(target)) from error


def _partial(target: Path) -> Path:
    """Return the partial's path, after removing those of processes that are gone: a full disk shall not stay full."""
    stem = f".{target.name}.partial-"
    for path in target.parent.iterdir():
        number = path.name.removeprefix(stem)
        if path.name.startswith(stem) and number.isdecimal() and not _is_running(int(number)):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
    return target.with_name(f"{stem}{os.getpid()}")


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # another user's
        return True
    return process != os.getpid()  # a former process of this number


def _put(partial: Path, target: Path, content: bytes, mode: int | None) -> None:
    with partial.open("xb") as file:
        if mode is not None:
            os.fchmod(file.fileno(), mode)
        elif target.exists():
            shutil.copymode(target, partial)
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _exchange(partial: Path, target: Path) -> None:
    """Give the partial its name; rename(2) replaces no folder that has something in it."""
    if not target.exists():
        partial.rename(target)
        return
    old = target.with_name(f".{target.name}.old-{os.getpid()}")
    target.rename(old)
    try:
        partial.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old)


def put_aside(path: Path, suffixes: Sequence[str] = ("",)) -> Path:
    """Rename a damaged file, and those of its name with `suffixes`, to `NAME.damaged-N`; return the new path.

    Of earlier ones the latest are left. Raises OSError.
    """
    stem = f"{path.name}.damaged-"
    tails = [each.name.removeprefix(stem) for each in path.parent.glob(f"{stem}*")]
    numbers = sorted(int(tail) for tail in tails if tail.isdecimal())
    for number in numbers[: -(ASIDE - 1)]:
        for suffix in suffixes:
            path.with_name(f"{stem}{number}{suffix}").unlink(missing_ok=True)
    aside = path.with_name(f"{stem}{numbers[-1] + 1 if numbers else 1}")
    for suffix in suffixes:
        with suppress(FileNotFoundError):
            path.with_name(f"{path.name}{suffix}").rename(f"{aside}{suffix}")
    return aside


def sync(path: Path) -> None:
    """Put a file, or what a folder says of names, onto the disk (fsync)."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
