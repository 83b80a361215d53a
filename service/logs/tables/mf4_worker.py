"""The process that reads data channels of an MF4 by asammdf, and writes them to standard output.

Its arguments are the file and the channels that are wanted. Each message is its length and msgpack, as those of
`logs.mf4_worker`: first `DataChannels`, then `DataRows`s, those of all groups by their first time, at last `Ended`.
"""

import heapq
import resource
import sys
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.mf4_tree import missing
from faultline.service.logs.mf4_worker import MEMORY, Ended, failed, write

_ROWS = 1 << 14
_MASTER = 2  # type of a channel that is the times of its group
_FRAMES = "CAN_"


class DataChannel(msgspec.Struct):
    """A channel: its name, unit, and the number of its group among those with data."""

    name: str
    unit: str
    group: int


class DataChannels(msgspec.Struct, tag=True):
    """The channels of the file."""

    channels: list[DataChannel]


class DataRows(msgspec.Struct, tag=True):
    """Rows of a group: times [s] and values by channel, as bytes of float64; infinite where they are no numbers."""

    group: int
    time: bytes
    values: dict[str, bytes]


class _Group(NamedTuple):
    """A group: its number in the file, its number of rows, and the indices of its channels by name."""

    number: int
    rows: int
    channels: dict[str, int]


class _Reader:
    """State: the rows that could not be read."""

    def __init__(self, mdf: Any) -> None:
        self._mdf = mdf
        self._start_s = mdf.header.start_time.timestamp()
        self.bad: list[tuple[int, str, int]] = []
        self.channels: list[DataChannel] = []
        self.groups: list[_Group] = []
        seen: set[str] = set()
        for number, group in enumerate(mdf.groups):
            names = [channel.name for channel in group.channels]
            rows = int(group.channel_group.cycles_nr)
            if not rows or any(name.startswith(_FRAMES) for name in names):
                continue
            kept = {}
            for index, channel in enumerate(group.channels):
                if channel.channel_type != _MASTER and channel.name not in seen:
                    seen.add(channel.name)
                    kept[channel.name] = index
                    self.channels.append(DataChannel(channel.name, _unit(channel), len(self.groups)))
            if kept:
                self.groups.append(_Group(number, rows, kept))

    def parts(self, names: Collection[str]) -> Iterator[DataRows]:
        """Yield the rows of all groups with any of these channels, of all groups where there are none."""
        streams = [
            self._of(k, group, wanted)
            for k, group in enumerate(self.groups)
            if (wanted := [name for name in group.channels if name in names]) or not names
        ]
        for _, part in heapq.merge(*streams, key=lambda each: each[0]):
            yield part

    def _of(self, k: int, group: _Group, names: list[str]) -> Iterator[tuple[float, DataRows]]:
        for begin in range(0, group.rows, _ROWS):
            count = min(_ROWS, group.rows - begin)
            try:
                time, values = self._read(group, names, begin, count)
            except Exception as error:  # noqa: BLE001 asammdf raises anything where a block is damaged
                self.bad.append((begin, failed(error), count))
                continue
            if len(time):
                raw = {name: each.tobytes() for name, each in values.items()}
                yield float(time[0]), DataRows(k, (time + self._start_s).tobytes(), raw)

    def _read(
        self, group: _Group, names: list[str], begin: int, count: int
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        values = {}
        time = np.zeros(0)
        for name in names or [next(iter(group.channels))]:
            index = group.channels[name]
            found = self._mdf.get(group=group.number, index=index, record_offset=begin, record_count=count)
            time = np.asarray(found.timestamps, np.float64)
            if name in names:
                values[name] = _numbers(found)
        return time, values


def _unit(channel: Any) -> str:
    unit = channel.unit or (channel.conversion is not None and channel.conversion.unit) or ""
    return unit.decode(errors="replace") if isinstance(unit, bytes) else str(unit)


def _numbers(signal: Any) -> FloatArray:
    """Return a signal's values; those that are no numbers, or that the file calls invalid, as none."""
    samples = signal.samples
    if samples.dtype.names or samples.ndim != 1 or samples.dtype.kind not in "biuf":
        return np.full(len(samples), np.inf)
    found: FloatArray = samples.astype(np.float64)
    if signal.invalidation_bits is not None:
        found[np.asarray(signal.invalidation_bits, np.bool_)] = np.inf
    return found


def main(path: Path, names: Collection[str]) -> None:
    """Write what the channels of these names hold."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    from asammdf import MDF

    cut = missing(path)
    try:
        reader = _Reader(MDF(path, use_display_names=False))
    except Exception as error:  # noqa: BLE001 asammdf raises anything where a block is damaged
        write(Ended(cut or failed(error), []))
        return
    write(DataChannels(reader.channels))
    for part in reader.parts(names):
        write(part)
    write(Ended(cut, reader.bad))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
