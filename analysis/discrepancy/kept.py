"""Attempts as JSON files: what an interrupted run had done is there when it is called again."""

import os
from pathlib import Path

import msgspec
import numpy as np

from analysis.discrepancy.attempt import Attempt
from service.core.errors import InputError


def keep(path: Path, attempt: Attempt) -> None:
    """Writes it whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        new = path.with_suffix(".new")
        new.write_bytes(msgspec.json.encode(attempt, enc_hook=_plain))
        os.replace(new, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; give --out another place") from error


def kept(path: Path) -> Attempt | None:
    """What was kept there; None if nothing was, or not by this version."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Attempt, dec_hook=_array)
    except (FileNotFoundError, msgspec.DecodeError):
        return None


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value)} is not kept")


def _array(kind: type, value: object) -> object:
    return np.array(value)
