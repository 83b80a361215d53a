"""A bench recording in memory: the controller's samples from the CAN log, and the second logger's."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from faultline.analysis.recordings.external import Samples, read_external
from faultline.analysis.recordings.track import Track, known_part
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.values import FloatArray, Quality
from faultline.service.logs import Frame, LogReport, Recording, load_recording, read_log

REFERENCE = "y_p_ap"
"""The added sensor that the controller's own y_p_du can be aligned with."""

ECU_UNITS = {"y_p_du": "Pa", "n_p": "1/s", "dc_dose": "1"}


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
    recording: Recording
    sha256: str
    dbc: bytes
    frames: list[Frame]
    log: LogReport
    ecu: Ecu
    samples: Samples

    @property
    def p_ap(self) -> Track:
        """What the clocks are aligned by, on the second logger's clock."""
        return known_part(self.samples.t, self.samples.channels[REFERENCE].pressure)

    @property
    def p_du(self) -> Track:
        """And on the CAN clock."""
        return self.ecu.track("y_p_du")

    @property
    def length_s(self) -> float:
        """From the first frame to the last [s]."""
        return self.frames[-1].t - self.frames[0].t


def read_bench(folder: Path) -> Bench:
    """The bench recording in `folder`.

    Raises:
        InputError: it is no bench recording, lacks a file, column, message or signal, or has one that cannot be used.
    """
    recording = load_recording(folder)
    if recording.external is None:
        raise InputError(f"{folder}: kind is {recording.kind}, already ingested; use it as it is")
    if REFERENCE not in recording.external.tables:
        raise InputError(f"{folder}: external.tables has no {REFERENCE}, which the clocks are aligned by")
    can = recording.can_log
    dbc = (folder / can.dbc).read_bytes()
    frames, log = read_log(folder / can.file, can.channel)
    table = compile_dbc(dbc_text(dbc), ECU_UNITS, str(folder / can.dbc), can.senders)
    if can.channel is None and (both := log.on_two_channels(table.carries)):
        raise InputError(
            f"{folder}: the same messages come on {' and '.join(both)}: say which bus with `channel` under [can] in "
            "recording.toml"
        )
    ecu = _ecu(frames, table, folder / can.file)
    sha256 = hashlib.sha256((folder / can.file).read_bytes()).hexdigest()
    return Bench(folder, recording, sha256, dbc, frames, log, ecu, read_external(folder, recording.external))


def _ecu(frames: list[Frame], table: DecodeTable, log_path: Path) -> Ecu:
    """The frames that carry all signals; what is off in one is NaN."""
    rows = []
    for t, can_id, extended, data in frames:
        signals = {
            name: value if quality is Quality.GOOD else np.nan
            for name, value, quality in table.decode(can_id, extended, data)
        }
        if len(signals) == len(ECU_UNITS):
            rows.append((t - frames[0].t, *(signals[name] for name in ECU_UNITS)))
    columns = np.array(rows).reshape(-1, 1 + len(ECU_UNITS))
    columns = columns[np.diff(columns[:, 0], prepend=-1.0) > 0]
    if (np.isfinite(columns).sum(axis=0) < 2).any():
        strangers = "".join(f"; {text}" for text in table.strangers())
        raise InputError(
            f"{log_path}: no frame carries {', '.join(ECU_UNITS)}; was the dosing controller on?{strangers}"
        )
    return Ecu(columns[:, 0], dict(zip(ECU_UNITS, columns.T[1:], strict=True)))
