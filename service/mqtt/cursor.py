"""Cursor file: how far the broker has acknowledged; all that is left of this process when it is killed.

Replaced as a whole, on the disk before it counts (fsync of the file and of its folder). One line of JSON and the CRC of
that line, so that what is damaged is not believed.
"""

import errno
import fcntl
import os
import zlib
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.errors import InputError
from faultline.writing import put_aside, write_file

VERSION = 1
LARGEST = 1 << 20  # bytes

_ANEW = "beginning with the oldest record there is"

_Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]


class Cursor(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Cursor: the last record that is done (None, 0: none yet), the number of lost ones, and who is where.

    `faults` are those with a retained state at the broker; `vehicle` the name in the topics.
    """

    id: str | None = None
    seq: _Count = 0
    lost: _Count = 0
    vehicle: str | None = None
    faults: list[_Count] = []


class _File(msgspec.Struct, frozen=True, kw_only=True):
    version: int
    cursor: msgspec.Raw


class _Version(msgspec.Struct):
    version: int


class CursorFile:
    """The file at `path`; of one process at a time.

    Raises:
        InputError: its folder is not there or cannot be written, or another process has it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = _locked(path)

    def close(self) -> None:
        """Release the lock."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def load(self) -> tuple[Cursor, str]:
        """Return the cursor, or the beginning; and the error of a damaged file, which is put aside."""
        try:
            with self._path.open("rb") as file:
                content = file.read(LARGEST + 1)
        except FileNotFoundError:
            return Cursor(), ""
        except OSError as error:
            return Cursor(), f"{self._path}: cannot be read: {error.strerror}; {_ANEW}"
        try:
            return _decoded(content), ""
        except ValueError as error:
            return Cursor(), f"{self._path}: {error}; {self._put_aside()}; {_ANEW}"

    def save(self, cursor: Cursor) -> None:
        """Save it; on return it is on the disk. Raises OSError where it is not, and what was kept before is."""
        write_file(self._path, _encoded(cursor), 0o600)

    def _put_aside(self) -> str:
        try:
            return f"it is now {put_aside(self._path)}"
        except OSError as error:
            return f"it cannot be put aside: {error.strerror}"


def _encoded(cursor: Cursor) -> bytes:
    line = msgspec.json.encode(_File(version=VERSION, cursor=msgspec.Raw(msgspec.json.encode(cursor))))
    return b"%s\n%08x\n" % (line, zlib.crc32(line))


def _decoded(content: bytes) -> Cursor:
    """Decode a cursor; raises ValueError if it is damaged or of a newer version."""
    line, _, check = content.partition(b"\n")
    if check != b"%08x\n" % zlib.crc32(line):
        raise ValueError("is damaged")
    try:
        version = msgspec.json.decode(line, type=_Version).version
        if version > VERSION:
            raise ValueError(f"is of a newer faultline (version {version}, this one knows {VERSION})")
        return msgspec.json.decode(msgspec.json.decode(line, type=_File).cursor, type=Cursor)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise ValueError(f"is no cursor: {error}") from error


def _locked(path: Path) -> int | None:
    """Lock a file beside it; None on a disk that takes no new file now, which may come back."""
    try:
        lock = os.open(path.with_name(f"{path.name}.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO):
            return None
        raise InputError(
            f"{path}: cannot be kept there: {error.strerror}; make the folder, or give another `cursor`"
        ) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        raise InputError(
            f"{path}: another faultline mqtt uses it; stop that one, or give each its own `cursor`"
        ) from error
    return lock
