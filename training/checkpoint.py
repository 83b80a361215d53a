"""An interrupted training goes on where it stopped: its state in one file, written whole or not at all."""

import hashlib
from dataclasses import asdict
from pathlib import Path
from pickle import UnpicklingError

import msgspec
import torch

from service.core.errors import InputError
from training.layout import Layout
from training.loop import Begin, Training
from training.recipe import Recipe
from training.samples import Samples

FILE = "checkpoint.pt"


def key_of(layout: Layout, samples: Samples, recipe: Recipe, seed: int, begin: Begin | None = None) -> str:
    """What a training depends on: recordings, tests, recipe, seed, with what it begins, and this version of torch."""
    tests = [(test.name, test.predicts, test.known, test.states) for test in layout.tests]
    arrays = [layout.rates.tolist(), layout.outputs.tolist()]
    before = [] if begin is None else [value.tolist() for value in begin.weights.values()]
    given = [before, samples.digests, layout.signals, tests, arrays, asdict(recipe), seed, str(torch.__version__)]
    return hashlib.sha256(msgspec.json.encode(given)).hexdigest()


def save_checkpoint(folder: Path, key: str, training: Training) -> None:
    """Keeps the state of a training.

    Raises:
        InputError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        new = folder / f"{FILE}.new"
        torch.save({"key": key, **training.state()}, new)
        new.replace(folder / FILE)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}; give --out another place") from error


def load_checkpoint(folder: Path, key: str, training: Training) -> bool:
    """Puts a training where it was; False if there is no checkpoint.

    Raises:
        InputError: the checkpoint is of another training, or damaged.
    """
    path = folder / FILE
    if not path.is_file():
        return False
    try:
        state = torch.load(path, weights_only=True)
    except (RuntimeError, EOFError, UnpicklingError, OSError) as error:
        raise InputError(f"{path}: cannot be read; train without --resume: {str(error).splitlines()[0]}") from error
    if state.get("key") != key:
        raise InputError(f"{path}: is of another training (recordings, tests, recipe or seed); train without --resume")
    training.restore(state)
    return True


def drop_checkpoint(folder: Path) -> None:
    """Once networks are there, it is no longer needed."""
    (folder / FILE).unlink(missing_ok=True)
