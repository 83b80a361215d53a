"""Log for commands: an instrumented recording, or a bare log file."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from faultline.service.core.signals.columns import CanSignals
from faultline.service.core.signals.dbc import NOBODY, compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.merging import MergedSignals, Part
from faultline.service.core.signals.received import Signals
from faultline.service.logs.batch import Batch
from faultline.service.logs.formats import Format
from faultline.service.logs.pieces import Source
from faultline.service.logs.reading import Pass
from faultline.service.logs.recording import Recording
from faultline.service.logs.report import Frame, LogError, LogReport, Wanted, anything
from faultline.service.logs.tables.table import Table


@dataclass(frozen=True)
class Log:
    """Frames in time order under an id. The file is read anew for each pass over them: nothing of it is in memory.

    `report` says what a first pass over all of it found. `channels` are the names of the file's channels, by the index
    that batches have; `start_s` is the time of the first data frame. Of a bare file neither its DBC is known nor what
    `recording.toml` says: they are None. `channel` is the bus whose frames they are, None where the frames of all buses
    in the log are merged. `values` is the table of a recording that has one, or a file that is a table; such a file has
    no frames.
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
    kept: tuple[Batch, ...] | None = field(default=None, repr=False)
    values: Table | None = field(default=None, repr=False)

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
        frames = CanSignals(table, lambda: passing(self._relative_batches()))
        if self.values is None:
            return frames
        beside = self.values.signals(table.units)
        if not self.format.has_frames:
            return beside
        return MergedSignals([Part(frames, {name for name in table.units if self.values.has(name)}), Part(beside)])

    def _relative_batches(self) -> Iterator[Batch]:
        return (replace(batch, time=batch.time - self.start_s).with_data for batch in self.batches())

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

    def table(self, units: Mapping[str, str], where: str) -> DecodeTable:
        """Return what decodes the signals in `units` (name to unit), by the recording's DBC and senders.

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
        table = compile_dbc(self.dbc, on_bus, where, self.senders)
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
        channels = self.report.channels
        taken = [channels.get(self.channel, set())] if self.channel is not None else channels.values()
        if unclear := table.undecided({each for found in taken for each in found}):
            how = "" if self.recording is None else ", or `senders` under [can] in recording.toml"
            raise LogError(f"{self.id}: {'; '.join(unclear)}{how}")

    def check_dbc(self, sha256: str) -> None:
        """Refuse a recording made with another DBC than the bundle's, of hash `sha256`.

        Raises:
            LogError: the recording names another DBC.
        """
        used = self.recording.can.dbc_sha256 if self.recording and self.recording.can else sha256
        if used != sha256:
            raise LogError(
                f"{self.dbc_path}: recorded with DBC {used[:12]}, the bundle was made for {sha256[:12]}; "
                "export a bundle for this vehicle's DBC"
            )

    def check_channels(self, wanted: Wanted = anything) -> None:
        """Refuse to merge two buses: the same `wanted` message on both may be of two vehicles.

        Raises:
            LogError: an identifier that is wanted comes on more than one channel, and none was chosen.
        """
        if self.channel is None and (both := self.report.on_two_channels(wanted)):
            how = "--channel" if self.recording is None else "`channel` under [can] in recording.toml"
            raise LogError(f"{self.id}: the same messages come on {' and '.join(both)}: say which bus with {how}")
