"""Convert a log to another format, and say what that cannot hold."""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path

import msgspec
import numpy as np

from faultline.options import Parser
from faultline.service.logs import Log, LogError, open_any
from faultline.service.logs.batch import FD, REMOTE, SENT, Batch
from faultline.service.logs.writers import TARGETS, Target
from faultline.writing import check_file, written_whole

EXAMPLE = """example:
  faultline convert drive.mf4 --to candump
  faultline convert drive.log.gz --to parquet --channel can1 --out out/drive.parquet

The result is read back before it gets its name: a frame that is not in it is an error. What the format cannot hold, as
names of channels, is said. Parquet and MF4 need the extras `columns` and `mf4`. The columns of Parquet: docs/logs.md.
"""


_EVERY_S = 0.2  # between two words of progress
_CLEAR = "\r\x1b[K"

Say = Callable[[str], None]
"""Shows what is going on now."""


class Converted(msgspec.Struct):
    """What was written: the file, its format, data, remote and error frames, and what was lost on the way."""

    file: str
    format: str
    frames: int
    remote: int
    errors: int
    not_kept: list[str]
    not_read: list[str]


def main(argv: list[str]) -> int:
    """Run the command; return 0.

    Raises:
        InputError: the log cannot be read, or the format cannot hold it.
    """
    parser = Parser(
        "faultline convert", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path, help="a log file in any format, or a recording's folder")
    parser.add_argument("--to", required=True, choices=sorted(TARGETS), help="the format")
    parser.add_argument("--out", type=Path, help="the file (default: the log's name with the format's ending, here)")
    parser.add_argument("--channel", help="the bus to take, of a log of several")
    parser.add_argument("--json", action="store_true", help="print what was written, as one JSON object")
    options = parser.parse_args(argv)
    with _progress() as say:
        converted = _converted(options, say)
    for loss in (*converted.not_read, *converted.not_kept):
        print(f"faultline convert: {options.log}: {loss}", file=sys.stderr)
    if options.json:
        print(msgspec.json.encode(converted).decode())
    else:
        counts = f"{converted.frames} frames, {converted.remote} remote and {converted.errors} error frames"
        print(f"{converted.file}: {counts}")
    return 0


def _converted(options: argparse.Namespace, say: Say) -> Converted:
    target = TARGETS[options.to]
    if str(options.out) == "-":
        raise LogError("--out -: a converted log is read back before it gets its name; give a file")
    say(f"reading {options.log}")
    log = open_any(options.log, options.channel)
    out = options.out or Path(log.id).with_suffix(target.ending)
    if out.exists() and out.samefile(log.source.path):
        raise LogError(f"{out}: is the log itself; give another file with --out")
    if not (log.format.has_times or not target.needs_times):
        able = ", ".join(name for name, each in TARGETS.items() if not each.needs_times)
        raise LogError(f"{options.log}: its frames have no times, and {options.to} needs them; convert it to {able}")
    check_file(out)
    return convert(log, target, options.to, out, say)


@contextmanager
def _progress() -> Iterator[Say]:
    """A line on the terminal, which is gone at the end; nothing where standard error is none."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    try:
        yield lambda text: print(f"{_CLEAR}faultline convert: {text}", end="", file=sys.stderr, flush=True)
    finally:
        print(_CLEAR, end="", file=sys.stderr, flush=True)


@dataclass(frozen=True)
class _Followed(Log):
    """A log that says how far its frames are taken."""

    say: Say = field(default=lambda _: None, repr=False)
    doing: str = ""

    def batches(self) -> Iterator[Batch]:
        """All frames, as those of the log."""
        total = self.report.frames + self.report.remote + self.report.errors
        done, due_s = 0, time.monotonic()
        for batch in super().batches():
            if time.monotonic() >= due_s:
                self.say(f"{self.doing}: {done:,} of {total:,} frames")
                due_s = time.monotonic() + _EVERY_S
            yield batch
            done += len(batch)


def _followed(log: Log, say: Say, doing: str) -> Log:
    return _Followed(**{each.name: getattr(log, each.name) for each in fields(log)}, say=say, doing=doing)


def convert(log: Log, target: Target, name: str, out: Path, say: Say = lambda _: None) -> Converted:
    """Write the log, and read it back.

    Raises:
        LogError: other frames were read back than were written; `out` is as it was.
        OSError: it cannot be written.
    """
    report = log.report
    lost = _not_kept(_followed(log, say, "looking what it holds"), target, name)
    with written_whole(out) as path:
        target.write(_followed(log, say, "writing"), path)
        if path.is_file():
            say("reading it back")
            back = open_any(path).report
            wanted, found = ((each.frames, each.remote, each.errors) for each in (report, back))
            if found != wanted or back.bad:
                raise LogError(
                    f"{out}: {wanted} data, remote and error frames were written, {found} are read back; not kept"
                )
    return Converted(str(out), name, report.frames, report.remote, report.errors, lost, report.losses())


@dataclass
class _Contents:
    """What frames of a log have that not all formats hold."""

    sent: int = 0
    remote_fd: int = 0
    fine: int = 0

    def add(self, log: Log, decimals: int) -> None:
        """Look at all frames."""
        for batch in log.batches():
            self.sent += int(np.count_nonzero(batch.flags & SENT))
            self.remote_fd += int(np.count_nonzero(batch.flags & (FD | REMOTE) == FD | REMOTE))
            parts = batch.time * 10.0**decimals
            self.fine += int(np.count_nonzero(np.abs(parts - np.round(parts)) > 0.3))


def _not_kept(log: Log, target: Target, name: str) -> list[str]:
    """What the format cannot hold of this log, each with how much of it."""
    lost = []
    contents = _Contents()
    if log.format.has_times:
        contents.add(log, target.decimals)
    names = [each for each in log.channels if each]
    if names and not target.has_channels:
        lost.append(f"{name} has no channels: {', '.join(names)} are not kept")
    elif names and not target.names_channels and names != [str(k + 1) for k in range(len(names))]:
        numbered = ", ".join(f"{each} is {k + 1}" for k, each in enumerate(names))
        lost.append(f"{name} numbers channels: {numbered}")
    if contents.sent and not target.flags & SENT:
        lost.append(f"{name} does not say which frames the logger sent: {contents.sent} are marked no longer")
    if contents.fine and target.decimals < 9:
        lost.append(f"{name} has times of {target.decimals} decimals: {contents.fine} are rounded")
    if not target.is_absolute and log.start_s > 1e6:
        lost.append(f"{name} counts times from the first frame, which was at {log.start_s:.6f} s since 1970")
    return lost
