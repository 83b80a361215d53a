"""The drives of a fleet: recordings and log files under folders and globs, on any file system that fsspec opens."""

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

from fsspec.core import url_to_fs

from faultline.service.core.errors import InputError
from faultline.service.logs import Log
from faultline.service.logs.recording import FILE

ENDINGS = frozenset({".log", ".asc", ".blf", ".trc", ".mf4", ".parquet", ".csv", ".db"})
"""Of log files, before a `.gz`, where a folder is searched; a file that is named itself may have any."""

VEHICLE = "{vehicle}"
"""In paths and arguments: the name of a vehicle, as in the names of folders (`safe`)."""

EPOCH_S = 1e8
"""From here on times of a log are wall clock: seconds since 1970, of 1973 or later."""


@dataclass(frozen=True)
class Drive:
    """A recording's folder or a log file: its address, and its size in bytes."""

    url: str
    size: int
    is_folder: bool

    @property
    def folder_name(self) -> str:
        """The name of the folder that it lies in."""
        return PurePosixPath(self.url.partition("::")[0]).parent.name


def find_drives(given: Iterable[str]) -> list[Drive]:
    """Return the drives under these paths, globs and URLs, each once, in the order of their addresses.

    Raises:
        InputError: there is none under one of them, or it cannot be reached.
    """
    found: dict[str, Drive] = {}
    for text in given:
        try:
            there = list(_found(text))
        except (OSError, ValueError, ImportError) as error:
            raise InputError(f"{text}: {error}; give a folder, a file, a glob or a URL of recordings") from error
        if not there:
            raise InputError(f"{text}: no recording and no log file is there; give folders that have some")
        found |= {drive.url: drive for drive in there}
    return [found[url] for url in sorted(found)]


def _found(text: str) -> Iterator[Drive]:
    fs, path = url_to_fs(text)
    path = os.path.normpath(path) if _is_local(fs) else path
    behind = text[text.index("::") :] if "::" in text else ""  # as of a file in an archive
    for place in fs.glob(path) if any(mark in path for mark in "*?[") else [path]:
        if fs.isfile(place):
            yield Drive(_address(fs, place, behind), fs.size(place) or 0, is_folder=False)
        else:
            yield from _within(fs, place, behind)


def _within(fs: Any, folder: str, behind: str) -> Iterator[Drive]:
    """Recordings in a folder and below it, and log files outside them."""
    files = fs.find(folder, detail=True)
    split = (path.rpartition("/") for path in files)
    recordings = {place for place, _, name in split if name == FILE}
    for recording in sorted(recordings):
        size = sum(info["size"] for path, info in files.items() if path.startswith(f"{recording}/"))
        yield Drive(_address(fs, recording, behind), size, is_folder=True)
    for path, info in sorted(files.items()):
        apart = not any(path.startswith(f"{recording}/") for recording in recordings)
        if apart and Path(path.removesuffix(".gz")).suffix.lower() in ENDINGS:
            yield Drive(_address(fs, path, behind), info["size"], is_folder=False)


def _is_local(fs: Any) -> bool:
    return "file" in (fs.protocol if isinstance(fs.protocol, tuple) else (fs.protocol,))


def _address(fs: Any, path: str, behind: str) -> str:
    return f"{fs.unstrip_protocol(path)}{behind}"


@contextmanager
def at_hand(drive: Drive) -> Iterator[Path]:
    """The drive as a local path: itself, or a copy for as long as the context lasts."""
    fs, path = url_to_fs(drive.url)
    if _is_local(fs):
        yield Path(path)
        return
    folder = Path(tempfile.mkdtemp(prefix="faultline-"))
    try:
        local = folder / PurePosixPath(path).name
        fs.get(path, str(local), recursive=drive.is_folder)
        yield local
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def digest(path: Path) -> str:
    """Return what stands for the content of a file, or of all files of a folder (SHA-256, hexadecimal)."""
    whole = hashlib.sha256()
    files = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    for file in files:
        whole.update(f"{file.relative_to(path) if path.is_dir() else ''}\0{file.stat().st_size}\0".encode())
        with file.open("rb") as opened:
            while block := opened.read(1 << 20):
                whole.update(block)
    return whole.hexdigest()


def start_of(log: Log) -> datetime | None:
    """Return the wall clock at the log's first frame (UTC), by its recording or its own times; None if neither says."""
    if log.recording is not None and log.recording.start is not None:
        start = log.recording.start
        return start.replace(tzinfo=UTC) if start.tzinfo is None else start.astimezone(UTC)
    return datetime.fromtimestamp(log.start_s, UTC) if log.start_s >= EPOCH_S else None


def safe(vehicle: str) -> str:
    """Return a vehicle's name as it is in names of folders.

    >>> safe("truck 7/b")
    'truck%207%2Fb'
    """
    return quote(vehicle, safe="")


def date_of(start: datetime | None) -> date | None:
    """The day of a drive, if it is known."""
    return None if start is None else start.date()
