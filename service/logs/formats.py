"""Logs in the formats that loggers write, distinguished by the file's ending: any other ending is candump's text."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from faultline.service.logs.asc import read_asc
from faultline.service.logs.blf import read_blf
from faultline.service.logs.candump import no_candump, read_candump
from faultline.service.logs.report import Frame, LogError, LogReport, OnChannel, in_order
from faultline.service.logs.tables import read_csv, read_sqlite
from faultline.service.logs.trc import read_trc

READERS: Mapping[str, Callable[[bytes, LogReport], Iterator[OnChannel]]] = {
    ".asc": read_asc,
    ".blf": read_blf,
    ".csv": read_csv,
    ".db": read_sqlite,
    ".trc": read_trc,
}
"""Vector's ASC and BLF, python-can's CSV and SQLite, PEAK's TRC."""


def read_log(path: Path, channel: str | None = None) -> tuple[list[Frame], LogReport]:
    """Return the data frames of a log in time order, and what was lost; of one channel, if that is given.

    Raises:
        LogError: the file cannot be read, or holds no frame, or none of the channel.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_log(content, path, channel)


def parse_log(content: bytes, path: Path, channel: str | None = None) -> tuple[list[Frame], LogReport]:
    """Parse the content of the file at `path`, whose ending gives the format, as `read_log`."""
    report = LogReport()
    reader = READERS.get(path.suffix.lower(), read_candump)
    chosen = None if channel is None else channel.encode()
    seen: dict[bytes, set[tuple[int, bool]]] = {}
    frames: list[Frame] = []
    try:
        for name, frame in reader(content, report):
            seen.setdefault(name, set()).add((frame.can_id, frame.is_extended))
            if chosen is None or name == chosen:
                frames.append(frame)
    except LogError as error:
        raise LogError(f"{path}: {error}") from error
    report.channels = {name.decode(errors="replace"): found for name, found in sorted(seen.items())}
    if not frames:
        raise LogError(f"{path}: {_no_frame(content, path, report, channel)}")
    report.frames = len(frames)
    frames = in_order(frames, report)
    report.length_s = frames[-1].t - frames[0].t
    return frames, report


def _no_frame(content: bytes, path: Path, report: LogReport, channel: str | None) -> str:
    if report.channels:
        there = ", ".join(report.channels)
        return f"has no frame of channel {channel}; " + (f"it has {there}" if there else "it names no channels")
    if path.suffix.lower() not in READERS:
        return no_candump(content, report)
    reason = f"{report.unit} {report.told[0][0]}: {report.told[0][1]}" if report.told else report.missing
    return f"no frame could be read ({reason or 'it holds none'}); is it really a {path.suffix[1:].upper()} log?"
