"""Logs in the formats that python-can reads, told apart by the file's ending; candump's is read by our own."""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import BinaryIO

from service.logs.candump import Frame, LogError, LogReport, in_order, parse_candump

ENDINGS = (".asc", ".blf", ".csv", ".db", ".trc")
"""What is left to python-can: Vector's ASC and BLF, its own CSV and SQLite, PEAK's TRC."""


def read_log(path: Path) -> tuple[list[Frame], LogReport]:
    """The data frames of a log in time order, and what was lost.

    A file that goes bad midway costs what follows; what was read before is kept, and the report says so.

    Raises:
        LogError: the file cannot be read, or holds no frame.
    """
    try:
        if path.suffix.lower() not in ENDINGS:
            return parse_candump(path.read_bytes(), str(path))
        with path.open("rb"):  # a reader's own error for a file that is not there depends on the format
            pass
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    report = LogReport()
    frames: list[Frame] = []
    try:
        frames.extend(_frames(path, report))
    except Exception as error:  # noqa: BLE001 (python-can's readers raise whatever parsing raises; it is told)
        report.reject(len(frames) + report.remote + report.errors + 1, f"reading ends here: {error!r}")
    if not frames:
        reason = report.told[0][1] if report.told else "it holds none"
        raise LogError(f"{path}: no frame could be read ({reason}); is it really a {path.suffix[1:].upper()} log?")
    report.frames = len(frames)
    return in_order(frames, report), report


def _frames(path: Path, report: LogReport) -> Iterator[Frame]:
    import can  # takes a quarter of a second, and only these formats need it

    def opened(file: BinaryIO) -> AbstractContextManager[Iterable[can.Message]]:
        """LogReader leaves a BLF file open when it does not like its head, so that one is given a file."""
        return can.BLFReader(file) if path.suffix.lower() == ".blf" else can.LogReader(path)

    with path.open("rb") as file, opened(file) as reader:
        for message in reader:
            if message.is_error_frame:
                report.errors += 1
            elif message.is_remote_frame:
                report.remote += 1
            else:
                yield Frame(message.timestamp, message.arbitration_id, message.is_extended_id, bytes(message.data))
