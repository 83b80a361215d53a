"""A bench recording in memory: the controller's samples from the CAN log, and the second logger's."""

import hashlib
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from faultline.analysis.model import load_model
from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.model.file import SYSTEMS, model_file
from faultline.analysis.model.system import SYSTEM
from faultline.analysis.recordings.external import Samples, read_external
from faultline.analysis.recordings.track import Track, known_part
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.values import FloatArray, Quality
from faultline.service.logs import Frame, LogReport, Recording, load_recording, read_log


def setup_of(system: str | None) -> BenchSetup:
    """How this system is measured on its test bench; without a name, the only shipped one that has a `[bench]`.

    Raises:
        InputError: there is no such system, it is not valid, or it has no `[bench]`.
    """
    if system is None:
        files = sorted(SYSTEMS.glob(f"*/{SYSTEM}"))
        having = [file.parent.name for file in files if "bench" in tomllib.loads(file.read_text())]
        if len(having) != 1:
            raise InputError(f"which system is on the bench? give --system, one of {', '.join(having)} or a folder")
        [system] = having
    setup = load_model(system).bench
    if setup is None:
        raise InputError(
            f"{model_file(system).with_name(SYSTEM)}: has no [bench], which says what the clocks are aligned by; add "
            "it as docs/recordings.md has it, or give another --system"
        )
    return setup


@dataclass(frozen=True)
class Ecu:
    """The controller's own samples: `t` (N,) [s] after the first frame; by signal (N,) in SI units, NaN where off."""

    t: FloatArray
    values: dict[str, FloatArray]

    def track(self, name: str) -> Track:
        """The samples of a signal that have a value."""
        return known_part(self.t, self.values[name])


@dataclass(frozen=True)
class Bench:
    """All of a bench recording; `where` names the folder in errors, `sha256` is that of its CAN log."""

    where: Path
    setup: BenchSetup
    recording: Recording
    sha256: str
    dbc: bytes
    frames: list[Frame]
    log: LogReport
    ecu: Ecu
    samples: Samples

    @property
    def follower(self) -> Track:
        """What the clocks are aligned by, on the second logger's clock."""
        return known_part(self.samples.t, self.samples.channels[self.setup.follower].pressure)

    @property
    def reference(self) -> Track:
        """And on the CAN clock."""
        return self.ecu.track(self.setup.reference)

    @property
    def length_s(self) -> float:
        """From the first frame to the last [s]."""
        return self.frames[-1].t - self.frames[0].t


def read_bench(folder: Path, setup: BenchSetup) -> Bench:
    """The bench recording in `folder`, of a system that is measured so.

    Raises:
        InputError: it is no bench recording, lacks a file, column, message or signal, or has one that cannot be used.
    """
    recording = load_recording(folder)
    if recording.external is None:
        raise InputError(f"{folder}: kind is {recording.kind}, already ingested; use it as it is")
    if setup.follower not in recording.external.tables:
        raise InputError(f"{folder}: external.tables has no {setup.follower}, which the clocks are aligned by")
    can = recording.can_log
    dbc = (folder / can.dbc).read_bytes()
    frames, log = read_log(folder / can.file, can.channel)
    table = compile_dbc(dbc_text(dbc), setup.units, str(folder / can.dbc), can.senders)
    if can.channel is None and (both := log.on_two_channels(table.carries)):
        raise InputError(
            f"{folder}: the same messages come on {' and '.join(both)}: say which bus with `channel` under [can] in "
            "recording.toml"
        )
    ecu = _ecu(frames, table, [*setup.units], folder / can.file)
    sha256 = hashlib.sha256((folder / can.file).read_bytes()).hexdigest()
    return Bench(folder, setup, recording, sha256, dbc, frames, log, ecu, read_external(folder, recording.external))


def _ecu(frames: list[Frame], table: DecodeTable, names: list[str], log_path: Path) -> Ecu:
    """The frames that carry all signals; what is off in one is NaN."""
    rows = []
    for t, can_id, extended, data in frames:
        signals = {
            name: value if quality is Quality.GOOD else np.nan
            for name, value, quality in table.decode(can_id, extended, data)
        }
        if len(signals) == len(names):
            rows.append((t - frames[0].t, *(signals[name] for name in names)))
    columns = np.array(rows).reshape(-1, 1 + len(names))
    columns = columns[np.diff(columns[:, 0], prepend=-1.0) > 0]
    if (np.isfinite(columns).sum(axis=0) < 2).any():
        strangers = "".join(f"; {text}" for text in table.strangers())
        raise InputError(f"{log_path}: no frame carries {', '.join(names)}; was the controller on?{strangers}")
    return Ecu(columns[:, 0], dict(zip(names, columns.T[1:], strict=True)))
