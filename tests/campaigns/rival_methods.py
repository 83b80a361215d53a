"""Rivals of faultline's decision, on the same residuals or signals.

Each is made from some vehicles' recordings and gives, for another recording, a score by tick (an alarm is a score above
a limit, which is set apart from them) and what it would name.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt
from rival_series import Array, Series
from scipy.signal import lfilter
from sklearn.decomposition import PCA
from sklearn.ensemble import RandomForestClassifier

from faultline.service.core.decision.isolation import diagnoses
from faultline.service.core.detectors.spread import LARGEST

MODES = range(4)
"""Indices of the dosing system's modes, the edge first."""

ISOLATED_S = 120.0
"""A rival, too, has so long after its alarm."""
QUANTILE = 0.9
"""nu of the thesis' CUSUM: that of the absolute residual without a fault."""
WINDOW, STRIDE = 300, 50  # ticks: 60 s, looked at every 10 s
SMOOTH = 75  # ticks: 15 s
TREES, LEAF = 200, 5
VARIANCE = 0.9
"""The share that the principal components keep: with five signals, four of them or fewer."""
MEMORY = 150.0  # ticks: 30 s
HALF = 0.5
"""A forest names what is at least half as likely as its likeliest."""


class Rival(Protocol):
    """A method."""

    def fit(self, made_from: Sequence[Series]) -> None:
        """Learns from recordings of vehicles that it is not tried on."""

    def score(self, s: Series) -> Array:
        """The score (K,): the higher, the surer that something is wrong."""

    def names(self, s: Series, t: float, limit: float) -> list[str] | None:
        """What it names after an alarm at `t` [s]: explanations joined by +; None where it only detects."""


class ThesisCusum:
    """The thesis' decision: a CUSUM of |r| with nu and J of each test from one vehicle, and the signature matrix.

    No modes, no sizes. `matrix` holds the faults of each test; names are minimal hitting sets of the tests that
    alarmed, or with `exact` the faults whose column is just those tests.
    """

    def __init__(self, matrix: Sequence[frozenset[str]], *, exact: bool) -> None:
        self._matrix, self._exact = matrix, exact

    def fit(self, made_from: Sequence[Series]) -> None:
        """nu and J from the first vehicle's fault-free drives."""
        number = min(s.vehicle for s in made_from)
        own = [s for s in made_from if s.vehicle == number and s.judged.kind == "free"]
        self._nu = np.array([
            np.quantile(np.concatenate([np.abs(s.r[s.usable[:, j], j]) for s in own]), QUANTILE)
            for j in range(len(self._matrix))
        ])  # fmt: skip
        self._J = np.maximum(np.max([self._sums(s).max(axis=0) for s in own], axis=0), 1e-9)

    def score(self, s: Series) -> Array:
        """The largest sum in parts of its J."""
        return np.asarray((self._sums(s) / self._J).max(axis=1))

    def names(self, s: Series, t: float, limit: float) -> list[str] | None:
        """From the tests that alarmed until then."""
        there = (s.t >= t) & (s.t <= t + ISOLATED_S)
        alarmed = (self._sums(s)[there] / self._J > limit).any(axis=0)
        if not self._exact:
            found = diagnoses([faults for faults, beyond in zip(self._matrix, alarmed, strict=True) if beyond])
            return ["+".join(names) or "unknown" for names in found]
        faults = sorted(frozenset().union(*self._matrix))
        return [f for f in faults if [f in row for row in self._matrix] == alarmed.tolist()] or ["unknown"]

    def _sums(self, s: Series) -> Array:
        """max(0, g + |r| - nu) (K, T), which is the sum above its lowest so far; frozen where a test cannot tell."""
        step = np.where(s.usable, np.abs(s.r.astype(np.float64)) - self._nu, 0.0)
        total = np.cumsum(step, axis=0)
        return np.asarray(total - np.minimum(np.minimum.accumulate(total, axis=0), 0.0))


class Forest:
    """A random forest on residuals' mean and spread by mode over 60 s, trained with other vehicles' faults."""

    def fit(self, made_from: Sequence[Series]) -> None:
        """With every fault and size that they have, and their fault-free drives."""
        X, y = [], []
        for s in made_from:
            ends = _ends(s)
            for end, x in zip(ends, _features(s, ends), strict=True):
                begun = s.t[end - WINDOW + 1]
                if s.t[end] < s.onset_s or (begun >= s.onset_s and len(s.judged.faults) == 1):
                    X.append(x)
                    y.append("none" if s.t[end] < s.onset_s else s.judged.faults[0])
        self._forest = RandomForestClassifier(TREES, min_samples_leaf=LEAF, class_weight="balanced", random_state=0)
        self._forest.fit(np.array(X), y)

    def score(self, s: Series) -> Array:
        """One minus the share of trees for no fault, of the latest window."""
        ends, chances = self._chances(s)
        score = np.zeros(len(s.t))
        wrong = 1.0 - chances[:, [*self._forest.classes_].index("none")]
        for end, value in zip(ends, wrong, strict=True):
            score[end : end + STRIDE] = value
        return score

    def names(self, s: Series, t: float, limit: float) -> list[str] | None:
        """The likeliest faults, over the windows until then."""
        del limit
        ends, chances = self._chances(s)
        told = (s.t[ends] >= t) & (s.t[ends] <= t + ISOLATED_S)
        mean = dict(zip(self._forest.classes_, chances[told].mean(axis=0), strict=True))
        del mean["none"]
        best = max(mean.values())
        return sorted((name for name, p in mean.items() if p >= HALF * best), key=lambda name: -mean[name])

    def _chances(self, s: Series) -> tuple[npt.NDArray[np.int64], Array]:
        ends = _ends(s)
        return ends, np.asarray(self._forest.predict_proba(_features(s, ends)))


def _ends(s: Series) -> npt.NDArray[np.int64]:
    return np.arange(WINDOW - 1, len(s.t), STRIDE)


def _features(s: Series, ends: npt.NDArray[np.int64]) -> Array:
    """Mean and spread (windows, 2 modes T) of each residual by mode; NaN where a mode was not seen."""
    columns = []
    for mode in MODES[1:]:
        inside = s.usable & (s.mode == mode)[:, None]
        sums = [np.cumsum(np.where(inside, power, 0.0), axis=0) for power in (1.0, s.r, s.r.astype(np.float64) ** 2)]
        n, first, second = (_between(total, ends) for total in sums)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(n > 0, first / n, np.nan)
            spread = np.where(n > 1, np.sqrt(np.maximum(second / n - mean**2, 0.0)), np.nan)
        columns += [mean, spread]
    return np.concatenate(columns, axis=1)


def _between(total: Array, ends: npt.NDArray[np.int64]) -> Array:
    before = np.where((ends >= WINDOW)[:, None], total[np.maximum(ends - WINDOW, 0)], 0.0)
    return np.asarray(total[ends] - before)


class Components:
    """Hotelling's T2 and the squared prediction error Q of the raw signals (Jackson, Mudholkar 1979); detects only."""

    def fit(self, made_from: Sequence[Series]) -> None:
        """From fault-free drives."""
        z = np.concatenate([_dosable(s)[1] for s in made_from if s.judged.kind == "free"])
        self._mean, self._sd = z.mean(axis=0), z.std(axis=0)
        self._pca = PCA(VARIANCE).fit((z - self._mean) / self._sd)
        self._usual = np.ones(2)
        both = [self._both(s) for s in made_from if s.judged.kind == "free"]
        self._usual = np.quantile(np.concatenate(both), 0.99, axis=0)

    def score(self, s: Series) -> Array:
        """The larger of T2 and Q over 15 s, each in parts of its 99 % without a fault."""
        score = np.zeros(len(s.t))
        score[_dosable(s)[0]] = self._both(s).max(axis=1)
        return score

    def names(self, s: Series, t: float, limit: float) -> list[str] | None:
        """Nothing."""
        del s, t, limit
        return None

    def _both(self, s: Series) -> Array:
        x = (_dosable(s)[1] - self._mean) / self._sd
        along = self._pca.transform(x)
        T2 = (along**2 / self._pca.explained_variance_).sum(axis=1)
        Q = ((x - self._pca.inverse_transform(along)) ** 2).sum(axis=1)
        kernel = np.ones(SMOOTH) / SMOOTH
        both = np.stack([np.convolve(value, kernel)[: len(value)] for value in (T2, Q)], axis=1)
        return np.asarray(both / self._usual)


class Variance:
    """An exponentially forgotten variance of differences, against that of other drives; detects only.

    For the pump filter: the p_tp residuals get quieter under its clog (thesis ch. 7.4). faultline's own test compares
    a drive with itself (`service.core.detectors.spread`).
    """

    def fit(self, made_from: Sequence[Series]) -> None:
        """Levels and spreads of differences by mode, and the largest |ln v| of each test, from fault-free drives."""
        shape = made_from[0].r.shape[1], len(MODES)
        self._level, self._sd = np.zeros(shape), np.ones(shape)
        for j, mode in np.ndindex(shape):
            inside = [s.usable[:, j] & (s.mode == mode) for s in made_from]
            r = [s.r[there, j].astype(np.float64) for s, there in zip(made_from, inside, strict=True)]
            if sum(map(len, r)) > 1:
                self._level[j, mode] = np.median(np.concatenate(r))
                self._sd[j, mode] = max(np.sqrt(np.mean(np.concatenate([*map(np.diff, r)]) ** 2) / 2.0), 1e-9)
        self._J = np.max([self._logs(s).max(axis=0) for s in made_from], axis=0)

    def score(self, s: Series) -> Array:
        """The largest |ln v| in parts of its J."""
        return np.asarray((self._logs(s) / self._J).max(axis=1))

    def names(self, s: Series, t: float, limit: float) -> list[str] | None:
        """Nothing."""
        del s, t, limit
        return None

    def _logs(self, s: Series) -> Array:
        """|ln v| (K, T), held where a test cannot tell."""
        logs = np.zeros(s.r.shape)
        for j in range(s.r.shape[1]):
            level = (s.r[:, j] - self._level[j, s.mode]) / self._sd[j, s.mode]
            steps = s.usable[:, j] & np.concatenate([[False], s.usable[:-1, j]])  # over a gap there is none
            square = np.minimum(np.diff(level, prepend=0.0)[steps] ** 2 / 2.0, LARGEST)
            v, _ = lfilter([1.0 / MEMORY], [1.0, 1.0 / MEMORY - 1.0], square, zi=[1.0 - 1.0 / MEMORY])
            logs[:, j] = np.abs(np.log(np.concatenate([[1.0], v])))[np.cumsum(steps)]
        return logs


def _dosable(s: Series) -> tuple[npt.NDArray[np.bool_], Array]:
    """Where some test could tell (K,): the pressure has been built up; and the samples there."""
    there = s.usable.any(axis=1)
    return np.asarray(there), np.asarray(s.z[there], dtype=np.float64)
