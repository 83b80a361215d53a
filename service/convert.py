"""Convert a log to another format, and say what that cannot hold."""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from faultline.options import Parser
from faultline.service.logs import Log, LogError, open_any
from faultline.service.logs.batch import FD, REMOTE, SENT
from faultline.service.logs.writers import TARGETS, Target
from faultline.writing import check_file, written_whole

EXAMPLE = """example:
  faultline convert drive.mf4 --to candump
  faultline convert drive.log.gz --to parquet --channel can1 --out out/drive.parquet

The result is read back before it gets its name: a frame that is not in it is an error. What the format cannot hold, as
names of channels, is said. Parquet and MF4 need the extras `columns` and `mf4`. The columns of Parquet: docs/logs.md.
"""


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
    target = TARGETS[options.to]
    log = open_any(options.log, options.channel)
    out = options.out or Path(log.id).with_suffix(target.ending)
    if out.exists() and out.samefile(log.source.path):
        raise LogError(f"{out}: is the log itself; give another file with --out")
    if not (log.format.has_times or not target.needs_times):
        able = ", ".join(name for name, each in TARGETS.items() if not each.needs_times)
        raise LogError(f"{options.log}: its frames have no times, and {options.to} needs them; convert it to {able}")
    check_file(out)
    converted = convert(log, target, options.to, out)
    for loss in (*converted.not_read, *converted.not_kept):
        print(f"faultline convert: {options.log}: {loss}", file=sys.stderr)
    if options.json:
        print(msgspec.json.encode(converted).decode())
    else:
        print(f"{out}: {converted.frames} frames, {converted.remote} remote and {converted.errors} error frames")
    return 0


def convert(log: Log, target: Target, name: str, out: Path) -> Converted:
    """Write the log, and read it back.

    Raises:
        LogError: other frames were read back than were written; `out` is as it was.
        OSError: it cannot be written.
    """
    report = log.report
    lost = _not_kept(log, target, name)
    with written_whole(out) as path:
        target.write(log, path)
        if path.is_file():
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
