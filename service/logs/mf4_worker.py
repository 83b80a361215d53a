"""The process that reads an MF4 log by asammdf, and writes its frames to standard output in order of time.

Each message is its length (`LENGTH` bytes, little-endian) and msgpack: a `Part` of the frames, at last `Ended`.
"""

import resource
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.service.logs.batch import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FD,
    FD_BYTES,
    REMOTE,
    SENT,
    Batch,
    joined,
)

LENGTH = 4
MEMORY = 6 << 30  # bytes of address space
_RECORDS = 1 << 17  # read at once, of all groups together
_FEWEST = 1 << 12  # of one group
_FAILURES = 300  # ranges that cannot be read, at most
_BLOCKS = 1_000_000  # of a file that are looked at
_FLAGS = {"CAN_DataFrame": 0, "CAN_RemoteFrame": REMOTE, "CAN_ErrorFrame": ERROR}
_BLOCK = struct.Struct("<4s4xQQ")  # name, length, number of links
_HEADER = 64  # byte of the first block
_LENGTHS = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64], dtype=np.uint8)  # bytes, by data length code
_TOP = np.uint32(0x7FF)


class Part(msgspec.Struct, tag=True):
    """Columns of `logs.batch` as bytes, with the file's numbers of channels; `first` is the first record's number."""

    time: bytes
    channel: bytes
    identifier: bytes
    flags: bytes
    length: bytes
    data: bytes
    first: int


class Ended(msgspec.Struct, tag=True):
    """All was read. How the file shows that its end is missing; (record, reason, count) of what cannot be read."""

    missing: str
    bad: list[tuple[int, str, int]]


class _Group(NamedTuple):
    """A group of frames of one kind: its number, that of its channel, its number of records, and what they are."""

    number: int
    channel: int
    name: str
    records: int


class _Reader:
    """State: the records that could not be read."""

    def __init__(self, mdf: Any) -> None:
        self._mdf = mdf
        self._start_s = mdf.header.start_time.timestamp()
        self.bad: list[tuple[int, str, int]] = []
        self.groups = [
            _Group(number, index, channel.name, int(group.channel_group.cycles_nr))
            for number, group in enumerate(mdf.groups)
            for index, channel in enumerate(group.channels)
            if channel.name in _FLAGS
        ]

    def parts(self) -> Iterator[Batch]:
        """All frames in order of time: of each group some records are in memory."""
        size = max(_FEWEST, _RECORDS // max(1, len(self.groups)))
        streams = [self._of(group, size) for group in self.groups]
        if len(streams) == 1:
            yield from streams[0]
            return
        held = [next(stream, None) for stream in streams]
        while any(each is not None for each in held):
            until = min(float(each.time[-1]) for each in held if each is not None)
            ready = []
            for k, each in enumerate(held):
                if each is not None:
                    count = int(np.searchsorted(each.time, until, "right"))
                    ready.append(each[:count])
                    held[k] = each[count:] if count < len(each) else next(streams[k], None)
            whole = joined(ready)
            yield whole[np.argsort(whole.time, kind="stable")]

    def _of(self, group: _Group, size: int) -> Iterator[Batch]:
        """The frames of a group. Ranges that cannot be read are halved."""
        waiting = [(begin, min(group.records, begin + size)) for begin in range(0, group.records, size)][::-1]
        failures = 0
        last = -np.inf
        while waiting:
            begin, end = waiting.pop()
            try:
                batch = self._read(group, begin, end - begin)
            except Exception as error:  # noqa: BLE001 asammdf raises anything where a block is damaged
                failures += 1
                if end - begin == 1 or failures > _FAILURES:
                    self.bad.append((begin, f"{type(error).__name__}: {error}"[:200], end - begin))
                else:
                    middle = (begin + end) // 2
                    waiting += [(middle, end), (begin, middle)]
                continue
            if len(batch) < end - begin:
                self.bad.append((begin + len(batch), "it is not there", end - begin - len(batch)))
            if len(batch):
                batch.time[:] = (
                    np.maximum.accumulate(np.maximum(batch.time, last)) if len(self.groups) > 1 else batch.time
                )
                last = float(batch.time[-1])
                yield batch

    def _read(self, group: _Group, begin: int, count: int) -> Batch:
        columns, times = self._columns(group, begin, count)
        n = len(times)
        identifier = columns.get("ID", np.zeros(n, np.uint32)).astype(np.uint32)
        extended = columns["IDE"] if "IDE" in columns else (identifier >> np.uint32(31)) | (identifier > _TOP)
        identifier &= np.uint32(0x1FFF_FFFF)
        flags = np.full(n, _FLAGS[group.name], np.uint8) | np.where(extended, EXTENDED, 0).astype(np.uint8)
        for name, flag in (("EDL", FD), ("Dir", SENT)):
            if name in columns:
                flags |= np.where(columns[name], flag, 0).astype(np.uint8)
        length = _length(columns, n)
        raw = columns.get("DataBytes", np.zeros((n, 0), np.uint8))
        width = FD_BYTES if (length > CLASSIC_BYTES).any() else CLASSIC_BYTES
        data = np.zeros((n, width), np.uint8)
        kept = min(width, raw.shape[1])
        data[:, :kept] = np.where(np.arange(kept) < length[:, np.newaxis], raw[:, :kept], 0)
        channel = columns.get("BusChannel", np.zeros(n, np.uint8)).astype(np.uint8)
        return Batch(times + self._start_s, channel, identifier, flags, length, data)

    def _columns(
        self, group: _Group, begin: int, count: int
    ) -> tuple[dict[str, npt.NDArray[Any]], npt.NDArray[np.float64]]:
        """The parts of a frame by their names, and the times [s] after the start."""
        found = self._mdf.get(
            group=group.number, index=group.channel, raw=True, record_offset=begin, record_count=count
        )
        if found.samples.dtype.names:
            names = {name.rpartition(".")[2]: name for name in found.samples.dtype.names}
            return {name: found.samples[each] for name, each in names.items()}, found.timestamps
        columns = {}
        for index, channel in enumerate(self._mdf.groups[group.number].channels):
            if channel.name.startswith(f"{group.name}."):
                part = self._mdf.get(group=group.number, index=index, raw=True, record_offset=begin, record_count=count)
                columns[channel.name.rpartition(".")[2]] = part.samples
        return columns, found.timestamps


def _length(columns: dict[str, npt.NDArray[Any]], count: int) -> npt.NDArray[np.uint8]:
    """The bytes of data (N,)."""
    if "DataLength" in columns:
        return np.asarray(np.minimum(columns["DataLength"], FD_BYTES), dtype=np.uint8)
    return np.asarray(_LENGTHS[np.minimum(columns.get("DLC", np.zeros(count, np.uint8)), len(_LENGTHS) - 1)])


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
            file.seek(at)
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


def main(path: Path) -> None:
    """Write all messages of the log at `path`."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    from asammdf import MDF

    cut = missing(path)
    reader = _Reader(MDF(path, use_display_names=False))
    first = 0
    for batch in reader.parts():
        time, channel, identifier, flags, length, data = (
            np.ascontiguousarray(getattr(batch, name)).tobytes() for name in Batch.__slots__
        )
        write(Part(time, channel, identifier, flags, length, data, first))
        first += len(batch)
    write(Ended(cut, reader.bad))


def write(message: msgspec.Struct) -> None:
    """Write a message to standard output."""
    raw = msgspec.msgpack.encode(message)
    sys.stdout.buffer.write(len(raw).to_bytes(LENGTH, "little") + raw)
    sys.stdout.buffer.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
