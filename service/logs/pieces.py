"""A log's bytes in pieces, unpacked where they are compressed by gzip: no file is held in memory as a whole."""

import codecs
import os
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryFile
from typing import IO
from weakref import finalize

from faultline.service.logs.report import LogError, LogReport

PIECE = 1 << 19
"""Bytes of a piece."""
HEAD = 1 << 16
"""Bytes by which a format is known."""
GZIP = b"\x1f\x8b\x08"
_RESERVED = 0xE0  # bits of the flags behind it, which no file has set
_GZIP_BITS = 16 + zlib.MAX_WBITS
_MOST = 1 << 22  # bytes unpacked at once
_FINE = 64  # packed bytes in which damage is looked for byte by byte


class Source:
    """A log file; its first bytes, unpacked, are `head`. What is no file, as a pipe, is copied to a temporary one.

    Raises:
        LogError: the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._copy: IO[bytes] | None = None
        try:
            if path.exists() and not (path.is_file() or path.is_dir()):
                self._copy = _copied(path)
                finalize(self, self._copy.close)
            with self._open() as file:
                self.size = file.seek(0, os.SEEK_END)
                file.seek(0)
                self.is_compressed = file.read(len(GZIP)) == GZIP
            self.head = next(self._pieces(LogReport(), HEAD), b"")[:HEAD]
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror}") from error

    def pieces(self, report: LogReport) -> Iterator[bytes]:
        """All bytes of the file from its beginning on; what of a compressed one is lost is in the report.

        Raises:
            LogError: the file cannot be read; the message does not name it.
        """
        try:
            yield from self._pieces(report, PIECE)
        except OSError as error:
            raise LogError(f"cannot be read: {error.strerror}") from error

    @contextmanager
    def plain(self, report: LogReport) -> Iterator[Path]:
        """The path of the file, unpacked, for readers that need all of it at any place."""
        if not self.is_compressed and self._copy is None:
            yield self.path
            return
        with NamedTemporaryFile(prefix="faultline-") as file:
            for piece in self.pieces(report):
                file.write(piece)
            file.flush()
            yield Path(file.name)

    def packed(self) -> Iterator[bytes]:
        """All bytes as they are."""
        with self._open() as file:
            while piece := file.read(PIECE):
                yield piece

    def _open(self) -> IO[bytes]:
        if self._copy is None:
            return self.path.open("rb")
        self._copy.seek(0)
        return os.fdopen(os.dup(self._copy.fileno()), "rb")

    def _pieces(self, report: LogReport, size: int) -> Iterator[bytes]:
        with self._open() as file:
            is_packed = self.is_compressed
            yield from _as_utf8(_Unpacking(file, report, size).pieces() if is_packed else _read(file, size))


def _read(file: IO[bytes], size: int) -> Iterator[bytes]:
    while piece := file.read(size):
        yield piece


def _as_utf8(pieces: Iterator[bytes]) -> Iterator[bytes]:
    """Yield the same; text in UTF-16, as Windows' shell and spreadsheets write it behind a mark, in UTF-8."""
    first = next(pieces, b"")
    if not first.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        yield from chain([first] if first else [], pieces)
        return
    decoder = codecs.getincrementaldecoder("utf-16")("replace")
    for piece in chain([first], pieces):
        yield decoder.decode(piece).encode()
    yield decoder.decode(b"", final=True).encode()


def _copied(path: Path) -> IO[bytes]:
    copy = TemporaryFile(prefix="faultline-")  # noqa: SIM115 for as long as the log is open
    with path.open("rb") as file:
        shutil.copyfileobj(file, copy)
    copy.flush()
    return copy


class _Unpacking:
    """State: how far the packed file is read, and how many bytes were unpacked, also before this member.

    Behind damage it goes on with the next member, if there is one. Only a member's end has a checksum: what was
    unpacked of a damaged one is given, as most of it is right, and called doubtful.
    """

    def __init__(self, file: IO[bytes], report: LogReport, size: int) -> None:
        self._file, self._report, self._size = file, report, size
        self._packed = b""
        self._at = 0  # of `_packed`, in the file
        self._unpacked = self._before = 0

    def pieces(self) -> Iterator[bytes]:
        while self._more() and self._next_member():
            unpack = zlib.decompressobj(_GZIP_BITS)
            self._before = self._unpacked
            while not unpack.eof and (self._packed or self._more()):
                before = unpack.copy()
                try:
                    piece = unpack.decompress(self._packed, _MOST)
                except zlib.error:
                    yield from self._until_damage(before)
                    break
                left = unpack.unused_data if unpack.eof else unpack.unconsumed_tail
                self._at += len(self._packed) - len(left)
                self._packed = left
                self._unpacked += len(piece)
                if piece:
                    yield piece
            else:
                if not unpack.eof:
                    self._note(f"it is cut off at byte {self._at}")

    def _more(self) -> bool:
        """True if there are packed bytes."""
        if not self._packed:
            self._packed = self._file.read(self._size)
        return bool(self._packed)

    def _next_member(self) -> bool:
        """Go to where a member begins; what lies before it is padding, or lost."""
        lost = 0
        while True:
            at = self._packed.find(GZIP)
            while 0 <= at < len(self._packed) - len(GZIP) and self._packed[at + len(GZIP)] & _RESERVED:
                at = self._packed.find(GZIP, at + 1)
            gone = at if at >= 0 else max(0, len(self._packed) - len(GZIP))
            lost += len(self._packed[:gone].strip(b"\0"))
            self._at, self._packed = self._at + gone, self._packed[gone:]
            more = b"" if at >= 0 else self._file.read(self._size)
            if at >= 0 or not more:
                break
            self._packed += more
        if at < 0:
            lost += len(self._packed.strip(b"\0"))
            self._packed = b""
        if lost:
            self._note(f"{lost} bytes before byte {self._at} are lost")
        self._report.lost_bytes += lost
        return at >= 0

    def _until_damage(self, unpack: "zlib._Decompress") -> Iterator[bytes]:
        """What can be unpacked before it fails."""
        for step in (_FINE, 1):
            try:
                while self._packed:
                    before = unpack.copy()
                    piece = unpack.decompress(self._packed[:step])
                    self._at, self._packed = self._at + step, self._packed[step:]
                    self._unpacked += len(piece)
                    if piece:
                        yield piece
            except zlib.error:
                unpack = before
        doubtful = f"unpacked bytes {self._before} to {self._unpacked} are doubtful: no checksum proves them"
        self._note(f"it is damaged before byte {self._at}; {doubtful}")
        self._at, self._packed = self._at + 1, self._packed[1:]

    def _note(self, words: str) -> None:
        if not self._report.packing:
            self._report.packing = words
        elif not self._report.packing.endswith("; ..."):
            self._report.packing += "; ..."
