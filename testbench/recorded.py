"""Reads a recording back: each signal as its logger has it, on that logger's clock."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import can
import cantools.database
import numpy as np
from cantools.database.can import Database
from cantools.errors import Error as CantoolsError

from faultline.testbench.errors import RigError
from faultline.testbench.plant import Array

SCALES = {"kPa": 1e3, "1/s": 1.0, "%": 0.01}
"""What a DBC's unit is in Pa, rev/s and 0..1."""
IDENTITY = 0x03FF_FFFF
"""The bits of an identifier that say what a frame is; the rest are its priority (SAE J1939-21)."""


class Track(NamedTuple):
    """A signal's values (N,) [Pa, rev/s or 0..1] at times `t` (N,) [s]; NaN where the bus says that there is none."""

    t: Array
    value: Array


@dataclass(frozen=True)
class Recorded:
    """A recording: `bus` are the signals on CAN, `external` those of a bench's second logger, on its own clock."""

    id: str
    bus: Mapping[str, Track]
    external: Mapping[str, Track]


def read_recording(folder: Path) -> Recorded:
    """The recording in `folder`, its CAN log in any format that python-can reads.

    Raises:
        RigError: a file is absent, or is not what recording.toml says.
    """
    path = folder / "recording.toml"
    about = read_toml(path)
    try:
        log, dbc, tables = folder / about["can"]["file"], folder / about["can"]["dbc"], about.get("external")
        bus = _bus(log, dbc)
        external = _external(folder / tables["file"], tables) if tables else {}
        return Recorded(str(about["id"]), bus, external)
    except (KeyError, TypeError) as error:
        raise RigError(f"{path}: {error} is missing or misplaced; is this a recording of the rig?") from error


def read_toml(path: Path) -> dict[str, Any]:
    """The file's tables; raises `RigError` if it cannot be read."""
    try:
        return tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    except tomllib.TOMLDecodeError as error:
        raise RigError(f"{path}: not TOML: {error}") from error


def _bus(log: Path, dbc: Path) -> dict[str, Track]:
    try:
        database = cantools.database.load_file(dbc)
        assert isinstance(database, Database)
        messages = {message.frame_id & IDENTITY: message for message in database.messages}
        found: dict[str, list[tuple[float, float]]] = {}
        start = None
        with can.LogReader(log) as reader:
            for frame in reader:
                start = frame.timestamp if start is None else start
                message = messages.get(frame.arbitration_id & IDENTITY)
                if message is None or not frame.is_extended_id:
                    continue
                values = message.decode_simple(bytes(frame.data))
                for signal in message.signals:
                    value = float(str(values[signal.name]))
                    beyond = signal.maximum is not None and value > signal.maximum  # J1939's codes
                    scaled = np.nan if beyond else value * SCALES.get(signal.unit or "", 1.0)
                    found.setdefault(signal.name, []).append((frame.timestamp - start, scaled))
    except OSError as error:
        raise RigError(f"{error.filename or log}: {error.strerror}; is the recording whole?") from error
    except (ValueError, CantoolsError) as error:  # python-can's readers raise the former
        raise RigError(f"{log}: cannot be decoded with {dbc.name}: {_line(error)}") from error
    if not found:
        raise RigError(f"{log}: holds no frame of {dbc.name}; is it of this vehicle?")
    return {name: Track(*np.array(pairs).T) for name, pairs in found.items()}


def _external(path: Path, about: Mapping[str, Any]) -> dict[str, Track]:
    try:
        rows = np.genfromtxt(path, delimiter=",", names=True)
        t = rows[about["time_column"]]
        return {
            signal: Track(t, np.interp(rows[table["column"]], table["volts"], table["pascal"], np.nan, np.nan))
            for signal, table in about["tables"].items()
        }
    except (OSError, ValueError) as error:
        raise RigError(f"{path}: cannot be read as the second logger's CSV: {_line(error)}") from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
