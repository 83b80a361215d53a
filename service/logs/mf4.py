"""MF4 logs (ASAM MDF 4): ordinary ones by `logs.mf4_ordinary`, the others by asammdf (extra `mf4`) in another process.

asammdf trusts what a file says of itself: a damaged one may make it loop, take all memory or crash. So it runs in
another process (`logs.mf4_worker`), whose memory is limited and which is stopped when it says nothing for long.
"""

import os
import select
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import msgspec
import numpy as np

from faultline.service.logs.batch import Batch, impossible
from faultline.service.logs.channels import Channels
from faultline.service.logs.mf4_ordinary import OrdinaryMf4
from faultline.service.logs.mf4_tree import OddError, missing
from faultline.service.logs.mf4_worker import LENGTH, Ended, Part
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogReport

MF4_MAGIC = (b"MDF     ", b"UnFinMF ")
_WORKER = "faultline.service.logs.mf4_worker"
_PATIENCE_S = 120.0
"""Time in which the process must say something [s]."""
_LONGEST = 1 << 30
_ERRORS = 2000  # characters of what the process says when it fails


def read_mf4(source: Source, report: LogReport, channels: Channels) -> Iterator[Batch]:
    """The frames of a log in order of time.

    Raises:
        ModuleNotFoundError: asammdf is needed and not installed.
    """
    report.unit = "record"
    with source.plain(report) as path:
        try:
            ordinary = OrdinaryMf4(path)
        except OddError:
            yield from _by_asammdf(path, report, channels)
            return
        first = 0
        for batch in ordinary.batches():
            yield from _checked(batch, first, report, channels)
            first += len(batch)
        note_end(missing(path), ordinary.bad, report)


def _by_asammdf(path: Path, report: LogReport, channels: Channels) -> Iterator[Batch]:
    check_asammdf()
    with TemporaryFile() as errors:
        for message in messages(_WORKER, [str(path)], Part | Ended, errors, report):
            if isinstance(message, Part):
                yield from _checked(_batch(message), message.first, report, channels)
            elif isinstance(message, Ended):
                note_end(message.missing, message.bad, report)


def note_end(cut: str, bad: Sequence[tuple[int, str, int]], report: LogReport) -> None:
    """Report how the end is missing, and the records (number, reason, count) that cannot be read."""
    for record, reason, count in bad:
        report.reject(record, reason)
        report.bad += count - 1
    report.missing = report.missing or cut


def check_asammdf() -> None:
    """Check that asammdf is installed, without importing it.

    Raises:
        ModuleNotFoundError: it is not.
    """
    if find_spec("asammdf") is None:
        raise ModuleNotFoundError("No module named 'asammdf'", name="asammdf")


def messages(
    worker: str, arguments: Sequence[str], types: Any, errors: IO[bytes], report: LogReport
) -> Iterator[msgspec.Struct]:
    """Yield what the process `worker`, a module, says until it ends, of these types of messages."""
    command = [sys.executable, "-W", "ignore", "-m", worker, *arguments]
    decoder = msgspec.msgpack.Decoder(types)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors) as process:  # noqa: S603 our own
        assert process.stdout is not None
        try:
            while head := _taken(process.stdout, LENGTH):
                yield decoder.decode(_taken(process.stdout, int.from_bytes(head, "little")))
        except TimeoutError:
            report.missing = f"reading it hangs: it was stopped after {_PATIENCE_S:.0f} s"
        finally:
            process.kill()
    if process.returncode not in (0, -9) and not report.missing:
        errors.seek(0)
        said = errors.read()[-_ERRORS:].decode(errors="replace").strip().splitlines()
        report.missing = (
            f"asammdf cannot read it further: {said[-1] if said else f'it ended with {process.returncode}'}"
        )


def _taken(pipe: IO[bytes], size: int) -> bytes:
    """So many bytes from the pipe; none if it was closed.

    Raises:
        TimeoutError: they do not come.
    """
    if size > _LONGEST:
        raise TimeoutError
    parts = bytearray()
    while len(parts) < size:
        if not select.select([pipe], [], [], _PATIENCE_S)[0]:
            raise TimeoutError
        piece = os.read(pipe.fileno(), size - len(parts))
        if not piece:
            return b""
        parts += piece
    return bytes(parts)


def _batch(part: Part) -> Batch:
    """The frames of a part, with the file's numbers of channels."""
    return Batch(
        np.frombuffer(part.time, np.float64),
        np.frombuffer(part.channel, np.uint8),
        np.frombuffer(part.identifier, np.uint32),
        np.frombuffer(part.flags, np.uint8),
        np.frombuffer(part.length, np.uint8),
        np.frombuffer(part.data, np.uint8).reshape(len(part.length), -1),
    )


def _checked(batch: Batch, first: int, report: LogReport, channels: Channels) -> Iterator[Batch]:
    """The frames with the log's channels; those that no bus carries are rejected. `first` is the first one's number."""
    index = np.zeros(256, np.uint8)
    for number in np.flatnonzero(np.bincount(batch.channel)).tolist():
        index[number] = channels.index(str(number).encode())
    batch = replace(batch, channel=index[batch.channel])
    bad = impossible(batch)
    if bad.any():
        for row in np.flatnonzero(bad).tolist():
            report.reject(first + row, "a frame that no bus carries")
        batch = batch[~bad]
    yield batch
