"""Attempts as JSON files: what an interrupted run had done is there when it is called again."""

from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np

from faultline.analysis.discrepancy.name.attempt import Attempt, Glance, Scan
from faultline.writing import write_file

Kept = TypeVar("Kept", bound=Attempt | Glance | Scan)


def keep(path: Path, result: Attempt | Glance | Scan) -> None:
    """Writes it whole or not at all."""
    write_file(path, msgspec.json.encode(result, enc_hook=_plain))


def kept(path: Path, kind: type[Kept]) -> Kept | None:
    """What was kept there; None if nothing was, or not by this version."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=kind, dec_hook=_array)
    except (FileNotFoundError, msgspec.DecodeError):
        return None


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value)} is not kept")


def _array(kind: type, value: object) -> object:
    del kind  # an array is the only thing that JSON has not
    return np.array(value)
