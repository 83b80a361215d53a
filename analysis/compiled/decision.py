"""Parts of the decision as native code: the same operations on the same arrays, without a temporary array for each."""

from functools import cached_property

import numpy as np
from numba import njit

from faultline.service.core.decision.baseline import BaselineFilter, GaussianState, Innovation
from faultline.service.core.decision.blocks import Block
from faultline.service.core.decision.change_detector import ChangeDetector
from faultline.service.core.decision.growth import BETWEEN
from faultline.service.core.decision.look import GAMMA, NEAREST, Look
from faultline.service.core.decision.parts import Parts
from faultline.service.core.detectors.cusum import Cusums
from faultline.service.core.signals.values import FloatArray, Indices, Mask


class NativeCusums(Cusums):
    """The same numbers, bit for bit."""

    def _sums_ahead(self, s: FloatArray, counted: Mask) -> FloatArray:
        sums = np.empty((len(s), *self._sums.shape))
        _cusums(self._sums, s, counted, self._tested, self._nu, self._ceiling, sums)
        return sums


class NativeFilter(BaselineFilter):
    """The same to within rounding, of one log."""

    def step(self, block: Block) -> Innovation:
        """Advance to the end of a block and take it in."""
        model, mode = self.model, int(block.mode[0])
        decay = np.exp((self.end_s[0] - block.end_s[0]) / model.tau)
        self.end_s = block.end_s
        if block.begins[0]:
            decay[model.visit] = 0.0
        seen = block.ticks[0] > 0
        H = model.observed(block)[0] * seen[:, None]
        noise = model.noise[mode] * block.part[0] + np.diag(block.excess[0])
        R = np.where(seen[:, None] & seen, noise, np.eye(len(H)))
        innovation = np.where(seen, block.mean[0] - model.offset[mode], 0.0)
        mean, P = self.state.mean[0] * decay, self.state.covariance[0].copy()
        white, gain, whiten = _kalman(mean, P, decay, model.stationary[mode], H, R, innovation)
        self.state = GaussianState(mean[None], P[None])
        return Innovation(*(each[None] for each in (white, decay, H, gain, whiten)))


class NativeChangeDetector(ChangeDetector):
    """The same to within rounding, of one log."""

    of_filter = NativeFilter

    def _add(self, block: Block, innovation: Innovation) -> None:
        shift = np.concatenate([np.zeros((1, len(self._unit))), block.shift[0], self._unit]) * (block.ticks[0] > 0)
        white, decay, observe, gain, whiten = (each[0] for each in innovation)
        effect, A, c, along, free = (each[0] for each in self._sums)
        begin, end = self._segments.begin, self._segments.end
        _signatures(shift, decay, observe, gain, whiten, white, begin, end, effect, A, c, along, free)

    def _of_faults(self) -> FloatArray:
        begin, end, faults = self._segments.begin, self._segments.end, len(self.faults)
        _, A, c, along, free = (each[0] for each in self._sums)
        return np.asarray(_ratios(A, c, along, free, begin, end, self._fault, faults)[None])

    @cached_property
    def _fault(self) -> Indices:
        """Return the number of each segment's fault."""
        return np.array([self.faults.index(name) for name in self._segments.faults], dtype=np.intp)


class NativeLook(Look):
    """The same to within rounding."""

    def _weighed(self, mu: FloatArray, rows: FloatArray) -> FloatArray:
        return np.asarray(_weighed(self._S, mu, rows))

    def _nearest_courses(self, number: int) -> FloatArray:
        tried = self._courses(number)
        far: FloatArray = _distances(tried, self._d, self._S.diagonal().copy())
        near = far.argpartition(NEAREST)[:NEAREST]
        return np.asarray(tried[near])

    def _courses(self, number: int) -> FloatArray:
        growth = self._growth
        return np.asarray(_courses(growth.shift, self._rows_of_chain(number), growth.course, growth.ticks))


@njit(cache=True, error_model="numpy")
def _cusums(
    before: FloatArray,
    s: FloatArray,
    counted: Mask,
    tested: Mask,
    nu: FloatArray,
    ceiling: FloatArray,
    sums: FloatArray,
) -> None:
    for k in range(len(s)):
        for d in range(s.shape[1]):
            for side in range(2):
                was = before[side, d] if k == 0 else sums[k - 1, side, d]
                if counted[k, d] and tested[side, d]:
                    was = was + (s[k, d] if side == 0 else -s[k, d]) - nu[d]
                    was = max(min(was, ceiling[d]), 0.0)
                sums[k, side, d] = was


@njit(cache=True, error_model="numpy")
def _kalman(
    mean: FloatArray,
    P: FloatArray,
    decay: FloatArray,
    stationary: FloatArray,
    H: FloatArray,
    R: FloatArray,
    innovation: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Advance `mean` (S,), which has decayed, and `P` (S, S); return the whitened innovation, gain and whitener."""
    S = len(mean)
    for i in range(S):
        for j in range(S):
            both = decay[i] * decay[j]
            P[i, j] = both * P[i, j] + (1.0 - both) * stationary[i, j]
    PH = P @ H.T
    whiten = _inverse(_cholesky(H @ PH + R))
    innovation -= H @ mean
    white = whiten @ innovation
    gain = PH @ whiten.T @ whiten
    mean += gain @ innovation
    P -= gain @ PH.T
    for i in range(S):
        for j in range(i):
            P[i, j] = P[j, i] = (P[i, j] + P[j, i]) / 2.0
    return white, gain, whiten


@njit(cache=True, error_model="numpy")
def _cholesky(S: FloatArray) -> FloatArray:
    """Replace a matrix by its lower Cholesky factor."""
    for i in range(len(S)):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= S[i, k] * S[j, k]
            S[i, j] = np.sqrt(total) if i == j else total / S[j, j]
    return S


@njit(cache=True, error_model="numpy")
def _inverse(factor: FloatArray) -> FloatArray:
    """Return the inverse of a lower triangle."""
    found = np.zeros(factor.shape)
    for j in range(len(factor)):
        found[j, j] = 1.0 / factor[j, j]
        for i in range(j + 1, len(factor)):
            total = 0.0
            for k in range(j, i):
                total -= factor[i, k] * found[k, j]
            found[i, j] = total / factor[i, i]
    return found


@njit(cache=True, error_model="numpy")
def _ratios(
    A: FloatArray,
    c: FloatArray,
    along: FloatArray,
    free: FloatArray,
    begin: Indices,
    end: Indices,
    fault: Indices,
    faults: int,
) -> FloatArray:
    """Return the largest ratio of each fault's segments for each onset, and that of the undeclared one (T, F + 1)."""
    K = free.shape[1]
    table = np.full((len(A), faults + 1), -np.inf)
    for t in range(len(A)):
        Q = max(_quadratic(free[t], c[t, -K:]), float(K))
        table[t, faults] = (Q - K * (1.0 + np.log(Q / K))) / 2.0
        for n in range(len(begin)):
            A0, A1, c0, c1, X = A[t, begin[n]], A[t, end[n]], c[t, begin[n]], c[t, end[n]], along[t, n]
            part = (c1 - c0 - X + A0) / max(A0 - 2.0 * X + A1, 1e-300)
            part = min(max(part, 0.0), 1.0)
            square = (1.0 - part) ** 2 * A0 + 2.0 * part * (1.0 - part) * X + part**2 * A1
            table[t, fault[n]] = max(table[t, fault[n]], c0 + part * (c1 - c0) - square / 2.0)
    return table


@njit(cache=True, error_model="numpy")
def _quadratic(A: FloatArray, c: FloatArray) -> float:
    """Return c' A^-1 c, without what A has nothing of."""
    K, total = len(c), 0.0
    factor, row, least = np.zeros((K, K)), np.zeros(K), 1e-15 * np.diag(A).max()
    for j in range(K):
        pivot = A[j, j]
        for k in range(j):
            pivot -= factor[j, k] ** 2
        if pivot <= least:
            continue
        pivot, row[j] = np.sqrt(pivot), c[j]
        for k in range(j):
            row[j] -= factor[j, k] * row[k]
        row[j] /= pivot
        total += row[j] ** 2
        for i in range(j, K):
            factor[i, j] = A[i, j] / pivot
            for k in range(j):
                factor[i, j] -= factor[i, k] * factor[j, k] / pivot
    return total


@njit(cache=True, error_model="numpy")
def _signatures(
    shift: FloatArray,
    decay: FloatArray,
    observe: FloatArray,
    gain: FloatArray,
    whiten: FloatArray,
    white: FloatArray,
    begin: Indices,
    end: Indices,
    effect: FloatArray,
    A: FloatArray,
    c: FloatArray,
    along: FloatArray,
    free: FloatArray,
) -> None:
    """Add a block, whose means each row shifts (R, K), to the tables (T, R, ...) of all onsets."""
    T, R, S = effect.shape
    K = len(white)
    rows = effect.reshape(-1, S)
    rows *= decay
    moved = -(rows @ observe.T)
    for t in range(T):
        moved[t * R : (t + 1) * R] += shift
    rows += moved @ gain.T
    each = (moved @ whiten.T).reshape(T, R, K)
    for t in range(T):
        g = each[t]
        c[t] += g @ white
        for k in range(K):
            for r in range(R):
                A[t, r] += g[r, k] * g[r, k]
            for n in range(len(begin)):
                along[t, n] += g[begin[n], k] * g[end[n], k]
        free[t] += g[-K:] @ g[-K:].T


@njit(cache=True, error_model="numpy")
def _weighed(S: FloatArray, mu: FloatArray, rows: FloatArray) -> FloatArray:
    """Each row (M, D) by the inverse of S with the error of the predictions mu (M, n, D)."""
    M, n, D = mu.shape
    found = rows.copy()
    for m in range(M):
        weighed = S.copy()
        for i in range(n):
            for k in range(D):
                weighed[k, k] += (GAMMA * mu[m, i, k]) ** 2
        _solve(_cholesky(weighed), found[m])
    return found


@njit(cache=True, error_model="numpy")
def _solve(factor: FloatArray, row: FloatArray) -> None:
    """Replace a vector by that times the inverse of the matrix that has this Cholesky factor."""
    D = len(row)
    for k in range(D):
        for j in range(k):
            row[k] -= factor[k, j] * row[j]
        row[k] /= factor[k, k]
    for k in range(D - 1, -1, -1):
        for j in range(k + 1, D):
            row[k] -= factor[j, k] * row[j]
        row[k] /= factor[k, k]


@njit(cache=True, error_model="numpy")
def _courses(shift: FloatArray, rows: Indices, course: FloatArray, ticks: FloatArray) -> FloatArray:
    """The mean shifts (M, D) of a chain's `rows` (J,) by its present size and the course of its growth."""
    N, _, D = shift.shape
    J = len(rows)
    sizes = np.zeros((N, J + 2, D))  # none before the smallest, and the largest again
    for n in range(N):
        for j in range(J + 1):
            sizes[n, j + 1] = shift[n, rows[min(j, J - 1)]]
    found = np.zeros((BETWEEN * J, len(course), D))
    for size in range(len(found)):
        for w in range(len(course)):
            mean = found[size, w]
            for n in range(N):
                at = (size + 1) / BETWEEN * course[w, n]
                row = int(at)
                part, low, high = at - row, sizes[n, row], sizes[n, row + 1]
                for k in range(D):
                    mean[k] += low[k] + part * (high[k] - low[k])
    return found.reshape(-1, D) / ticks


@njit(cache=True, error_model="numpy")
def _distances(tried: FloatArray, d: FloatArray, variance: FloatArray) -> FloatArray:
    """Return how far the shifts (M, D) are from what is seen, each mean by itself: in variances, squared."""
    found = np.zeros(len(tried))
    for m in range(len(tried)):
        for k in range(len(d)):
            found[m] += (tried[m, k] - d[k]) ** 2 / (variance[k] + (GAMMA * tried[m, k]) ** 2)
    return found


NATIVE = Parts(NativeCusums, NativeChangeDetector, NativeLook)
"""For what runs many logs one after the other."""
