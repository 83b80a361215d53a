"""A log's bytes in pieces, unpacked where they are compressed by gzip: no file is held in memory as a whole."""

import hashlib
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from faultline.service.logs.report import LogError, LogReport

PIECE = 1 << 20
"""Bytes of a piece."""
GZIP = b"\x1f\x8b\x08"
_GZIP_BITS = 16 + zlib.MAX_WBITS
_MOST = 4  # times as much as was read is unpacked at once


class Source:
    """A log file. `head` are its first bytes, unpacked; `sha256` is of the file as it is, once all was read."""

    def __init__(self, path: Path) -> None:
        """Raises `LogError` where the file cannot be read."""
        self.path = path
        self._hash = hashlib.sha256()
        try:
            with path.open("rb") as file:
                self.is_compressed = file.read(len(GZIP)) == GZIP
            self.head = next(self._pieces(LogReport(), 1 << 12), b"")
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror}") from error

    @property
    def sha256(self) -> str:
        """Of the bytes that were read."""
        return self._hash.hexdigest()

    def pieces(self, report: LogReport) -> Iterator[bytes]:
        """All bytes of the file from its beginning on; what of a compressed one is lost is in the report.

        Raises:
            LogError: the file cannot be read.
        """
        self._hash = hashlib.sha256()
        try:
            yield from self._pieces(report, PIECE)
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}") from error

    def _pieces(self, report: LogReport, size: int) -> Iterator[bytes]:
        with self.path.open("rb") as file:
            yield from self._unpacked(file, report, size) if self.is_compressed else self._read(file, size)

    def _read(self, file: BinaryIO, size: int) -> Iterator[bytes]:
        while piece := file.read(size):
            self._hash.update(piece)
            yield piece

    def _unpacked(self, file: BinaryIO, report: LogReport, size: int) -> Iterator[bytes]:
        """Of all members of the file; one that is damaged ends it, as nothing says where the next begins."""
        unpack, at = None, 0
        for packed in self._read(file, size):
            at += len(packed)
            while packed:
                unpack = unpack or zlib.decompressobj(_GZIP_BITS)
                before = unpack.copy()
                try:
                    piece = unpack.decompress(packed, _MOST * size)
                except zlib.error:
                    yield (piece := _until_damage(before, packed))
                    report.missing = f"its compression is damaged within the {size} bytes before byte {at}"
                    for _ in self._read(file, size):  # the hash is of all bytes
                        pass
                    return
                if piece:
                    yield piece
                packed = unpack.unused_data.lstrip(b"\0") if unpack.eof else unpack.unconsumed_tail
                unpack = None if unpack.eof else unpack
        if unpack is not None:
            report.missing = "its compression is cut off"


def _until_damage(unpack: "zlib._Decompress", packed: bytes) -> bytes:
    """What can be unpacked byte by byte before it fails."""
    found = bytearray()
    try:
        for k in range(len(packed)):
            found += unpack.decompress(packed[k : k + 1])
    except zlib.error:
        pass
    return bytes(found)
