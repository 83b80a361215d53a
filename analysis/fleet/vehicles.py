"""The same command for every vehicle of a fleet with its own recordings, each in a process of its own.

In `OUT/vehicle=truck-17/` are what the command writes, what it said (`COMMAND.txt`), and how it ended and of what
(`COMMAND.json`): the same is not done again.
"""

import hashlib
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from faultline.analysis.fleet.drives import VEHICLE, Drive, at_hand, digest, safe
from faultline.service.distribution import installed_version
from faultline.service.logs import LogError
from faultline.service.logs.recording import load_recording
from faultline.writing import write_files

RUN = "import sys; from faultline.service.cli import main; sys.exit(main())"


@dataclass(frozen=True)
class Order:
    """`faultline COMMAND SUBJECT RECORDINGS... OPTION OUT/vehicle=.../FILE EXTRA...`, for each vehicle.

    Where it `takes_dbc`, it takes the DBC of the first recording in place of the recordings.
    """

    command: str
    subject: str
    option: str
    file: str
    extra: tuple[str, ...]
    out: Path
    takes_dbc: bool = False

    def arguments(self, vehicle: str, recordings: Sequence[Path]) -> list[str]:
        """The arguments for a vehicle."""
        there = [str(path) for path in recordings]
        if self.takes_dbc:
            there = ["--dbc", str(recordings[0] / load_recording(recordings[0]).can_log.dbc)]
        given = [arg.replace(VEHICLE, safe(vehicle)) for arg in (self.subject, *self.extra)]
        target = str(self.folder(vehicle) / self.file)
        return [self.command, given[0], *there, self.option, target, *given[1:]]

    def folder(self, vehicle: str) -> Path:
        """The folder of a vehicle."""
        return self.out / f"vehicle={safe(vehicle)}"


class Done(msgspec.Struct, frozen=True):
    """How it ended for a vehicle: exit code, last line that was said, duration [s], and the key of what made it."""

    vehicle: str
    code: int
    said: str
    seconds: float
    key: str
    is_old: bool = False


Vehicle = tuple[str, tuple[Drive, ...]]


def by_vehicle(drives: Sequence[Drive]) -> list[Vehicle]:
    """Return the drives of each vehicle.

    Raises:
        LogError: a drive is no recording, which alone says whose it is and what is in it.
    """
    found: dict[str, list[Drive]] = {}
    for drive in drives:
        if not drive.is_folder:
            raise LogError(f"{drive.url}: is no recording; `faultline ingest --init LOG` makes one of a log")
        with at_hand(drive) as path:
            found.setdefault(load_recording(path).vehicle, []).append(drive)
    return [(vehicle, tuple(own)) for vehicle, own in sorted(found.items())]


def ordered(vehicles: Sequence[Vehicle], order: Order) -> list[Done]:
    """In a worker: run the command for these vehicles, but for those of which the same is done.

    Raises:
        OSError: the vehicle's folder cannot be written.
    """
    return [_ordered(vehicle, drives, order) for vehicle, drives in vehicles]


def lost(vehicles: Sequence[Vehicle]) -> list[Done]:
    """Return how it ended for vehicles at which workers died."""
    return [
        Done(vehicle, 3, "the workers that were at it died: too little memory?", 0.0, "") for vehicle, _ in vehicles
    ]


def _ordered(vehicle: str, drives: Sequence[Drive], order: Order) -> Done:
    folder, began = order.folder(vehicle), time.monotonic()
    with ExitStack() as stack:
        recordings = [stack.enter_context(at_hand(drive)) for drive in drives]
        key = _key(order, vehicle, recordings)
        if (before := done(folder, order.command)) is not None and before.key == key and before.code in (0, 1):
            return msgspec.structs.replace(before, is_old=True)
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-c", RUN, *order.arguments(vehicle, recordings)]
        with _aside(folder / order.file):
            run = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  our own command
    said = run.stdout + run.stderr
    last = next((line for line in reversed((run.stderr + run.stdout).splitlines()) if line.strip()), "")
    ended = Done(vehicle, run.returncode, last, time.monotonic() - began, key)
    write_files({folder / f"{order.command}.txt": said, folder / f"{order.command}.json": msgspec.json.encode(ended)})
    return ended


@contextmanager
def _aside(target: Path) -> Iterator[None]:
    """Put an earlier result aside, as commands overwrite none; where there is no new one after it, it comes back."""
    before = target.with_name(f".{target.name}.before")
    if target.exists():
        _remove(before)
        target.rename(before)
    yield
    if target.exists():
        _remove(before)
    elif before.exists():
        before.rename(target)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def done(folder: Path, command: str) -> Done | None:
    """Return how a command ended for the vehicle of a folder, the last time; None if it never did."""
    with suppress(OSError, msgspec.MsgspecError):
        return msgspec.json.decode((folder / f"{command}.json").read_bytes(), type=Done)
    return None


def _key(order: Order, vehicle: str, recordings: Sequence[Path]) -> str:
    """What the result hangs on: the recordings, every file or folder that an argument names, and the version."""
    given = [arg.replace(VEHICLE, safe(vehicle)) for arg in (order.subject, *order.extra)]
    named = [digest(Path(arg)) if Path(arg).exists() else "" for arg in given]
    parts = [order.command, order.file, *given, *named, *map(digest, recordings), installed_version()]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
