"""Intervals of a fault's size (95 %): the sizes that fit what is seen nearly as well as the best one.

A misfit is -2 log of a likelihood whose other parameters (the baseline, the visits) are integrated out; by the profile
likelihood the interval holds all sizes whose misfit is within 3.84 of the least (Wilks 1938).

Between two assumed sizes the shift is taken for the straight line between theirs, but a fault's shift is a power of its
size rather: of a sensor's error the first, of a clogged filter a higher one. So a point of the line has the size that
the length of its shift says, interpolated between logarithms.
"""

import numpy as np

from faultline.service.core.decision.look import Look
from faultline.service.core.manifest import Evidence
from faultline.service.core.records.event import Size
from faultline.service.core.signals.values import FloatArray, Mask

WITHIN = 3.84
"""The quantile of chi-square with one degree of freedom that 95 % are below."""


class SizeIntervals:
    """The sizes of a bundle's hypotheses, and the units in which people read them."""

    def __init__(self, evidence: Evidence) -> None:
        self._sizes = np.array([0.0, *(h.size for h in evidence.hypotheses)])
        self._units = {(each.fault, each.share_of): each for each in evidence.sizes}

    def of(self, fault: str, look: Look) -> list[Size]:
        """Return the interval of a single fault; none where its bundle says no unit."""
        if fault not in look.fitted:
            return []
        profile, segments = look.profile(fault), look.segments
        unit = self._units.get((fault, segments.shares[profile.rows[0]]))
        if unit is None:
            return []
        chain = np.flatnonzero(segments.chain == segments.chain[profile.rows[0]])
        of_chain = self._sizes[segments.end[chain]]
        ends = look.lengths(chain, np.ones(len(chain)))
        along = size_at(look.lengths(profile.rows, profile.parts), ends, np.abs(of_chain))
        low, high = interval(np.sign(of_chain[0]) * along, profile.misfits)
        digits = 3 if unit.display.digits is None else unit.display.digits
        scaled = (round(float(unit.display.scaled(size)), digits) for size in (low, high))
        return [Size(low=next(scaled), high=next(scaled), unit=unit.display.unit, of=unit.of)]


def size_at(length: FloatArray, lengths: FloatArray, sizes: FloatArray) -> FloatArray:
    """Return the sizes (M,) of shifts of some `length` (M,), where `sizes` (K,) have shifts of `lengths` (K,).

    Monotone piecewise cubic in the logarithms of both (Fritsch and Butland 1984). Below the first size it is the
    hyperbola that goes on from there and begins in proportion.

    >>> size_at(np.array([0.0, 2.0, 20.0]), np.array([1.0, 10.0, 40.0]), np.array([3.0, 30.0, 120.0]))
    array([ 0.,  6., 60.])
    >>> filters = np.array([0.15, 0.3, 0.6, 0.8, 0.92])
    >>> size_at((1 - np.array([0.1, 0.65])) ** -2 - 1, (1 - filters) ** -2 - 1, filters).round(3)
    array([0.099, 0.648])
    """
    with np.errstate(divide="ignore"):
        x, y = np.log(lengths), np.log(sizes)
    kept = np.flatnonzero(_rises(x) & _rises(y))
    if not len(kept):
        return np.zeros(len(length))  # it shifts nothing here
    x, y = x[kept], y[kept]
    slope = _slopes(x, y)
    with np.errstate(divide="ignore"):
        at = np.minimum(np.log(length), x[-1])
    k = np.clip(np.searchsorted(x, at, side="right") - 1, 0, max(len(x) - 2, 0))
    below = at < x[0]
    part = length / np.exp(x[0])
    first = np.exp(y[0]) * part / (slope[0] + (1.0 - slope[0]) * part)
    if len(x) == 1:
        return np.asarray(np.minimum(first, sizes[kept[0]]))
    h = x[k + 1] - x[k]
    t = np.where(below, 0.0, (at - x[k]) / h)
    rise = y[k + 1] - y[k]
    cubic = y[k] + rise * t**2 * (3 - 2 * t) + h * (slope[k] * t * (1 - t) ** 2 - slope[k + 1] * t**2 * (1 - t))
    return np.asarray(np.where(below, first, np.exp(cubic)))


def _rises(values: FloatArray) -> Mask:
    """Return True where a value (K,) is above all before it."""
    return np.asarray(values > np.concatenate([[-np.inf], np.maximum.accumulate(values)[:-1]]))


def _slopes(x: FloatArray, y: FloatArray) -> FloatArray:
    """The derivatives (K,) at the nodes: weighted harmonic means of the secants, at the ends from the last two."""
    if len(x) == 1:
        return np.ones(1)
    h, secant = np.diff(x), np.diff(y) / np.diff(x)
    if len(x) == 2:
        return np.repeat(secant, 2)
    left, right = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    inner = (left + right) / (left / secant[:-1] + right / secant[1:])
    first, last = (
        ((2 * near + far) * own - near * other) / (near + far)
        for near, far, own, other in ((*h[:2], *secant[:2]), (*h[:-3:-1], *secant[:-3:-1]))
    )
    ends = np.clip([first, last], 0.0, 3.0 * secant[[0, -1]])
    return np.concatenate([ends[:1], inner, ends[1:]])


def interval(size: FloatArray, misfit: FloatArray) -> tuple[float, float]:
    """Return the least and the largest size (M,) whose misfit (M,) is near the least; between sizes it is linear.

    >>> interval(np.array([0.0, 1.0, 2.0, 3.0]), np.array([7.68, 0.0, 3.84, 11.52]))
    (0.5, 2.0)
    """
    order = np.argsort(size, kind="stable")
    size, above = size[order], misfit[order] - misfit.min() - WITHIN
    inside = np.flatnonzero(above <= 0.0)
    return _crossing(size, above, int(inside[0]), -1), _crossing(size, above, int(inside[-1]), 1)


def _crossing(size: FloatArray, above: FloatArray, last: int, to: int) -> float:
    """The size at which `above` becomes positive beyond the last one where it is not, on the way to the next."""
    beyond = last + to
    if not 0 <= beyond < len(size):
        return float(size[last])
    part = -above[last] / (above[beyond] - above[last])
    return float(size[last] + part * (size[beyond] - size[last]))
