"""What a log costs from its text or bytes to signals, beside python-can with cantools and asammdf: `make bench`.

Pairs in one process, interleaved, CPU time of the process and its children; medians and spread. The log is the golden
one, repeated to `FRAMES` frames. Also the peak memory of `diagnose` over logs of growing length.
"""

import json
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import cast

import can
import cantools.database
from cantools.database.can import Database

from faultline.service.bundle.load import load_bundle
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.logs import open_any, open_log
from faultline.service.logs.writers import TARGETS

GOLDEN = Path(__file__).parent / "golden"
FRAMES, ROUNDS = 120_000, 7
HOURS = (1 / 6, 1.0, 10.0)
DBC = GOLDEN / "log" / "uds.dbc"
DATABASE = cast("Database", cantools.database.load_string(DBC.read_text(), "dbc"))
UNITS = {each.signal: each.unit for each in load_bundle(GOLDEN / "bundle").manifest.inputs}


TABLES: list[DecodeTable] = []
"""Those of the next runs: a table counts what it decodes, and both sides read the DBC before the time begins."""


def spent_s() -> float:
    """CPU time of this process and of its children that have ended [s]."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def write_repeated(path: Path, times: int) -> None:
    """Write the golden log so many times, one after another, as candump's text."""
    lines = [line.split(" ", 1) for line in (GOLDEN / "log" / "can.log").read_text().splitlines()]
    stamps = [float(stamp.strip("()")) for stamp, _ in lines]
    period = stamps[-1] - stamps[0] + 0.1
    with path.open("w") as file:
        for k in range(times):
            file.writelines(f"({t + k * period:.6f}) {rest}\n" for t, (_, rest) in zip(stamps, lines, strict=True))


def ours(path: Path) -> int:
    """Signals of a log by columns, all of them; their number."""
    signals = open_log(path).signals(TABLES.pop())
    return sum(len(column.value) for piece in signals.pieces() for column in piece.columns.values())


def by_python_can(path: Path) -> int:
    """The same by python-can and cantools: every message that the DBC knows is decoded."""
    known = {message.frame_id for message in DATABASE.messages}
    found = 0
    with can.LogReader(path) as reader:
        for message in reader:
            if message.arbitration_id in known:
                decoded = DATABASE.decode_message(message.arbitration_id, bytes(message.data), decode_choices=False)
                assert isinstance(decoded, dict)
                found += len(UNITS.keys() & decoded.keys())
    return found


def by_asammdf(path: Path) -> int:
    """The same by asammdf, in a process of its own as ours is read in one."""
    code = (
        "import sys, warnings; warnings.simplefilter('ignore'); from asammdf import MDF\n"
        "found = MDF(sys.argv[1]).extract_bus_logging({'CAN': [(sys.argv[2], 0)]})\n"
        "print(sum(len(found.get(n, group=g, index=i)) for n in sys.argv[3:] for g, i in found.whereis(n)))"
    )
    command = [sys.executable, "-c", code, str(path), str(DBC), *UNITS]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def pairs(name: str, path: Path, frames: int, peer: Callable[[Path], int], what: str) -> None:
    """Print what a frame costs ours and the peer, and the ratio of the pairs."""
    spent: dict[Callable[[Path], int], list[float]] = {ours: [], peer: []}
    for turn in range(ROUNDS):
        counts = set()
        for call in (ours, peer) if turn % 2 else (peer, ours):
            TABLES[:] = [compile_dbc(DBC.read_text(), UNITS, str(DBC))]
            start = spent_s()
            counts.add(call(path))
            spent[call].append((spent_s() - start) / frames * 1e6)
        assert len(counts) == 1, counts
    ratio = [theirs / mine for mine, theirs in zip(spent[ours], spent[peer], strict=True)]
    for words, figures, unit in (
        (f"{name}: to signals, a frame", spent[ours], "us"),
        (f"{name}: by {what}", spent[peer], "us"),
        (f"{name}: theirs in parts of ours, of the pairs", ratio, "x "),
    ):
        middle = statistics.median(figures)
        print(f"{words:<60}{middle:>9.2f} {unit}   [{min(figures):.2f} .. {max(figures):.2f}]")


def memory(folder: Path) -> None:
    """Print the peak memory of `diagnose` over logs of growing length."""
    code = (
        "import sys; from faultline.service.diagnose.command import main; main(sys.argv[1:])\n"
        "print([line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')][0])"
    )
    for hours in HOURS:
        path = folder / "long.log"
        write_repeated(path, round(3600 * hours / 120.1))
        command = [sys.executable, "-c", code, str(path), "--bundle", str(GOLDEN / "bundle"), "--json"]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        peak = int(done.stdout.split()[-1]) / 1024
        print(
            f"diagnose, peak memory at {hours:5.2f} h{'':<38}{peak:>9.1f} MiB  ({path.stat().st_size >> 20} MiB of log)"
        )


def main() -> None:
    """All of it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_repeated(folder / "x.log", -(-FRAMES // open_log(GOLDEN / "log").report.frames))
        frames = open_log(folder / "x.log").report.frames
        print(json.dumps({"frames": frames, "rounds": ROUNDS, "log": "the golden one, repeated"}))
        pairs("candump", folder / "x.log", frames, by_python_can, "python-can and cantools")
        for form in ("blf", "asc", "trc", "csv", "db", "mf4"):
            path = folder / f"x.{form}"
            TARGETS[form].write(open_any(folder / "x.log"), path)
            if form == "mf4":
                pairs(form, path, frames, by_asammdf, "asammdf")
            else:
                pairs(form, path, frames, by_python_can, "python-can and cantools")
        memory(folder)


if __name__ == "__main__":
    main()
