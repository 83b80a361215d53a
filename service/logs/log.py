"""Log for commands: an instrumented recording, or a bare log file."""

import hashlib
import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import repeat
from pathlib import Path

from faultline.service.core.signals.columns import CanSignals
from faultline.service.core.signals.dbc import NOBODY, OWN_NAMES, compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.merging import MergedPart, MergedSignals
from faultline.service.core.signals.received import Signals
from faultline.service.logs.batch import Batch
from faultline.service.logs.formats import Format
from faultline.service.logs.pieces import Source
from faultline.service.logs.reading import Pass
from faultline.service.logs.recording import Recording
from faultline.service.logs.report import Frame, LogError, LogReport, Wanted, anything
from faultline.service.logs.tables.table import ValueTable
from faultline.service.logs.units import conversion


@dataclass(frozen=True)
class Log:
    """Frames in time order under an id. The file is read anew for each pass over them: nothing of it is in memory.

    `report` says what a first pass over all of it found. `channels` are the names of the file's channels, by the index
    that batches have; `start_s` is the time of the first data frame. Of a bare file neither its DBC is known nor what
    `recording.toml` says: they are None. `channel` is the bus whose frames they are, None where the frames of all buses
    in the log are merged; `buses` are the channels of the buses that have names. `values` is the table of a recording
    that has one, or a file that is a table; such a file has no frames.
    """

    id: str
    source: Source = field(repr=False)
    format: Format
    report: LogReport
    channels: tuple[str, ...]
    start_s: float
    dbc_path: Path | None = None
    recording: Recording | None = None
    channel: str | None = None
    buses: Mapping[str, str] = field(default_factory=dict)
    kept: tuple[Batch, ...] | None = field(default=None, repr=False)
    values: ValueTable | None = field(default=None, repr=False)

    def batches(self) -> Iterator[Batch]:
        """All frames of the channel, with times in order, as columns: remote and error frames too.

        Raises:
            LogError: the file cannot be read any more.
        """
        if self.kept is not None:
            yield from self.kept
        else:
            yield from Pass(self.source, self.format, self.channel).batches()

    def frames(self) -> Iterator[Frame]:
        """The data frames one by one."""
        for batch in self.batches():
            yield from batch.with_data.frames()

    def relative(self) -> Iterator[Frame]:
        """Return the data frames with times after the first one [s]."""
        for batch in self._relative_batches():
            yield from batch.frames()

    def signals(self, table: DecodeTable, passing: Callable[[Iterable[Batch]], Iterator[Batch]] = iter) -> Signals:
        """Return the signals that `table` decodes, with times after the first frame [s]; frames go through `passing`.

        What the recording's own table gives is taken from there.

        Raises:
            LogError: a column of it has a unit that cannot be converted.
        """
        beside = [] if self.values is None else [MergedPart(self.values.signals(table.units))]
        if not self.format.has_frames:
            return beside[0].signals
        without = {name for name in table.units if self.values is not None and self.values.has(name)}
        frames = CanSignals(table, lambda: passing(self._relative_batches()))
        others = [CanSignals(of, partial(self._passed, bus, passing)) for bus, of in table.buses.items()]
        if not (others or beside):
            return frames
        return MergedSignals([*(MergedPart(signals, without) for signals in (frames, *others)), *beside])

    def on_bus(self, bus: str) -> Iterator[Batch]:
        """Return the data frames of another bus, with times after the log's first one [s], in a pass of its own."""
        return map(self._relative, Pass(self.source, self.format, self.buses[bus]).batches())

    def by_bus(self, table: DecodeTable) -> Iterator[tuple[str, Frame]]:
        """Yield the data frames of all buses that `table` takes messages from, with the bus's name, as they came."""
        streams = [zip(repeat(bus), _frames(self.on_bus(bus)), strict=False) for bus in table.buses]
        own = zip(repeat(""), _frames(self._relative_batches()), strict=False)
        yield from heapq.merge(own, *streams, key=lambda each: each[1].t) if streams else own

    def _relative_batches(self) -> Iterator[Batch]:
        return map(self._relative, self.batches())

    def _passed(self, bus: str, passing: Callable[[Iterable[Batch]], Iterator[Batch]]) -> Iterator[Batch]:
        return passing(self.on_bus(bus))

    def _relative(self, batch: Batch) -> Batch:
        return replace(batch, time=batch.time - self.start_s).with_data

    @property
    def duration_s(self) -> float:
        """Return the time from the first data frame to the last [s]."""
        return self.report.length_s

    @cached_property
    def sha256(self) -> str:
        """The hash of the file's bytes."""
        found = hashlib.sha256()
        for piece in self.source.packed():
            found.update(piece)
        return found.hexdigest()

    @property
    def drive(self) -> str:
        """Return the SHA-256 that identifies the drive: of the log, or of the bench's that made it."""
        ingested = self.recording.can.bench_sha256 if self.recording and self.recording.can else None
        return ingested or self.sha256

    @property
    def dbc(self) -> str:
        """Return the text of the DBC that the recording was made with.

        Raises:
            LogError: a bare log file has none, or it cannot be read.
        """
        if self.dbc_path is None:
            raise LogError(f"{self.id}: a bare log names no DBC; give its recording's folder")
        try:
            return dbc_text(self.dbc_path.read_bytes())
        except OSError as error:
            raise LogError(f"{self.dbc_path}: cannot be read: {error.strerror}") from error

    @property
    def senders(self) -> Mapping[str, int]:
        """The source addresses that the recording chooses, by the messages' names."""
        return self.recording.can.senders if self.recording and self.recording.can else NOBODY

    @property
    def signals_of_dbc(self) -> Mapping[str, str]:
        """The DBC's names of the signals that have other ones there, as the recording has them."""
        return self.recording.can.signals if self.recording and self.recording.can else OWN_NAMES

    def table(self, units: Mapping[str, str], where: str) -> DecodeTable:
        """Return what decodes the signals in `units` (name to unit), by the recording's DBC, names and senders.

        Raises:
            InputError: neither the DBC (`where` names it) nor the recording's table gives them, or the DBC does not say
                which sender of several is meant.
        """
        values = self.values
        if values is not None and not self.format.has_frames and (lacking := values.lacking(units)):
            raise LogError(lacking)
        on_bus = {name: unit for name, unit in units.items() if values is None or not values.has(name)}
        if not on_bus:
            return DecodeTable({}, units)
        messages = self.recording.can_log.messages if self.recording else {}
        table = compile_dbc(self.dbc, on_bus, where, self.senders, messages, self.signals_of_dbc, conversion)
        self.check_senders(table)
        table.units = units  # those of the table beside it too
        return table

    def check_signals(self, units: Mapping[str, str]) -> None:
        """Refuse a table, without a CAN log beside it, that gives none of the signals in `units` (name to unit).

        Raises:
            LogError: it gives none.
        """
        if self.values is not None and not self.format.has_frames and not any(map(self.values.has, units)):
            raise LogError(self.values.lacking(units))

    def check_senders(self, table: DecodeTable) -> None:
        """Refuse to mix several senders of a message that the DBC gives to any.

        Raises:
            LogError: a message that `table` takes from any sender comes from more than one, and none was chosen.
        """
        self.check_buses(table)
        if not self.format.has_frames:
            return
        channels = self.report.channels
        taken = [channels.get(self.channel, set())] if self.channel is not None else channels.values()
        unclear = table.undecided({each for found in taken for each in found})
        for bus, of in table.buses.items():
            unclear += of.undecided(channels[self.buses[bus]])
        if unclear:
            how = "" if self.recording is None else ", or `senders` under [can] in recording.toml"
            raise LogError(f"{self.id}: {'; '.join(unclear)}{how}")

    def check_dbc(self, sha256: str | None) -> None:
        """Refuse a recording made with another DBC than the bundle's, of hash `sha256`.

        Raises:
            LogError: the recording names another DBC, or the bundle has none and there is no table of values.
        """
        if sha256 is None:
            if self.values is None:
                raise LogError(
                    f"{self.id}: the bundle has no DBC, so its signals come in a table: give one, or [table]"
                )
            return
        used = self.recording.can.dbc_sha256 if self.recording and self.recording.can else sha256
        if used != sha256:
            raise LogError(
                f"{self.dbc_path}: recorded with DBC {used[:12]}, the bundle was made for {sha256[:12]}; "
                "export a bundle for this vehicle's DBC"
            )

    def check_buses(self, table: DecodeTable) -> None:
        """Check that it is known which channel each of the buses is that `table` names.

        Raises:
            LogError: of one it is not known, or the log has no such channel.
        """
        there = [name for name in self.report.channels if name]
        for bus, of in table.buses.items():
            if self.buses.get(bus) not in there and self.format.has_frames:
                messages = " and ".join(layout.name for layout in of.layouts)
                given = f"is channel {self.buses[bus]}, which it has not" if bus in self.buses else "is not known"
                how = f"--channel {bus}=NAME"
                if self.recording is not None:
                    how += ", or `buses` under [can] in recording.toml"
                raise LogError(
                    f"{self.id}: {messages} come on bus {bus}, which {given}: its channels are "
                    f"{', '.join(there) or 'without names'}; say which one it is with {how}"
                )

    def check_channels(self, wanted: Wanted = anything) -> None:
        """Refuse to merge two buses: the same `wanted` message on both may be of two vehicles.

        Raises:
            LogError: an identifier that is wanted comes on more than one channel, and none was chosen.
        """
        if self.channel is None and (both := self.report.on_two_channels(wanted)):
            how = "--channel" if self.recording is None else "`channel` under [can] in recording.toml"
            raise LogError(f"{self.id}: the same messages come on {' and '.join(both)}: say which bus with {how}")


def _frames(batches: Iterable[Batch]) -> Iterator[Frame]:
    for batch in batches:
        yield from batch.frames()
