"""Resamples every signal to one uniform grid, zero-phase: for pictures and a look at the data, never for residuals.

Thesis 5.8 resamples to 5 Hz behind an FIR anti-aliasing filter. Each piece between two silences is filtered on its own,
and a silence stays empty. A zero-phase filter looks ahead, which nothing on the vehicle can: tuning and evaluation use
the service's causal sampler instead.
"""

from collections.abc import Mapping

import numpy as np
from scipy.signal import filtfilt, firwin

from faultline.analysis.recordings.track import Track
from faultline.service.core.signals.values import FloatArray

PERIOD_S = 0.2
"""Of the grid (thesis 5.8)."""

_FINE = 10  # points of the intermediate grid per output sample
_TAPS = 10 * _FINE + 1
_CUTOFF = 0.8  # of the output's Nyquist frequency, where both passes leave a quarter; at that frequency, 0.6 %


def uniform(tracks: Mapping[str, Track]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Times (K,) [s], multiples of 0.2 s that all tracks span, and each signal there (K,), NaN where it was silent."""
    start = max(float(track.t[0]) for track in tracks.values())
    end = min(float(track.t[-1]) for track in tracks.values())
    first = int(np.ceil(start / PERIOD_S - 1e-9))
    count = max(int(np.floor(end / PERIOD_S + 1e-9)) - first + 1, 0)
    t: FloatArray = np.asarray((first + np.arange(count)) * PERIOD_S, dtype=np.float64)
    return t, {name: _resample(track, t) for name, track in tracks.items()}


def _resample(track: Track, t: FloatArray) -> FloatArray:
    value = np.full(len(t), np.nan)
    for piece in track.pieces():
        inside = (t >= piece.t[0] - 1e-9) & (t <= piece.t[-1] + 1e-9)
        if inside.any():
            value[inside] = _filtered(piece, t[inside])
    return value


def _filtered(piece: Track, t: FloatArray) -> FloatArray:
    fine = np.linspace(t[0], t[-1], (len(t) - 1) * _FINE + 1)
    taps = firwin(_TAPS, _CUTOFF / _FINE)
    filtered = filtfilt(taps, [1.0], piece.at(fine), padlen=min(3 * _TAPS, len(fine) - 1))
    return np.asarray(filtered[::_FINE])
