"""The process that reads an MF4 log by asammdf, and writes its frames to standard output in order of time.

Each message is its length (`LENGTH` bytes, little-endian) and msgpack: a `Part` of the frames, at last `Ended`.
"""

import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.service.logs.batch import Batch
from faultline.service.logs.mf4_frames import FEWEST, KINDS, RECORDS, frames_of, in_order
from faultline.service.logs.mf4_tree import missing

LENGTH = 4
MEMORY = 6 << 30  # bytes of address space
_FAILURES = 300  # ranges that cannot be read, at most


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
            if channel.name in KINDS
        ]

    def parts(self) -> Iterator[Batch]:
        """All frames in order of time: of each group some records are in memory."""
        size = max(FEWEST, RECORDS // max(1, len(self.groups)))
        yield from in_order([self._of(group, size) for group in self.groups])

    def _of(self, group: _Group, size: int) -> Iterator[Batch]:
        """The frames of a group. Ranges that cannot be read are halved."""
        waiting = [(begin, min(group.records, begin + size)) for begin in range(0, group.records, size)][::-1]
        failures = 0
        while waiting:
            begin, end = waiting.pop()
            try:
                batch = self._read(group, begin, end - begin)
            except Exception as error:  # noqa: BLE001 asammdf raises anything where a block is damaged
                failures += 1
                if end - begin == 1 or failures > _FAILURES:
                    self.bad.append((begin, failed(error), end - begin))
                else:
                    middle = (begin + end) // 2
                    waiting += [(middle, end), (begin, middle)]
                continue
            if len(batch) < end - begin:
                self.bad.append((begin + len(batch), "it is not there", end - begin - len(batch)))
            if len(batch):
                yield batch

    def _read(self, group: _Group, begin: int, count: int) -> Batch:
        columns, times = self._columns(group, begin, count)
        return frames_of(group.name, columns, times + self._start_s)

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


def main(path: Path) -> None:
    """Write all messages of the log at `path`."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    from asammdf import MDF

    cut = missing(path)
    try:
        reader = _Reader(MDF(path, use_display_names=False))
    except Exception as error:  # noqa: BLE001 asammdf raises anything where a block is damaged
        write(Ended(cut or failed(error), []))
        return
    first = 0
    for batch in reader.parts():
        time, channel, identifier, flags, length, data = (
            np.ascontiguousarray(getattr(batch, name)).tobytes() for name in Batch.__slots__
        )
        write(Part(time, channel, identifier, flags, length, data, first))
        first += len(batch)
    write(Ended(cut, reader.bad))


def failed(error: Exception) -> str:
    """Return why asammdf could not read a part."""
    return f"asammdf cannot read it ({type(error).__name__}: {error})"[:200]


def write(message: msgspec.Struct) -> None:
    """Write a message to standard output."""
    raw = msgspec.msgpack.encode(message)
    sys.stdout.buffer.write(len(raw).to_bytes(LENGTH, "little") + raw)
    sys.stdout.buffer.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
