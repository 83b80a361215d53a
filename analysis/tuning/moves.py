"""Residuals of fault-free recordings move with other values of parameters, faults and samples."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.bank import Bank, Trial
from faultline.analysis.tuning.thresholds import Seen

Array = npt.NDArray[np.float64]


class Moves:
    """Computes how far residuals move with trials in recordings, each once: folds share most of their drives."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], tuple[object, dict[int, Array]]] = {}

    def of(self, bank: Bank, s: Seen, trials: Sequence[Trial], steps: Array) -> dict[int, Array]:
        """Return the sum (n, rows) over the ticks of each mode of a recording, its samples `steps` (n, nz) on."""
        names = tuple(generator.name for generator in bank.generators)
        what = repr([sorted(trial.items()) for trial in trials])
        key = id(bank.model), names, id(s.z), s.usable.all(axis=1).tobytes(), what, steps.tobytes()
        if key not in self._known:
            self._known[key] = (bank.model, s.z), _moved(bank, s, trials, steps)  # held, as their identity is the key
        return self._known[key][1]


def _moved(bank: Bank, s: Seen, trials: Sequence[Trial], steps: Array) -> dict[int, Array]:
    z = s.z[:, None] + np.concatenate([np.zeros((1, steps.shape[1])), steps])  # (K, 1 + n, nz)
    r = bank.simulate([{}, *trials], z, np.array([bank.start(first) for first in z[0]]))
    moved, usable = r[:, 1:] - r[:, :1], s.usable.all(axis=1)
    return {mode: moved[usable & (s.mode == mode)].sum(axis=0) for mode in range(len(s.modes))}
