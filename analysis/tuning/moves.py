"""Residuals of fault-free recordings move with other values of parameters, faults and samples."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.bank import Bank, Trial
from faultline.analysis.tuning.thresholds import Seen

Array = npt.NDArray[np.float64]

SIDE_BY_SIDE = 64
"""Rows of a batch up to which recordings are computed together: a step of 64 takes twice the time of one of 9."""
MOST_SAMPLES = 2_000_000
"""Ticks times rows up to which they are: residuals of ten tests are 160 MB then."""


class Moves:
    """Computes how far residuals move with trials in recordings, each once: folds share most of their drives."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], tuple[object, dict[int, Array]]] = {}

    def of(
        self, bank: Bank, recordings: Sequence[Seen], trials: Sequence[Trial], steps: Array
    ) -> list[dict[int, Array]]:
        """Return the sum (n, rows) over the ticks of each mode of every recording, its samples `steps` (n, nz) on."""
        names = tuple(generator.name for generator in bank.generators)
        what = repr([sorted(trial.items()) for trial in trials])
        keys = [
            (id(bank.model), names, id(s.z), s.usable.all(axis=1).tobytes(), what, steps.tobytes()) for s in recordings
        ]
        missing = {key: s for key, s in zip(keys, recordings, strict=True) if key not in self._known}
        for key, moved in zip(missing, _moved(bank, [*missing.values()], trials, steps), strict=True):
            self._known[key] = (bank.model, missing[key].z), moved  # held, as their identity is the key
        return [self._known[key][1] for key in keys]


def _moved(bank: Bank, recordings: Sequence[Seen], trials: Sequence[Trial], steps: Array) -> Iterator[dict[int, Array]]:
    every = [{}, *trials]
    longest = max((len(s.z) for s in recordings), default=1)
    together = max(1, min(SIDE_BY_SIDE, MOST_SAMPLES // longest) // len(every))
    for first in range(0, len(recordings), together):
        some = recordings[first : first + together]
        r = bank.simulate(every * len(some), *_samples(bank, some, steps))
        for s, of in zip(some, np.split(r, len(some), axis=1), strict=True):
            moved, usable = of[: len(s.z), 1:] - of[: len(s.z), :1], s.usable.all(axis=1)
            yield {mode: moved[usable & (s.mode == mode)].sum(axis=0) for mode in range(len(s.modes))}


def _samples(bank: Bank, recordings: Sequence[Seen], steps: Array) -> tuple[Array, Array]:
    """The samples (K, rows, nz) as they are and `steps` (n, nz) on, and states at the start (rows, nx), side by side.

    The shorter recordings hold their last samples.
    """
    longest, rows = max(len(s.z) for s in recordings), np.concatenate([np.zeros((1, steps.shape[1])), steps])
    z = [np.pad(s.z, ((0, longest - len(s.z)), (0, 0)), mode="edge")[:, None] + rows for s in recordings]
    side_by_side = np.concatenate(z, axis=1)
    return side_by_side, np.array([bank.start(first) for first in side_by_side[0]])
