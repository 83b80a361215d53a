"""A log as commands take it: an instrumented recording, or a bare log file."""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from faultline.service.core.signals.dbc import NOBODY, compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.logs.formats import parse_log
from faultline.service.logs.recording import Recording, load_recording
from faultline.service.logs.report import Frame, LogError, LogReport, Wanted, anything


@dataclass(frozen=True)
class Log:
    """Frames in time order under an id; `sha256` is the hash of the log's bytes.

    Of a bare file neither its DBC is known nor what `recording.toml` says: they are None. `channel` is the bus whose
    frames they are, None where the frames of all buses in the log are merged.
    """

    id: str
    frames: list[Frame]
    report: LogReport
    sha256: str
    dbc_path: Path | None = None
    recording: Recording | None = None
    channel: str | None = None

    @property
    def drive(self) -> str:
        """The SHA-256 by which it is known what the drive was used for: of the log, or of the bench's that made it."""
        ingested = self.recording.can.bench_sha256 if self.recording else None
        return ingested or self.sha256

    @property
    def dbc(self) -> str:
        """The text of the DBC that the recording was made with.

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
        return self.recording.can.senders if self.recording else NOBODY

    def table(self, units: Mapping[str, str], where: str) -> DecodeTable:
        """Return the table for the signals in `units` (name to unit), by the recording's DBC and senders.

        Raises:
            InputError: the DBC does not give them (`where` names it), or does not say which sender of several is meant.
        """
        table = compile_dbc(self.dbc, units, where, self.senders)
        self.check_senders(table)
        return table

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
        """A recording made with another DBC than the bundle's, of hash `sha256`, must not be decoded with that one.

        Raises:
            LogError: the recording names another DBC.
        """
        used = self.recording.can.dbc_sha256 if self.recording else sha256
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

    @property
    def duration_s(self) -> float:
        """From the first frame to the last [s]."""
        return self.frames[-1].t - self.frames[0].t

    def relative(self) -> Iterator[Frame]:
        """The frames with times after the first one [s]."""
        start = self.frames[0].t
        return (Frame(t - start, can_id, extended, data) for t, can_id, extended, data in self.frames)


def open_log(path: Path, channel: str | None = None) -> Log:
    """The log at `path`: the folder of an instrumented recording, or a log file that `read_log` takes.

    Of one `channel`, where that is given or the recording names it.

    Raises:
        LogError: it is neither, or a bench recording, which has first to be ingested.
    """
    if not path.is_dir():
        return _bare(path, channel)
    recording = load_recording(path)
    if recording.kind == "bench":
        raise LogError(f"{path}: a bench recording; run `faultline ingest {path} --out DIR` first and give its result")
    log = _bare(path / recording.can.file, channel or recording.can.channel)
    return replace(log, id=recording.id, dbc_path=path / recording.can.dbc, recording=recording)


def _bare(path: Path, channel: str | None) -> Log:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    frames, report = parse_log(content, path, channel)
    return Log(path.stem, frames, report, hashlib.sha256(content).hexdigest(), channel=channel)
