"""Vector's BLF logs; what is damaged costs its container or object, and reading goes on after it.

A file is a header and objects, each of which begins with `LOBJ`; most are containers, compressed by zlib, whose
contents joined are objects again, which may go on from one container to the next. Nothing that a damaged field says
makes this take more than a container's memory, or read a place twice. Source of the layout: python-can, io/blf.py.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from faultline.service.logs.batch import Batch
from faultline.service.logs.blf_objects import BASE, CONTAINER, PADDING, SIGNATURE, Objects, chain, decode, is_object
from faultline.service.logs.channels import Channels
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogReport

_MAGIC = b"LOGG"
_FILE = struct.Struct("<4sL8xQQLL16s16s")  # LOGG, header's size, file's size, uncompressed, objects, read, start, stop
_SYSTEMTIME = struct.Struct("<8H")  # year, month, day of the week, day, hour, minute, second, ms
_METHOD = struct.Struct("<H14x")  # of a container's compression
_STORED = 0  # else deflated
_LARGEST_CONTAINER = 1 << 24  # bytes, uncompressed or not; Vector writes 128 KiB
_BLOCK = 1 << 19  # bytes of objects that are read at once
_LONGEST_HEADER = 4096


class _Object(NamedTuple):
    """An object of `kind` at `begin` of a block, with `header` of its `size` bytes of header."""

    kind: int
    header: int
    begin: int
    size: int

    @property
    def end(self) -> int:
        return self.begin + self.size


def read_blf(source: Source, report: LogReport, channels: Channels) -> Iterator[Batch]:
    """The frames of a log in the file's order."""
    report.unit = "byte"
    window = _Window(source.pieces(report))
    blf = _Blf(window, report, channels)
    yield from blf.batches()
    blf.end()


class _Window:
    """What is in memory of a file, from byte `base` on."""

    def __init__(self, pieces: Iterator[bytes]) -> None:
        self._pieces = pieces
        self.data = b""
        self.base = self.end = 0

    def need(self, end: int) -> None:
        """Have the bytes to `end`, as far as there are so many; `self.end` is behind what there is."""
        if end <= self.end:
            return
        parts, there = [self.data], self.end
        while there < end and (piece := next(self._pieces, b"")):
            parts.append(piece)
            there += len(piece)
        if len(parts) > 1:
            self.data, self.end = b"".join(parts), there

    def drop(self, begin: int) -> None:
        """Forget what is before `begin`."""
        if begin - self.base > len(self.data) // 2:
            self.data, self.base = self.data[begin - self.base :], begin

    def part(self, begin: int, end: int) -> memoryview:
        """Bytes from `begin`, which is in memory, to `end`, as far as they are."""
        return memoryview(self.data)[begin - self.base : end - self.base]


class _Blf:
    """State: the objects of the containers so far that are not complete yet, and how many there were."""

    def __init__(self, window: _Window, report: LogReport, channels: Channels) -> None:
        self._window, self._report, self._channels = window, report, channels
        window.need(_LONGEST_HEADER)
        self._size = self._count = 0
        self._start_s = 0.0
        self._first = self._header()
        self._found = 0
        self._waiting: list[bytes] = []  # bytes of containers
        self._held, self._needed = 0, _BLOCK  # bytes in `_waiting`, and so many before it is read
        self._loose: list[bytes] = []  # objects that are in no container
        self._is_torn = False  # a container is lost: the next one begins within an object
        self._is_cut = False  # the last container is not whole
        self._place = 0  # of the first container that waits

    def _header(self) -> int:
        """Read the file's header; where the objects begin."""
        data = self._window.data
        if len(data) < _FILE.size or not data.startswith(_MAGIC):
            self._report.reject(0, "it does not begin as a BLF file")
            return 0
        _, header, self._size, _, self._count, _, start, stop = _FILE.unpack_from(data)
        self._start_s, stop_s = _unix(start), _unix(stop)
        if self._start_s and stop_s > self._start_s:
            self._report.said_s = stop_s - self._start_s
        return header if _FILE.size <= header <= _LONGEST_HEADER else _FILE.size

    def batches(self) -> Iterator[Batch]:
        """Of all objects. What follows damage is searched for the next object."""
        at = self._first
        while (found := self._next(at)) is not None:
            self._window.drop(found.begin)
            if found.kind == CONTAINER:
                if self._loose:
                    yield from self._flushed()
                data, at = self._unpacked(found)
                if data is None:
                    yield from self._torn()
                elif self._add(data, found.begin) >= self._needed:
                    yield from self._read()
                continue
            self._window.need(found.end + PADDING)
            if found.end > self._window.end:
                self._report.reject(found.begin, "an object reaches beyond the end", self._window.end - found.begin)
                at = found.begin + len(SIGNATURE)
            else:
                at = found.end
                self._loose.append(
                    bytes(self._window.part(found.begin, found.end)).ljust(-(-found.size // 4) * 4, b"\0")
                )
                if len(self._loose) > _BLOCK // 64:
                    yield from self._flushed()
        yield from self._flushed()
        yield from self._read()

    def end(self) -> None:
        """Compare what was there with what the header says."""
        there = self._window.end
        if self._report.missing:
            return
        if self._size > there:
            self._report.missing = f"its header says {self._size} bytes, it has {there}"
        elif self._count > self._found:
            self._report.missing = f"its header counts {self._count} objects, it has {self._found}"
        elif self._count == 0 and self._size != there:
            self._report.missing = "its logger did not close it"
        elif self._is_cut or b"".join(self._waiting).strip(b"\0"):
            self._report.missing = "its last object is incomplete"

    def _next(self, at: int) -> _Object | None:
        """The next object of the file from `at` on, which may end beyond it; before it is padding, or damage."""
        while True:
            begin = self._found_at(at)
            if begin is None:
                return None
            _, header, _, size, kind = BASE.unpack_from(self._window.data, begin - self._window.base)
            if is_object(kind, header, size):
                return _Object(kind, header, begin, size)
            self._report.reject(begin, f"an object says {size} bytes, {header} of them header", BASE.size)
            at = begin + len(SIGNATURE)

    def _found_at(self, at: int) -> int | None:
        """Where the next signature is from `at` on, None where no object can begin there."""
        window = self._window
        window.need(at + BASE.size)
        if window.data.startswith(SIGNATURE, at - window.base) and at + BASE.size <= window.end:
            return at
        begin = window.data.find(SIGNATURE, at - window.base) + window.base
        while begin < window.base:
            keep = max(at, window.end - len(SIGNATURE) + 1)
            self._between(at, keep)
            window.drop(keep)
            before = window.end
            window.need(before + 1)
            if window.end == before:
                self._between(keep, before)
                return None
            at = keep
            begin = window.data.find(SIGNATURE, at - window.base) + window.base
        self._between(at, begin)
        window.need(begin + BASE.size)
        return begin if begin + BASE.size <= window.end else None

    def _between(self, begin: int, end: int) -> None:
        """Bytes that are no object: padding, or damage."""
        between = self._window.part(begin, end)
        if len(between) > PADDING or bytes(between).strip(b"\0"):
            self._report.reject(begin, f"{len(between)} bytes are no object", len(between))

    def _unpacked(self, found: _Object) -> tuple[bytes | None, int]:
        """The contents of a container, None of one that is damaged, and where to go on."""
        begin = found.begin + found.header + _METHOD.size
        end = min(found.end, begin + _LARGEST_CONTAINER)
        self._window.need(end + PADDING)
        there = min(end, self._window.end)
        if begin <= there:
            (method,) = _METHOD.unpack(self._window.part(begin - _METHOD.size, begin))
            packed = self._window.part(begin, there)
            if method == _STORED:
                return bytes(packed), there
            unzip = zlib.decompressobj()
            try:
                data = unzip.decompress(packed, _LARGEST_CONTAINER)
            except zlib.error:
                data = b""
            if unzip.eof:
                return data, there - len(unzip.unused_data)
            if data and found.end > self._window.end and not unzip.unconsumed_tail:
                self._is_cut = True
                return data, there
        whole = self._window.part(found.end, found.end + 4) == SIGNATURE or found.end == self._window.end
        self._report.reject(found.begin, "a container is damaged", found.size if whole else len(SIGNATURE))
        return None, found.end if whole else found.begin + len(SIGNATURE)

    def _flushed(self) -> Iterator[Batch]:
        """The frames of objects that are in no container."""
        block, self._loose = b"".join(self._loose), []
        yield from self._frames(block, chain(block), self._window.base)

    def _add(self, data: bytes, place: int) -> int:
        """Let the content of the container at `place` wait; return how many bytes do."""
        if self._is_torn and data:
            begin = data.find(SIGNATURE)
            data, self._is_torn = data[begin:] if begin > 0 else data, False
        if self._held < BASE.size:
            self._place = place
        self._waiting.append(data)
        self._held += len(data)
        return self._held

    def _torn(self) -> Iterator[Batch]:
        """The frames of what waited; what is incomplete of it is lost with the container that is."""
        yield from self._read()
        self._waiting, self._held, self._needed, self._is_torn = [], 0, _BLOCK, True

    def _read(self) -> Iterator[Batch]:
        """The frames of what waits; what is incomplete goes on waiting."""
        block = b"".join(self._waiting)
        objects = chain(block)
        at = int(objects.begin[-1] + objects.size[-1]) if len(objects.begin) else 0
        walked, rest = self._walked(block, at)
        yield from self._frames(block, Objects(*map(np.concatenate, zip(objects, walked, strict=True))), self._place)
        self._waiting, self._held = [rest], len(rest)
        size = BASE.unpack_from(rest)[3] if len(rest) >= BASE.size and rest.startswith(SIGNATURE) else 0
        self._needed = max(_BLOCK, size)

    def _walked(self, block: bytes, at: int) -> tuple[Objects, bytes]:
        """The objects from `at` on, one by one, with what is between them reported; and what is incomplete."""
        found: list[tuple[int, int, int, int]] = []
        while True:
            begin = block.find(SIGNATURE, at)
            between = block[at : len(block) if begin < 0 else begin]
            goes_on = begin < 0 and len(between) < BASE.size
            if not goes_on and (len(between) > PADDING or between.strip(b"\0")):
                self._report.reject(self._place, f"{len(between)} bytes are no object", len(between))
            if begin < 0 or begin + BASE.size > len(block):
                rest = block[max(at, len(block) - BASE.size + 1) :] if begin < 0 else block[begin:]
                break
            _, header, _, size, kind = BASE.unpack_from(block, begin)
            if not is_object(kind, header, size) or kind == CONTAINER:
                self._report.reject(self._place, f"an object says {size} bytes, {header} of them header", BASE.size)
                at = begin + len(SIGNATURE)
                continue
            if begin + size > len(block):
                rest = block[begin:]
                break
            found.append((begin, kind, header, size))
            at = begin + size
        columns = np.array(found, dtype=np.int64).reshape(-1, 4).T
        return Objects(*columns), rest

    def _frames(self, block: bytes, objects: Objects, place: int) -> Iterator[Batch]:
        """The frames of objects."""
        decoded = decode(block, objects, self._start_s)
        self._found += len(objects.begin)
        self._report.others += decoded.others
        for k in decoded.bad:
            self._report.reject(place, "an object is no frame", int(objects.size[k]))
        numbers = np.flatnonzero(np.bincount(decoded.channels))
        index = np.array([self._channels.index(str(each).encode()) for each in numbers.tolist()], dtype=np.uint8)
        if len(decoded.frames):
            yield replace(decoded.frames, channel=index[np.searchsorted(numbers, decoded.channels)])


def _unix(systemtime: bytes) -> float:
    """A time of the header [s since 1970], in UTC as python-can takes it; 0 where it has none."""
    year, month, _, day, hour, minute, second, ms = _SYSTEMTIME.unpack(systemtime)
    try:
        return datetime(year, month, day, hour, minute, second, 1000 * ms, tzinfo=UTC).timestamp()
    except ValueError:
        return 0.0
