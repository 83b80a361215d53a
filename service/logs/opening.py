"""Opening of logs: a file in any format, a recording's folder, a table of values."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from faultline.service.core.signals.dbc import NO_BUSES
from faultline.service.logs.batch import Batch
from faultline.service.logs.candump import EXAMPLE
from faultline.service.logs.delimited import find_table
from faultline.service.logs.formats import Format, format_of
from faultline.service.logs.log import Log
from faultline.service.logs.pieces import Source
from faultline.service.logs.reading import Pass
from faultline.service.logs.recording import Columns, Recording, load_recording
from faultline.service.logs.report import Frame, LogError, LogReport
from faultline.service.logs.tables.find import find_table_file, is_mf4
from faultline.service.logs.tables.table import ValueTable, open_table
from faultline.service.logs.tables.text import find_header


def open_log(path: Path, channel: str | None = None, buses: Mapping[str, str] = NO_BUSES) -> Log:
    """Open the log at `path`: the folder of an instrumented recording, or a log file in any format.

    Of one `channel`, where that is given or the recording names it. `buses` are the channels of buses by their names,
    before what the recording says.

    Raises:
        LogError: it is neither, or a bench recording, which has first to be ingested; or it holds no data frame, or
            none of the channel, or no times.
    """
    if not path.is_dir():
        return _usable(replace(_bare(path, channel), buses=buses))
    recording = load_recording(path)
    if recording.kind == "bench":
        raise LogError(f"{path}: a bench recording; run `faultline ingest {path} --out DIR` first and give its result")
    log = _usable(_recorded(path, recording, channel))
    return replace(log, buses={**log.buses, **buses})


def open_any(path: Path, channel: str | None = None) -> Log:
    """Return the same of a log file, or a recording of either kind, whose frames need neither times nor data.

    Raises:
        LogError: no frame could be read, or none of the channel.
    """
    return _some(_recorded(path, load_recording(path), channel) if path.is_dir() else _bare(path, channel))


def read_log(path: Path, channel: str | None = None) -> tuple[list[Frame], LogReport]:
    """Return the data frames of a log file that is small, in time order, and what was lost.

    Raises:
        LogError: the file cannot be read, or holds no frame, or none of the channel, or no times.
    """
    log = _usable(_file(Source(path), channel))
    return list(log.frames()), log.report


def _file(source: Source, channel: str | None) -> Log:
    form = format_of(source)
    first = Pass(source, form, channel)
    kept = first.all()
    names = tuple(name.decode(errors="replace") for name in first.channels.names)
    return Log(source.path.stem, source, form, first.report, names, first.first_s or 0.0, channel=channel, kept=kept)


def _bare(path: Path, channel: str | None) -> Log:
    """Return the log of a file alone."""
    source = Source(path)
    if is_mf4(source) and (log := _file(source, channel)).report.channels:
        return log
    file = find_table_file(source)
    return _file(source, channel) if file is None else _only_table(path.stem, source, open_table(str(path), file))


def _only_table(name: str, source: Source, values: ValueTable) -> Log:
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
    log = replace(_file(Source(folder / can.file), channel or can.channel), id=recording.id, recording=recording)
    log = replace(log, dbc_path=folder / can.dbc, buses=can.buses)
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


def _table(folder: Path, columns: Columns, start_s: float | None) -> ValueTable:
    path = folder / columns.file
    file = find_table_file(Source(path), columns.period_s or columns.time)
    if file is None:
        raise LogError(
            f"{path}: no table of values with a column of times was found; name the column with `time` under [table] "
            "in recording.toml, or give `period_s` where rows have none"
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
    head = log.source.head
    if find_table(head) is None and find_header(head, 1.0) is not None and find_header(head) is None:
        return (
            "a table of values without a column of times; describe it with `faultline ingest --init`: name that column "
            "with --time, or the seconds from row to row with --period"
        )
    if name.startswith("candump"):
        return _no_candump(head, report)
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
