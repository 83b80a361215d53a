"""An interrupted training goes on where it stopped: its state in one file, written whole or not at all."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import msgspec
import torch

from faultline.analysis.model import dump_model
from faultline.service.core.errors import InputError
from faultline.training.layout import Layout
from faultline.training.loop import Begin, Training
from faultline.training.recipe import Recipe
from faultline.training.samples import Samples
from faultline.writing import write_file

FILE = "checkpoint.pt"

UNREADABLE: tuple[type[Exception], ...] = (
    *(RuntimeError, EOFError, UnpicklingError, OSError, KeyError, IndexError, AttributeError, TypeError, ValueError),
)
"""What torch raises for a file that is no such thing, and what such a thing lacks."""


def reason(error: Exception) -> str:
    """The error's first line."""
    return str(error).partition("\n")[0] or type(error).__name__


def key_of(layout: Layout, samples: Samples, recipe: Recipe, seed: int, begin: Begin | None = None) -> str:
    """What a training depends on: recordings, model and tests, recipe, seed, where it begins, this version of torch."""
    before = [] if begin is None else [value.tolist() for value in begin.weights.values()]
    tests = [dump_model(layout.model), *(test.name for test in layout.tests)]
    seen = [hashlib.sha256(stretch.z.tobytes()).hexdigest() for stretch in samples.stretches]
    given = [before, seen, tests, asdict(recipe), seed, str(torch.__version__)]
    return hashlib.sha256(msgspec.json.encode(given)).hexdigest()


def save_checkpoint(folder: Path, key: str, training: Training) -> None:
    """Keeps the state of a training."""
    write_file(folder / FILE, encoded({"key": key, **training.state()}))


def encoded(state: Mapping[str, Any]) -> bytes:
    """The state as torch writes it."""
    raw = BytesIO()
    torch.save(state, raw)
    return raw.getvalue()


def load_checkpoint(folder: Path, key: str, training: Training) -> bool:
    """Puts a training where it was; False if there is no checkpoint.

    Raises:
        InputError: the checkpoint is of another training, or damaged.
    """
    path = folder / FILE
    if not path.is_file():
        return False
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        there = state["key"]
        if there == key:
            training.restore(state)
    except UNREADABLE as error:
        raise InputError(f"{path}: cannot be read, {reason(error)}; train without --resume") from error
    if there != key:
        raise InputError(
            f"{path}: is of another training (recordings, model, tests, recipe or seed); train without --resume"
        )
    return True


def drop_checkpoint(folder: Path) -> None:
    """Once networks are there, it is no longer needed."""
    (folder / FILE).unlink(missing_ok=True)
