"""The tree of blocks of an ordinary MF4 log: bus events of fixed length, a group each, finished by their logger.

Of such a file (ASAM MDF 4, sorted) the tree has a header, data groups, a channel group in each with its channels, and
the blocks of the group's records, which may be compressed. Everything that is more than that is odd: records of several
groups mixed (unsorted), of variable length, with invalidation bits, by columns, or of other compressions.
"""

import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.batch import Bytes
from faultline.service.logs.mf4_frames import KINDS

_BLOCK = struct.Struct("<4s4xQQ")  # name, length, number of links
_HEADER = 64  # byte of the first block
_BLOCKS = 1_000_000  # of a file that are looked at
_LARGEST = 1 << 20  # bytes of a block that is no data
_UNPACKED = 1 << 28  # bytes of a compressed block; loggers write 4 MiB
_UNFINISHED = struct.Struct("<60xHH")  # what its logger has not finished
_START = struct.Struct("<Q4xB")  # ns since 1970, flags
_GROUP = struct.Struct("<8xQH6xII")  # records, flags, bytes, bytes of invalidation bits
_CHANNEL = struct.Struct("<BBBBII")  # kind, synchronisation, type, first bit, first byte, bits
_CONVERSION = struct.Struct("<B23x2d")  # kind, offset, factor
_PACKED = struct.Struct("<2sBxIQQ")  # of which block, how, columns, unpacked bytes, packed bytes
_LIST = struct.Struct("<B3xI")  # flags, number of blocks

_PLAIN_GROUP = 0x6  # flags of a group that may be set: bus events
_VALUE, _MASTER, _LONGEST = 0, 2, 5  # kinds of channels: a value, the time, a value of at most so many bytes
_TIME = 1  # synchronisation
_TYPES = {0: "<u", 1: ">u", 2: "<i", 3: ">i", 4: "<f", 5: ">f"}
_BYTES = 10  # type
_LOCAL = 1  # flag of a start time without a zone
_EQUAL = 1  # flag of a list of blocks of equal length
DEFLATE, TRANSPOSED = 0, 1
_PARTS = frozenset(("ID", "IDE", "EDL", "Dir", "DataLength", "DLC", "DataBytes", "BusChannel"))


class OddError(Exception):
    """The file has what is not read here."""


class Field(NamedTuple):
    """A part of a record: its first byte and bit, and how many bits; a number unless `is_bytes`."""

    byte: int
    bit: int
    bits: int
    is_big: bool
    is_bytes: bool

    @property
    def end(self) -> int:
        """The byte beyond its last one."""
        return self.byte - (-(self.bit + self.bits) // 8)

    def read(self, records: Bytes) -> npt.NDArray[Any]:
        """Numbers (N,), or bytes (N, W)."""
        raw = records[:, self.byte : self.end]
        if self.is_bytes:
            return raw
        if (self.bit, self.bits) == (0, 8):
            return raw[:, 0]
        wide = np.zeros((len(records), 8), np.uint8)
        wide[:, : raw.shape[1]] = raw[:, ::-1] if self.is_big else raw
        number = wide.view("<u8")[:, 0] >> np.uint64(self.bit) & np.uint64((1 << self.bits) - 1)
        return number.astype(np.uint32)


class Time(NamedTuple):
    """The time of a record [s]: `offset` and `factor` times the number of this type at a byte."""

    byte: int
    type: str
    factor: float
    offset: float

    def read(self, records: Bytes) -> FloatArray:
        """Times (N,)."""
        size = np.dtype(self.type).itemsize
        raw = np.ascontiguousarray(records[:, self.byte : self.byte + size])
        time = raw.view(self.type)[:, 0].astype(np.float64)
        return time if (self.factor, self.offset) == (1.0, 0.0) else time * self.factor + self.offset


class Piece(NamedTuple):
    """Some of a group's bytes: their first and number in the group, where they are, and how they are packed."""

    begin: int
    size: int
    at: int
    stored: int
    packing: int | None = None
    columns: int = 0


class Group(NamedTuple):
    """The frames of one of `KINDS`: `records` of `size` bytes."""

    kind: str
    records: int
    size: int
    time: Time
    fields: Mapping[str, Field]
    pieces: Sequence[Piece]


def tree(path: Path) -> tuple[float, list[Group]]:
    """Return when an ordinary log began [s since 1970], and its groups of frames.

    Raises:
        OddError: it is none.
    """
    with path.open("rb") as file:
        try:
            return _Blocks(file).tree()
        except (IndexError, OverflowError, ValueError, struct.error) as error:  # a block has too little in it
            raise OddError(str(error)) from error


class _Blocks:
    """The blocks of a file, each looked at once. All raise `OddError`, or `struct.error` where one is too short."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._size = file, file.seek(0, os.SEEK_END)
        self._seen: set[int] = set()

    def tree(self) -> tuple[float, list[Group]]:
        """When the log began [s since 1970], and its groups of frames."""
        self._file.seek(0)
        identity = self._file.read(_HEADER)
        if identity.startswith(b"UnFinMF") and any(_UNFINISHED.unpack(identity)):
            raise OddError("not finished")
        (at, *_), data = self._block(_HEADER, b"##HD")
        groups = []
        while at:
            (at, of, records, *_), raw = self._block(at, b"##DG")
            group = self._group(of, records) if of else None
            if raw[0]:
                raise OddError("records of several groups are mixed")
            groups += [group] if group is not None else []
        return _started(data), groups

    def _group(self, at: int, records: int) -> Group | None:
        """A group of frames; None of one that has others."""
        (another, of, *_), data = self._block(at, b"##CG")
        count, flags, size, invalid = _GROUP.unpack_from(data)
        channels = [*self._channels(of)]
        kind = next((name for name, *_ in channels if name in KINDS), None)
        if another:
            raise OddError("records of several groups are mixed")
        if kind is None or not (count or records):
            return None
        time = [self._time(links, raw) for _, links, raw in channels if raw[0] == _MASTER and raw[1] == _TIME]
        part = next(links[1] for name, links, _ in channels if name == kind)
        fields = {
            name: _field(raw) for full, _, raw in self._channels(part) if (name := full.rpartition(".")[2]) in _PARTS
        }
        needed = {"ID"} | ({"DataBytes"} if kind == "CAN_DataFrame" else set())
        if flags & ~_PLAIN_GROUP or invalid or len(time) != 1 or not needed <= fields.keys():
            raise OddError("a group of another kind")
        ends = [field.end for field in fields.values()] + [time[0].byte + np.dtype(time[0].type).itemsize]
        if max(ends) > size:
            raise OddError("a record is too short")
        return Group(kind, count, size, time[0], fields, [*self._pieces(records)])

    def _channels(self, at: int) -> Iterator[tuple[str, Sequence[int], bytes]]:
        """Name, links and contents of each channel of a chain."""
        while at:
            links, data = self._block(at, b"##CN")
            _, name = self._block(links[2], b"##TX", again=True)
            yield name.partition(b"\0")[0].decode(errors="replace"), links, data
            at = links[0]

    def _time(self, links: Sequence[int], data: bytes) -> Time:
        _, _, kind, bit, byte, bits = _CHANNEL.unpack_from(data)
        if kind not in _TYPES or bit or bits not in (32, 64):
            raise OddError("a time of another type")
        offset, factor = 0.0, 1.0
        if links[4]:
            _, raw = self._block(links[4], b"##CC", again=True)
            if raw[0] == 1:
                _, offset, factor = _CONVERSION.unpack_from(raw)
            elif raw[0]:
                raise OddError("a time with another conversion")
        return Time(byte, f"{_TYPES[kind]}{bits // 8}", factor, offset)

    def _pieces(self, at: int) -> Iterator[Piece]:
        """Where the records are. The list of them ends where it is damaged."""
        name, _, links = self._head(at) if at else (b"", 0, ())
        if name == b"##HL":
            yield from self._pieces(links[0])
            return
        if name != b"##DL":
            yield from self._piece(at, 0) if at else ()
            return
        number = 0
        while name == b"##DL" and at not in self._seen:
            links, data = self._block(at, b"##DL")
            flags, count = _LIST.unpack_from(data)
            offsets = struct.unpack_from(f"<{1 if flags & _EQUAL else count}Q", data, _LIST.size)
            for k, link in enumerate(links[1 : count + 1]):
                yield from self._piece(link, (number + k) * offsets[0] if flags & _EQUAL else offsets[k])
            number, at = number + count, links[0]
            name = self._head(at)[0] if at else b""

    def _piece(self, at: int, begin: int) -> Iterator[Piece]:
        """The records of a block of data, whose first byte is this one of the group; none where it is damaged."""
        name, length, _ = self._head(at)
        if name == b"##DT":
            yield Piece(begin, length - _BLOCK.size, at + _BLOCK.size, length - _BLOCK.size)
        elif name == b"##DZ":
            self._file.seek(at + _BLOCK.size)
            of, how, columns, size, stored = _PACKED.unpack(self._file.read(_PACKED.size))
            if of != b"DT" or how not in (DEFLATE, TRANSPOSED) or max(size, stored) > _UNPACKED:
                raise OddError("another compression")
            yield Piece(begin, size, at + _BLOCK.size + _PACKED.size, stored, how, columns)

    def _block(self, at: int, wanted: bytes, *, again: bool = False) -> tuple[Sequence[int], bytes]:
        """Links and contents of a block, which only names and conversions may have in common."""
        if at in self._seen and not again:
            raise OddError("blocks in a circle")
        self._seen.add(at)
        name, length, links = self._head(at)
        if name != wanted or length > _LARGEST or len(self._seen) > _BLOCKS:
            raise OddError(f"no {wanted.decode()} is at byte {at}")
        return links, self._file.read(length - _BLOCK.size - 8 * len(links))

    def _head(self, at: int) -> tuple[bytes, int, Sequence[int]]:
        """Name, length and links of a block; no name where there is none."""
        if at > self._size - _BLOCK.size:
            return b"", 0, ()
        self._file.seek(at)
        name, length, count = _BLOCK.unpack(self._file.read(_BLOCK.size))
        if not 8 * count <= min(length - _BLOCK.size, self._size - at - _BLOCK.size, _LARGEST):
            return b"", 0, ()
        return name, length, struct.unpack(f"<{count}Q", self._file.read(8 * count))


def _started(header: bytes) -> float:
    """When the log began [s since 1970], to the microsecond; a time without a zone is this machine's."""
    ns, flags = _START.unpack_from(header)
    began = datetime.fromtimestamp(ns / 10**9, UTC)
    return (began.replace(tzinfo=None) if flags & _LOCAL else began).timestamp()


def _field(data: bytes) -> Field:
    kind, _, type_, bit, byte, bits = _CHANNEL.unpack_from(data)
    is_bytes = type_ == _BYTES
    fits = bits % 8 == 0 and not bit if is_bytes else type_ in (0, 1) and bits <= 32 and bit < 32
    if kind not in (_VALUE, _LONGEST) or not fits or not bits:
        raise OddError("a part of another type")
    return Field(byte, bit, bits, type_ == 1, is_bytes)


def missing(path: Path) -> str:
    """How the file shows that its end is missing: a block of it reaches beyond its end, or it was not closed."""
    size = path.stat().st_size
    with path.open("rb") as file:
        unfinished = file.read(5) == b"UnFin"
        seen: set[int] = set()
        waiting = [_HEADER]
        while waiting and len(seen) < _BLOCKS:
            at = waiting.pop()
            if at in seen or not at:
                continue
            seen.add(at)
            file.seek(min(at, size))
            head = file.read(_BLOCK.size)
            if len(head) < _BLOCK.size:
                return f"a block at byte {at} is beyond its end, at {size}"
            name, length, links = _BLOCK.unpack(head)
            if not name.startswith(b"##"):
                return f"no block is at byte {at}"
            if at + length > size:
                return f"a block at byte {at} of {length} bytes reaches beyond its end, at {size}"
            raw = file.read(8 * min(links, length // 8))
            waiting += struct.unpack(f"<{len(raw) // 8}Q", raw[: len(raw) // 8 * 8])
    return "its logger did not close it" if unfinished else ""
