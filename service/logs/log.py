"""Log for commands: an instrumented recording, or a bare log file."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from faultline.service.core.signals.columns import CanSignals
from faultline.service.core.signals.dbc import NOBODY, compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.merging import MergedSignals, Part
from faultline.service.core.signals.received import Signals
from faultline.service.logs.batch import ERROR, NO_DATA, REMOTE, Batch
from faultline.service.logs.candump import EXAMPLE
from faultline.service.logs.channels import Channels
from faultline.service.logs.formats import Format, format_of
from faultline.service.logs.order import Ordering
from faultline.service.logs.pieces import Source
from faultline.service.logs.recording import Columns, Recording, load_recording
from faultline.service.logs.report import Frame, LogError, LogReport, Wanted, anything
from faultline.service.logs.seen import Seen
from faultline.service.logs.tables.find import find_table_file, is_mf4
from faultline.service.logs.tables.table import Table, open_table

KEPT = 8 << 20
"""Bytes of batches that are kept from the first pass, so that a short log is read once."""


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
            yield from _Pass(self.source, self.format, self.channel).batches()

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


class _Pass:
    """One pass over the file. State: its report, and what came so far."""

    def __init__(self, source: Source, form: Format, channel: str | None) -> None:
        self.report, self.channels = LogReport(), Channels()
        self.first_s: float | None = None
        self._source, self._format = source, form
        self._channel = None if channel is None else channel.encode()
        self._ordering, self._seen = Ordering(self.report), Seen()

    def batches(self) -> Iterator[Batch]:
        """The frames of the channel in order of time."""
        try:
            for batch in self._format.read(self._source, self.report, self.channels):
                self._seen.add(batch.with_data)
                chosen = batch if self._channel is None else batch[batch.channel == self._chosen()]
                yield self._ordering.ordered(chosen) if self._format.has_times else chosen
        except LogError as error:
            raise LogError(f"{self._source.path}: {error}") from error

    def all(self) -> tuple[Batch, ...] | None:
        """Read all, for the report; return the batches, None where they are too many to be kept."""
        kept: list[Batch] = []
        size = 0
        for batch in self.batches():
            self._count(batch)
            size += sum(getattr(batch, name).nbytes for name in Batch.__slots__)
            if size > KEPT:
                kept.clear()
            else:
                kept.append(batch)
        self.report.channels = self._seen.by_channel(self.channels.names)
        return tuple(kept) if size <= KEPT else None

    def _chosen(self) -> int:
        """The index of the channel, or one that no frame has."""
        names = self.channels.names
        return names.index(self._channel) if self._channel in names else len(names)

    def _count(self, batch: Batch) -> None:
        frames = batch.with_data
        self.report.frames += len(frames)
        if len(frames) < len(batch):
            self.report.remote += int(np.count_nonzero(batch.flags & NO_DATA == REMOTE))
            self.report.errors += int(np.count_nonzero(batch.flags & ERROR))
        if len(frames) and self._format.has_times:
            self.first_s = float(frames.time[0]) if self.first_s is None else self.first_s
            self.report.length_s = float(frames.time[-1]) - self.first_s


def open_log(path: Path, channel: str | None = None) -> Log:
    """Open the log at `path`: the folder of an instrumented recording, or a log file in any format.

    Of one `channel`, where that is given or the recording names it.

    Raises:
        LogError: it is neither, or a bench recording, which has first to be ingested; or it holds no data frame, or
        none
            of the channel, or no times.
    """
    if not path.is_dir():
        return _usable(_bare(path, channel))
    recording = load_recording(path)
    if recording.kind == "bench":
        raise LogError(f"{path}: a bench recording; run `faultline ingest {path} --out DIR` first and give its result")
    return _usable(_recorded(path, recording, channel))


def open_any(path: Path, channel: str | None = None) -> Log:
    """The same of a log file, or a recording of either kind, whose frames need neither times nor data.

    Raises:
        LogError: no frame could be read, or none of the channel.
    """
    return _some(_recorded(path, load_recording(path), channel) if path.is_dir() else _bare(path, channel))


def read_log(path: Path, channel: str | None = None) -> tuple[list[Frame], LogReport]:
    """The data frames of a log file that is small, in time order, and what was lost.

    Raises:
        LogError: the file cannot be read, or holds no frame, or none of the channel, or no times.
    """
    log = _usable(_file(path, channel))
    return list(log.frames()), log.report


def _file(path: Path, channel: str | None) -> Log:
    source = Source(path)
    form = format_of(source)
    first = _Pass(source, form, channel)
    kept = first.all()
    names = tuple(name.decode(errors="replace") for name in first.channels.names)
    return Log(path.stem, source, form, first.report, names, first.first_s or 0.0, channel=channel, kept=kept)


def _bare(path: Path, channel: str | None) -> Log:
    """Return the log of a file alone."""
    source = Source(path)
    if is_mf4(source) and (log := _file(path, channel)).report.channels:
        return log
    file = find_table_file(source)
    return _file(path, channel) if file is None else _only_table(path.stem, source, open_table(str(path), file))


def _only_table(name: str, source: Source, values: Table) -> Log:
    def no_frames(*_: object) -> Iterator[Batch]:
        raise LogError(f"a {values.file.kind}, which has no CAN frames; give a CAN log")

    form = Format(values.file.kind, no_frames, has_frames=False)
    return Log(name, source, form, values.report, (), values.start_s, values=values)


def _recorded(folder: Path, recording: Recording, channel: str | None) -> Log:
    """Return the log of a recording, with its table."""
    can, columns = recording.can, recording.table
    if can is None:
        assert columns is not None  # as was checked when it was loaded
        source = Source(folder / columns.file)
        log = _only_table(recording.id, source, _table(folder, columns, None))
        return replace(log, recording=recording)
    log = replace(_file(folder / can.file, channel or can.channel), id=recording.id, recording=recording)
    log = replace(log, dbc_path=folder / can.dbc)
    if columns is None:
        return log
    values = _table(folder, columns, log.start_s)
    if not (values.span[0] - values.start_s < log.duration_s and values.span[1] > values.start_s):
        raise LogError(
            f"{values.where}: from {values.span[0]:.3f} to {values.span[1]:.3f} s, the CAN log is from "
            f"{log.start_s:.3f} to {log.start_s + log.duration_s:.3f} s: they have no time in common; give `offset_s` "
            "under [table] in recording.toml: log time, from the first frame on, less the table's time"
        )
    log.report.beside = values.report
    return replace(log, values=values)


def _table(folder: Path, columns: Columns, start_s: float | None) -> Table:
    path = folder / columns.file
    file = find_table_file(Source(path), columns.time)
    if file is None:
        raise LogError(
            f"{path}: no table of values with a column of times was found; name the column with `time` under [table] "
            "in recording.toml"
        )
    return open_table(str(path), file, columns.maps, columns.offset_s, start_s)


def _usable(log: Log) -> Log:
    """A log that signals can be read from."""
    if not log.report.frames:
        raise LogError(f"{log.source.path}: {_no_frame(log)}")
    if not log.format.has_times:
        raise LogError(
            f"{log.source.path}: its frames have no times, which this needs; record it with `candump -L`; "
            "`faultline log` and `faultline convert` take it as it is"
        )
    return log


def _some(log: Log) -> Log:
    if not log.report.frames + log.report.remote + log.report.errors:
        raise LogError(f"{log.source.path}: {_no_frame(log)}")
    return log


def _no_frame(log: Log) -> str:
    report, name = log.report, log.format.name
    if report.channels:
        there = ", ".join(each for each in report.channels if each)
        return f"has no frame of channel {log.channel}; " + (f"it has {there}" if there else "it names no channels")
    if name.startswith("candump"):
        return _no_candump(log.source.head, report)
    reason = f"{report.unit} {report.places[0][0]}: {report.places[0][1]}" if report.places else report.missing
    return f"no frame could be read ({reason or 'it holds none'}); is it really a {name} log?"


def _no_candump(head: bytes, report: LogReport) -> str:
    """Why a file without a frame is no log of this format, and what one looks like."""
    remedy = f"a candump line looks like `{EXAMPLE}`"
    if not head.strip():
        return f"is empty; {remedy}"
    if report.places:
        number, reason = report.places[0]
        return f"line {number}: not a CAN log, {reason}; {remedy}"
    if report.truncated and not (report.remote or report.errors):
        return f"line 1: its only line is cut off; {remedy}"
    return f"holds no data frame; {remedy}"
