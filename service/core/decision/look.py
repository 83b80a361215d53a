"""Weighs what may be wrong by sign, size and pattern of the residuals over the operating modes.

A window has the mean residual m_c of every mode c, and the mean shift mu_h that each hypothesis h would have made in
the same operation; all modes stacked, how badly h fits is its misfit

    q_h = d' S_h^-1 d,   d = m - offset - baseline - mu_h,   S_h = P + S + diag((gamma mu_h)^2)

with what is known of the baseline and its covariance P, the scatter S of what was seen (`core.decision.straying`), and
gamma for the error of the prediction itself. Size is free: a fault's misfit is that of its best size, on the straight
line between those that are assumed. Without a fault mu is zero. Means of a generator that could not tell are left out.

Of two faults at once the shifts are added, and both sizes are free. A disturbance (what is no component's fault) is
weighed as a fault is, but not as one of two.

A severe fault may have a consequence, another one's effect: a filter that is all but shut starves the pump. How much of
it comes differs from mode to mode, so it has a size of its own in each mode in which it shows; the fault has one size
in all of them. Its misfit is the better of those with and without a consequence.

A fault without assumed sizes, where no formula says what it does, may shift the means of the generators that are
sensitive to it by anything. Its misfit is -2 log of the marginal likelihood under Zellner's g-prior, with the g that is
likeliest (Liang et al. 2008): q_rest + m (1 + ln(Q/m)), where q_rest is the misfit of no fault in the other means, and
Q = q_0 - q_rest. The second term is the price of a free shift; it is no part of what has to fit. m counts shifts that
are free of each other: generators that predict the same signal are shifted alike, so that they count once in a mode.
Nor has a fault to shift the predictions of all signals: each that is left as it is costs -2 ln `UNMOVED`, and that
choice counts which has the least misfit. Beside free shifts a fault with assumed sizes has a price too: of its size.
"""

from collections.abc import Mapping
from functools import cached_property
from itertools import combinations
from math import erfc, log, sqrt
from typing import NamedTuple

import numpy as np

from faultline.service.core.decision.growth import Growth, present_sizes
from faultline.service.core.decision.straying import History
from faultline.service.core.signals.values import FloatArray, Indices, Mask

GAMMA = 0.1

SIZES = 33
"""Sizes from one assumed size to the next at which the misfit is asked for an interval."""

BETWEEN = 8
"""Parts of the way from one size to the next at which a fault with its consequence is tried."""

GROWN = 15.0
"""A fault that has grown must fit better by this than one of one size: its course is free."""

COURSE = 4.0
"""A course of growth costs the misfit of a present size this much: two more numbers are free (Akaike 1974)."""

NEAREST = 8
"""Courses of growth that are nearest by each mean for itself, of which the misfit is computed."""

SHOWING = 0.1
"""A consequence shows in a mode if it does in more than this part of the ticks: some of each is between the two."""

UNMOVED = 0.3
"""The probability that a fault does not show in the predictions of a signal that are sensitive to it: of severe faults
of two trucks of development a quarter of the tests did not alarm."""

MOST_CHOSEN = 4
"""Signals of which any choice may be moved by a free shift."""

TIE = 9.0
"""Hypotheses whose misfits differ by less than three standard deviations are not told apart."""

UNLIKELY = 3.72
"""Standard deviations of a normal variable that one in ten thousand exceeds: a larger misfit is no fit."""


class Segments(NamedTuple):
    """Neighbouring sizes of one sign: the fault of each, and its ends as rows of the shifts, of which row 0 is none.

    `shares` are the parameters of which a second form takes a share; those of one fault, form and sign are a chain, by
    its number. Those of `alone` are never one of two.
    """

    alone: frozenset[str]
    faults: list[str]
    shares: list[str | None]
    chain: Indices
    begin: Indices
    end: Indices


Signatures = Mapping[str, Indices]
"""Each fault without assumed sizes has, of every generator of the evidence (K,), the number of the signal that this
predicts, -1 where it is not sensitive to the fault."""


class Consequences(NamedTuple):
    """A fault with its consequence: `rows` (I, J) of the shifts by I sizes of the fault and J of what it brings.

    The first of the J is none. It `shows` in modes (C,).
    """

    rows: Indices
    shows: Mask


class Fitted(NamedTuple):
    """A fault at its best size: so far along a row of the segments."""

    misfit: float
    row: int
    part: float


class Profile(NamedTuple):
    """The misfits (M,) of sizes of one chain: so far `parts` (M,) along `rows` (M,) of the segments."""

    rows: Indices
    parts: FloatArray
    misfits: FloatArray


class Look:
    """One look at a window: the deviations `d` (D,) of the means `seen` (C, K), and what may explain them.

    `S` (D, D) is their covariance without the error of a prediction, `shifts` (1 + H, D) those of no fault and of every
    hypothesis. `brought` are the faults whose consequence shows. `prices` are what a free shift costs the explanations
    that have one, as far as they have been weighed.
    """

    def __init__(
        self,
        d: FloatArray,
        S: FloatArray,
        seen: Mask,
        shifts: FloatArray,
        segments: Segments,
        signatures: Signatures,
        brought: Mapping[str, Consequences],
        history: History | None = None,
    ) -> None:
        self._d, self._S, self._seen, self.segments, self._signatures = d, S, seen, segments, signatures
        self._shifts, self.brought, self._history = shifts, brought, history
        self.prices: dict[tuple[str, ...], float] = {}
        self._nothing_in: dict[bytes, float] = {}
        self._white = np.linalg.cholesky(S).astype(np.float64, copy=False)
        self._whitener = np.linalg.inv(self._white)
        self._target = self._whitener @ d

    @cached_property
    def _white_shifts(self) -> FloatArray:
        return self._whitened(self._shifts)

    @cached_property
    def _begin(self) -> FloatArray:
        """The shifts at which segments begin (segments, D), whitened."""
        return np.asarray(self._white_shifts[self.segments.begin])

    @cached_property
    def _way(self) -> FloatArray:
        """Return the vectors (segments, D) from where segments begin to where they end, whitened."""
        return np.asarray(self._white_shifts[self.segments.end] - self._begin)

    @cached_property
    def _length(self) -> FloatArray:
        """The squared lengths of the ways."""
        return np.asarray(np.maximum((self._way**2).sum(axis=1), 1e-300))

    @cached_property
    def sigmas(self) -> FloatArray:
        """How far every mean (C, K) lies from the fault-free one, in standard deviations; 0 where none was seen."""
        far = np.zeros(self._seen.shape)
        far[self._seen] = np.abs(self._d) / np.sqrt(self._S.diagonal())
        return far

    @property
    def nothing(self) -> float:
        """The misfit of no fault."""
        return float(self._target @ self._target)

    def nothing_in(self, means: Mask) -> float:
        """The misfit of no fault in those of the means (C, K) that were seen."""
        rows = means[self._seen]
        if (key := rows.tobytes()) not in self._nothing_in:
            d, S = self._d[rows], self._S[np.ix_(rows, rows)]
            self._nothing_in[key] = float(d @ np.linalg.solve(S, d))
        return self._nothing_in[key]

    @cached_property
    def faults(self) -> dict[str, float]:
        """The misfit of every fault at its best size."""
        sized = {fault: fitted.misfit for fault, fitted in self.fitted.items()}
        if not self.has_free_shifts:
            return sized
        self.prices |= {(fault,): self._price(1, self.nothing - misfit) for fault, misfit in sized.items()}
        sized = {fault: misfit + self.prices[fault,] for fault, misfit in sized.items()}
        return sized | {fault: self._of_free_shift((fault,), rows) for fault, rows in self._signatures.items()}

    @property
    def has_free_shifts(self) -> bool:
        """Return True if some fault has no assumed sizes."""
        return bool(self._signatures)

    def _of_free_shift(self, faults: tuple[str, ...], signature: Indices) -> float:
        """Return the misfit of faults that shift some means of the generators of a signature (K,) by any amount."""
        best, sensitive = self.nothing, np.unique(signature[self._seen.any(axis=0) & (signature >= 0)]).tolist()
        for signals in _some_of(sensitive):
            moved = self._seen & np.isin(signature, signals)
            count = sum(len(np.unique(signature[row])) for row in moved)
            rest = self.nothing_in(self._seen & ~moved)
            price = self._price(count, self.nothing - rest) - 2.0 * (len(sensitive) - len(signals)) * log(UNMOVED)
            if rest + price < best:
                best, self.prices[faults] = rest + price, price
        return best

    @staticmethod
    def _price(count: int, gain: float) -> float:
        """Return what `count` free numbers cost the misfit by which they lower it."""
        return count * (1.0 + float(np.log(max(gain / count, 1.0)))) if count else 0.0

    def fits(self, faults: tuple[str, ...], misfit: float) -> bool:
        """Return True if an explanation of this misfit fits the means, apart from the price of a free shift."""
        return misfit - self.prices.get(faults, 0.0) <= self.limit

    def chance(self, faults: tuple[str, ...], misfit: float) -> float:
        """Return the probability that chance leaves more of an explanation that is right: of chi-square, as `limit`."""
        degrees = len(self._d)
        part = max(misfit - self.prices.get(faults, 0.0), 0.0) / degrees
        z = (np.cbrt(part) - 1 + 2 / (9 * degrees)) / np.sqrt(2 / (9 * degrees))
        return erfc(float(z) / sqrt(2.0)) / 2.0

    @cached_property
    def fitted(self) -> dict[str, Fitted]:
        """Every fault at its best size."""
        parts = np.clip(((self._target - self._begin) * self._way).sum(axis=1) / self._length, 0.0, 1.0)
        parts = self._reweighted(parts)
        misfits = self._misfits((self._begin + parts[:, None] * self._way)[:, None])
        found: dict[str, Fitted] = {}
        for row, (fault, misfit) in enumerate(zip(self.segments.faults, misfits.tolist(), strict=True)):
            if fault not in found or misfit < found[fault].misfit:
                found[fault] = Fitted(misfit, row, float(parts[row]))
        for fault, profile in self._with_consequence.items():
            best = int(profile.misfits.argmin())
            least = Fitted(float(profile.misfits[best]), int(profile.rows[best]), float(profile.parts[best]))
            found[fault] = min(found[fault], least)
        return found

    @cached_property
    def growing_or_not(self) -> dict[str, float]:
        """The misfit of every fault, of one size or one that has grown, which costs `GROWN`."""
        grown = {fault: misfit for fault, (misfit, _) in self._grown.items()}
        self.prices |= {(fault,): GROWN + self.prices.get((fault,), 0.0) for fault in grown}
        return self.faults | grown

    @cached_property
    def _grown(self) -> dict[str, tuple[float, int]]:
        """The misfit of the faults that fit better if they have grown, with its cost, and the chain that does."""
        found: dict[str, tuple[float, int]] = {}
        if self._history is None:
            return found
        of = dict(zip(self.segments.chain.tolist(), self.segments.faults, strict=True))
        # of a fault that fits by GROWN or less no course fits so much better
        chains = [number for number, fault in of.items() if self.faults[fault] > GROWN]
        if not chains:
            return found
        nearest = np.concatenate([self._nearest_courses(number) for number in chains])
        misfits = self._misfits(self._whitened(nearest)[:, None]).reshape(len(chains), -1).min(axis=1) + GROWN
        for number, misfit in zip(chains, misfits.tolist(), strict=True):
            if self.has_free_shifts:
                misfit += self._price(1, self.nothing - misfit)
            if misfit < found.get(of[number], (self.faults[of[number]], 0))[0]:
                found[of[number]] = misfit, number
        return found

    def _nearest_courses(self, number: int) -> FloatArray:
        """The mean shifts (NEAREST, D) of one chain that come nearest to what is seen, each mean by itself."""
        tried = self._courses(number)
        variance = self._S.diagonal() + (GAMMA * tried) ** 2
        near = ((tried - self._d) ** 2 / variance).sum(axis=1).argsort()[:NEAREST]
        return np.asarray(tried[near])

    @cached_property
    def _growth(self) -> Growth:
        assert self._history is not None
        return Growth(self._history, self._seen)

    def _courses(self, number: int) -> FloatArray:
        """The mean shifts (M, D) of one chain's fault by its present size and the course of its growth."""
        return self._growth.shifts(self._rows_of_chain(number))

    def _rows_of_chain(self, number: int) -> Indices:
        """The hypotheses of one chain, from the smallest size on."""
        return np.asarray(self.segments.end[self.segments.chain == number] - 1)  # row 0 is no fault

    def _whitened(self, mu: FloatArray) -> FloatArray:
        """Shifts (M, D) in the coordinates in which S is the unit matrix."""
        return np.asarray(mu @ self._whitener.T)

    def profile(self, fault: str) -> Profile:
        """The misfits of a fault's sizes, in the form that fits best, with its consequence where that fits best.

        A fault may have grown: the misfits of its present size, by the best course, are behind them and cost `COURSE`.
        """
        best, brought = self.fitted[fault], self._with_consequence.get(fault)
        number = self._grown[fault][1] if fault in self._grown else int(self.segments.chain[best.row])
        if brought is not None and brought.misfits.min() <= best.misfit and fault not in self._grown:
            return brought
        own = np.flatnonzero(self.segments.chain == number)
        rows, parts = np.repeat(own, SIZES), np.tile(np.linspace(0.0, 1.0, SIZES), len(own))
        mu = self._begin[rows] + parts[:, None] * self._way[rows]
        constant = Profile(rows, parts, self._misfits(mu[:, None]))
        if self._history is None:
            return constant
        misfits = self._misfits(self._whitened(self._courses(number))[:, None])
        at = present_sizes(len(own))
        step = np.minimum(at.astype(np.intp), len(own) - 1)
        grown = Profile(own[step], at - step, misfits.reshape(len(at), -1).min(axis=1) + COURSE)
        return Profile(*(np.concatenate(pair) for pair in zip(constant, grown, strict=True)))

    def lengths(self, rows: Indices, parts: FloatArray) -> FloatArray:
        """Return the lengths (M,) of the shifts of faults of some sizes, in standard deviations of what is seen."""
        return np.asarray(np.sqrt(((self._begin[rows] + parts[:, None] * self._way[rows]) ** 2).sum(axis=1)))

    @cached_property
    def _with_consequence(self) -> dict[str, Profile]:
        return {fault: self._with(brought) for fault, brought in self.brought.items()}

    def _with(self, brought: Consequences) -> Profile:
        """The fault's larger sizes, with the best size of its consequence in each mode in which that shows."""
        rows, shifts = brought.rows, self._shifts[brought.rows]  # (I, J, D)
        part = np.linspace(0.0, 1.0, BETWEEN + 1)[:, None, None]
        tried = (shifts[:-1, None] * (1.0 - part) + shifts[1:, None] * part).reshape(-1, *shifts.shape[1:])  # (M, J, D)
        mu = tried[:, 0].copy()
        weight = 1.0 / (self._S.diagonal() + (GAMMA * self._d) ** 2)
        modes = np.nonzero(self._seen)[0]  # (D,)
        for mode in np.flatnonzero(brought.shows):
            of = modes == mode
            mu[:, of] = _nearest(tried[:, :, of], self._d[of], weight[of])
        misfits = self._misfits(self._whitened(mu)[:, None])
        ends = list(zip(self.segments.begin.tolist(), self.segments.end.tolist(), strict=True))
        of = [ends.index(pair) for pair in zip(rows[:-1, 0].tolist(), rows[1:, 0].tolist(), strict=True)]
        return Profile(np.repeat(of, BETWEEN + 1), np.tile(part.ravel(), len(of)), misfits)

    @property
    def fitting(self) -> list[Fitted]:
        """The faults that fit best, at their best sizes: those that the data do not tell apart."""
        least = min(self.faults.values(), default=0.0)
        return [fitted for fitted in self.fitted.values() if fitted.misfit <= least + TIE]

    def misfit_at(self, size: Fitted) -> float:
        """The misfit of a fault of a size that was fitted to something else."""
        return float(self._misfits((self._begin[size.row] + size.part * self._way[size.row])[None, None])[0])

    @cached_property
    def pairs(self) -> dict[tuple[str, ...], float]:
        """The misfit of every two faults at once, at their best sizes."""
        sizes, far = self._sizes_of_two()
        at: dict[tuple[str, ...], tuple[int, int]] = {}
        faults = self.segments.faults
        for i, j in combinations(range(len(faults)), 2):
            pair = tuple(sorted((faults[i], faults[j])))
            if faults[i] == faults[j] or not self.segments.alone.isdisjoint(pair):
                continue
            if pair not in at or far[i, j] < far[at[pair]]:
                at[pair] = i, j
        if not at:
            return self._free_pairs
        chosen = np.array(list(at.values()))  # (P, 2) segments
        parts = np.stack([sizes[i, j] for i, j in at.values()])  # (P, 2)
        misfits = self._misfits(self._begin[chosen] + parts[..., None] * self._way[chosen])
        return self._free_pairs | dict(zip(at, misfits.tolist(), strict=True))

    @property
    def _free_pairs(self) -> dict[tuple[str, ...], float]:
        """The misfit of every two faults at once that may shift anything."""
        pairs = combinations(sorted(self._signatures.keys() - self.segments.alone), 2)
        either = {pair: np.maximum(self._signatures[pair[0]], self._signatures[pair[1]]) for pair in pairs}
        return {pair: self._of_free_shift(pair, rows) for pair, rows in either.items()}

    @property
    def gain(self) -> float:
        """By how much the best fault fits better than none."""
        return self.nothing - min(self.faults.values(), default=self.nothing)

    @property
    def limit(self) -> float:
        """The misfit beyond which a hypothesis does not fit: of chi-square (Wilson, Hilferty 1931)."""
        degrees = len(self._d)
        return float(degrees * (1 - 2 / (9 * degrees) + UNLIKELY * np.sqrt(2 / (9 * degrees))) ** 3)

    def _reweighted(self, parts: FloatArray) -> FloatArray:
        """The parts (segments,) that fit best by the covariance that the predictions at `parts` have."""
        begin, way = self._begin @ self._white.T, self._way @ self._white.T
        weighed = self._weighed((begin + parts[:, None] * way)[:, None], way)
        length = np.maximum((way * weighed).sum(axis=1), 1e-300)
        return np.asarray(np.clip(((self._d - begin) * weighed).sum(axis=1) / length, 0.0, 1.0))

    def _weighed(self, mu: FloatArray, rows: FloatArray) -> FloatArray:
        """Each row (M, D) by the inverse of S with the error of the predictions mu (M, shifts, D)."""
        S = np.broadcast_to(self._S, (len(mu), *self._S.shape)).copy()
        diagonal = np.arange(len(self._d))
        S[:, diagonal, diagonal] += ((GAMMA * mu) ** 2).sum(axis=1)
        return np.asarray(np.linalg.solve(S, rows[..., None])[..., 0])

    def _misfits(self, mu: FloatArray) -> FloatArray:
        """The misfits (M,) of sums of shifts, whitened: mu (M, shifts, D)."""
        mu = mu @ self._white.T
        left = self._d - mu.sum(axis=1)
        return np.asarray((left * self._weighed(mu, left)).sum(axis=1))

    def _sizes_of_two(self) -> tuple[FloatArray, FloatArray]:
        """Parts (segments, segments, 2) of two segments whose sum comes nearest, and how far that is, squared.

        The distance is a quadratic form of both parts: its least value lies inside the unit square or on its border.
        """
        across, cross = self._way @ self._way.T, self._begin @ self._way.T
        along = (self._way @ self._target)[:, None] - cross.diagonal()[:, None] - cross.T  # to the first one's way
        start = self._target - self._begin[:, None] - self._begin  # (segments, segments, D)
        first, second = self._length[:, None], self._length
        det = first * second - across**2
        parallel = det <= 1e-9 * first * second  # or one of them shifts nothing
        det = np.where(parallel, 1.0, det)
        a, b = (second * along - across * along.T) / det, (first * along.T - across * along) / det
        outside = parallel | (a < 0.0) | (a > 1.0) | (b < 0.0) | (b > 1.0)
        none, whole = np.zeros_like(a), np.ones_like(a)
        tried = [(np.where(outside, 0.0, a), np.where(outside, 0.0, b))]
        tried += [(end, np.clip((along.T - end * across) / second, 0.0, 1.0)) for end in (none, whole)]
        tried += [(np.clip((along - end * across) / first, 0.0, 1.0), end) for end in (none, whole)]
        parts: FloatArray = np.array(tried)  # (5, 2, segments, segments)
        a, b = parts[:, 0], parts[:, 1]
        far = (start**2).sum(axis=2) - 2 * (a * along + b * along.T)
        far = far + a**2 * first + b**2 * second + 2 * a * b * across
        best = far.argmin(axis=0)[None]
        return np.moveaxis(np.take_along_axis(parts, best[:, None], 0)[0], 0, 2), np.take_along_axis(far, best, 0)[0]


def _some_of(signals: list[int]) -> list[tuple[int, ...]]:
    """Return the choices of signals that a fault may move: any, or of many each one and all of them."""
    sizes = range(1, len(signals) + 1) if len(signals) <= MOST_CHOSEN else (1, len(signals))
    return [chosen for size in sizes for chosen in combinations(signals, size)]


def _nearest(polygons: FloatArray, d: FloatArray, weight: FloatArray) -> FloatArray:
    """The point (M, D) of each polygon (M, J, D) that is nearest to `d` (D,), by weighted squares."""
    begin, way = polygons[:, :-1], np.diff(polygons, axis=1)
    length = np.maximum((weight * way**2).sum(axis=-1), 1e-300)
    part = np.clip((weight * (d - begin) * way).sum(axis=-1) / length, 0.0, 1.0)
    points = begin + part[..., None] * way  # (M, J - 1, D)
    best = (weight * (d - points) ** 2).sum(axis=-1).argmin(axis=1)
    return np.asarray(points[np.arange(len(points)), best])
