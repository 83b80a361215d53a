"""What the recordings would have been with other inputs: a network shall learn the plant, not the loop around it.

Where a controller drives the plant, its inputs follow from its outputs, and a network learns to tell one from the
other: under another controller that is wrong. A recording cannot say what it would have been had the pump turned
differently. The equations can, nearly: a varied example is the recording with its signals moved by a smooth noise, its
states and predictions moved by as much as the equations say that they move.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from faultline.analysis.model import Model
from faultline.training.layout import Layout
from faultline.training.reckoned import Equations, Example

Array = npt.NDArray[np.float64]

BAND = (0.4, 4.0)
"""Of the noise, in periods a settling time, with a power that falls as 1/f: faster than that, recordings know better
how signals are delayed."""


def varied(
    layout: Layout, examples: Sequence[Example], equations: Equations | None, amplitude: float, copies: int, seed: int
) -> list[Example]:
    """So many copies of every example, varied by `amplitude` of the spread of every signal; none without equations.

    Copies over which the equations run away are left out.
    """
    if equations is None:
        return []
    rng = np.random.default_rng([seed, copies])
    z = np.concatenate([example.z for example in examples])
    spread = z.std(axis=0)
    lower, upper = (np.array([getattr(layout.model.known[s], name) for s in layout.signals]) for name in ("min", "max"))
    size, nz = amplitude * spread, len(spread)
    moved = [
        (example, np.clip(example.z + size * slow_noise(len(example.z), nz, layout.model, rng), lower, upper))
        for example in examples
        for _ in range(copies)
    ]
    if not moved:
        return []
    usual = dict(zip(map(id, examples), equations.courses([example.z for example in examples]), strict=True))
    found = []
    for (example, other), (there, told) in zip(moved, equations.courses([z for _, z in moved]), strict=True):
        states, predictions = usual[id(example)]
        x, y = example.x + there - states, example.y + told - predictions
        if np.isfinite(x).all() and np.isfinite(y).all():
            found.append(example._replace(natural=False, z=other, x=x, y=y))
    return found


def slow_noise(ticks: int, signals: int, model: Model, rng: np.random.Generator) -> Array:
    """Independent noises (K, nz) of the band, of spread one."""
    low, high = (bound / model.settling_s for bound in BAND)  # Hz
    frequency = np.fft.rfftfreq(ticks, model.period_s)
    inside = (frequency >= low) & (frequency <= high)
    size = inside / np.sqrt(np.maximum(frequency, low))
    parts = rng.normal(size=(2, signals, len(frequency)))
    noise = np.fft.irfft(size * (parts[0] + 1j * parts[1]), ticks, axis=1).T
    return np.asarray(noise / noise.std(axis=0))
