"""Reads Vector's BLF logs; what is damaged costs its container or object, and reading goes on after it.

A file is a header and objects, each of which begins with `LOBJ`; most are containers, compressed by zlib, whose
contents joined are objects again, which may go on from one container to the next. Nothing that a damaged field says
makes this take more than a container's memory, or read a place twice. Source of the layout: python-can, io/blf.py.
"""

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from typing import NamedTuple

from faultline.service.logs.report import Frame, LogReport, OnChannel

_SIGNATURE = b"LOBJ"
_FILE = struct.Struct("<4sL8xQQLL16s16s")  # LOGG, header's size, file's size, uncompressed, objects, read, start, stop
_SYSTEMTIME = struct.Struct("<8H")  # year, month, day of the week, day, hour, minute, second, ms
_BASE = struct.Struct("<4sHHLL")  # signature, header's size, its version, object's size, kind
_TIMED = struct.Struct("<L4xQ")  # flags, time; behind `_BASE` in both versions of the header
_METHOD = struct.Struct("<H14x")  # of a container's compression
_CLASSIC = struct.Struct("<HBBL8s")  # channel, flags, length code, identifier, data
_FD = struct.Struct("<HBBLLBBB5x")  # channel, flags, code, identifier, length, bits, FD flags, bytes of data
_FD64 = struct.Struct("<BBBBLLLLLLLHBBL")  # channel, code, bytes, _, identifier, _, flags, ..., offset of what follows

_CONTAINER = 10
_KINDS_ERROR = (2, 73, 104)
_OF_CAN = frozenset((1, 86, 100, 101, *_KINDS_ERROR))
_STORED = 0  # else deflated
_TEN_MICROSECONDS = 1  # flags of a time; else nanoseconds
_REMOTE, _REMOTE_FD64 = 0x80, 0x10
_EXTENDED = 0x8000_0000
_IDENTIFIER = 0x1FFF_FFFF
_LONGEST_CODE, _LONGEST_FD = 15, 64

_TIMED_HEADER = _BASE.size + _TIMED.size  # bytes of the header of an object with a time
_LARGEST_CAN, _LARGEST = 512, 1 << 20  # bytes of an object: what says more is damaged
_LARGEST_CONTAINER = 1 << 24  # bytes, uncompressed; Vector writes 128 KiB
_PADDING = 7  # bytes between two objects


class _Object(NamedTuple):
    """An object of `kind` at `data[begin:end]`, with `header` bytes of header."""

    kind: int
    header: int
    begin: int
    end: int


def read_blf(content: bytes, report: LogReport) -> Iterator[OnChannel]:
    """The data frames of a log in the file's order."""
    report.unit = "byte"
    if len(content) < _FILE.size or content[:4] != b"LOGG":
        report.missing = "it does not begin as a BLF file"
        return
    blf = _Blf(content, report)
    yield from blf.frames()
    blf.end()


class _Blf:
    """State: the objects of the containers so far that are not complete yet, and how many there were."""

    def __init__(self, content: bytes, report: LogReport) -> None:
        self._content, self._report = content, report
        _, self._header, self._size, _, self._count, _, start, stop = _FILE.unpack_from(content)
        self._start_s, stop_s = _unix(start), _unix(stop)
        if self._start_s and stop_s > self._start_s:
            report.said_s = stop_s - self._start_s
        self._found = 0
        self._waiting: list[bytes] = []
        self._held, self._needed = 0, 0  # bytes in `_waiting`, and so many before it is worth a look
        self._is_torn = False  # a container is lost: the next one begins within an object
        self._is_cut = False  # the last container is not whole

    def frames(self) -> Iterator[OnChannel]:
        """Of all objects. What follows damage is searched for the next object."""
        content, at = self._content, self._header
        while (found := self._next(content, at, None)) is not None:
            if found.kind == _CONTAINER:
                data, at = self._unpacked(found)
                yield from self._joined(data, found.begin)
            elif found.end > len(content):
                self._report.reject(found.begin, "an object reaches beyond the end")
                at = found.begin + len(_SIGNATURE)
            else:
                at = found.end
                yield from self._taken(content, found, found.begin)

    def end(self) -> None:
        """Compares what was there with what the header says."""
        there = len(self._content)
        if self._size > there:
            self._report.missing = f"its header says {self._size} bytes, it has {there}"
        elif self._count > self._found:
            self._report.missing = f"its header counts {self._count} objects, it has {self._found}"
        elif self._count == 0 and self._size != there:
            self._report.missing = "its logger did not close it"
        elif self._is_cut or b"".join(self._waiting).strip(b"\0"):
            self._report.missing = "its last object is incomplete"

    def _next(self, data: bytes, at: int, place: int | None) -> _Object | None:
        """The next object from `at` on, which may end beyond the data; None where nothing follows.

        What lies before it is padding, or damage: at `place` of the file, or at `at` where the data is the file.
        """
        while True:
            begin = data.find(_SIGNATURE, at)
            between = data[at : len(data) if begin < 0 else begin]
            may_go_on = begin < 0 and place is not None and len(between) < _BASE.size
            if not may_go_on and (len(between) > _PADDING or between.strip(b"\0")):
                self._report.reject(at if place is None else place, f"{len(between)} bytes are no object")
            if begin < 0 or begin + _BASE.size > len(data):
                return None
            _, header, _, size, kind = _BASE.unpack_from(data, begin)
            least, largest = (_TIMED_HEADER, _LARGEST_CAN) if kind in _OF_CAN else (_BASE.size, _LARGEST)
            if least <= header <= size and (size <= largest or kind == _CONTAINER):
                return _Object(kind, header, begin, begin + size)
            where = begin if place is None else place
            self._report.reject(where, f"an object says {size} bytes, {header} of them header")
            at = begin + len(_SIGNATURE)

    def _unpacked(self, found: _Object) -> tuple[bytes, int]:
        """The contents of a container, and where to go on; nothing of one that is damaged."""
        content = self._content
        begin = found.begin + found.header + _METHOD.size
        if begin <= min(found.end, len(content)):
            (method,) = _METHOD.unpack_from(content, begin - _METHOD.size)
            if method == _STORED:
                return content[begin : found.end], found.end
            unzip = zlib.decompressobj()
            try:
                data = unzip.decompress(memoryview(content)[begin : found.end], _LARGEST_CONTAINER)
            except zlib.error:
                data = b""
            if unzip.eof:
                return data, min(found.end, len(content)) - len(unzip.unused_data)
            if data and found.end > len(content) and not unzip.unconsumed_tail:
                self._is_cut = True
                return data, len(content)
        self._report.reject(found.begin, "a container is damaged")
        self._waiting, self._held, self._needed, self._is_torn = [], 0, 0, True
        whole = content.startswith(_SIGNATURE, found.end) or found.end == len(content)
        return b"", found.end if whole else found.begin + len(_SIGNATURE)

    def _joined(self, data: bytes, place: int) -> Iterator[OnChannel]:
        """The frames of what waited and `data`, of the container at `place`; what is incomplete waits."""
        self._waiting.append(data)
        self._held += len(data)
        if self._held < self._needed:
            return
        data, at, self._needed = b"".join(self._waiting), 0, 0
        if data and self._is_torn:
            at, self._is_torn = max(0, data.find(_SIGNATURE)), False
        while (found := self._next(data, at, place)) is not None:
            if found.end > len(data):
                at, self._needed = found.begin, found.end - found.begin
                break
            at = found.end
            yield from self._taken(data, found, place)
        rest = data[at:] if self._needed else data[max(at, len(data) - _BASE.size + 1) :]
        self._waiting, self._held = [rest], len(rest)

    def _taken(self, data: bytes, found: _Object, place: int) -> Iterator[OnChannel]:
        """The frame of an object that holds one."""
        self._found += 1
        if found.kind in _KINDS_ERROR:
            self._report.errors += 1
        elif found.kind not in _OF_CAN:
            self._report.others += 1
        else:
            flags, ticks = _TIMED.unpack_from(data, found.begin + _BASE.size)
            t = self._start_s + ticks / (1e5 if flags == _TEN_MICROSECONDS else 1e9)
            body = data[found.begin + found.header : found.end]
            try:
                channel, identifier, is_remote, payload = _READERS[found.kind](body)
            except (struct.error, ValueError):
                self._report.reject(place, "an object is no frame")
                return
            if is_remote:
                self._report.remote += 1
            else:
                frame = Frame(t, identifier & _IDENTIFIER, bool(identifier & _EXTENDED), payload)
                yield str(channel).encode(), frame


_Can = tuple[int, int, bool, bytes]
"""Channel, identifier with its flag of 29 bits, whether it is a remote frame, data."""


def _classic(body: bytes) -> _Can:
    channel, flags, code, identifier, data = _CLASSIC.unpack_from(body)
    if code > _LONGEST_CODE:
        raise ValueError
    return channel, identifier, bool(flags & _REMOTE), data[:code]


def _fd(body: bytes) -> _Can:
    channel, flags, _, identifier, *_, length = _FD.unpack_from(body)
    data = body[_FD.size : _FD.size + length]
    if not length == len(data) <= _LONGEST_FD:
        raise ValueError
    return channel, identifier, bool(flags & _REMOTE), data


def _fd64(body: bytes) -> _Can:
    """What is not stored of the data is zero, as CANoe reads it."""
    channel, _, length, _, identifier, _, flags, *_, behind, _ = _FD64.unpack_from(body)
    if length > _LONGEST_FD:
        raise ValueError
    stored = body[_FD64.size : behind - _TIMED_HEADER if behind else None][:length]
    return channel, identifier, bool(flags & _REMOTE_FD64), stored.ljust(length, b"\0")


_READERS: Mapping[int, Callable[[bytes], _Can]] = {1: _classic, 86: _classic, 100: _fd, 101: _fd64}


def _unix(systemtime: bytes) -> float:
    """A time of the header [s since 1970], in UTC as python-can takes it; 0 where it has none."""
    year, month, _, day, hour, minute, second, ms = _SYSTEMTIME.unpack(systemtime)
    try:
        return datetime(year, month, day, hour, minute, second, 1000 * ms, tzinfo=UTC).timestamp()
    except ValueError:
        return 0.0
