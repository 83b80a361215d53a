"""The gate, the operating modes and the residual generators over many ticks, for Numba.

Each function is what a class of the core does tick by tick, in the same order of the same operations, with its state in
arrays: `gate` is `core.signals.gate`, `modes` `core.signals.modes`, `advance` `core.residuals.generators`. What they
mean is said there. The functions of a bundle's graphs are arguments (`analysis.compiled.source`).
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from faultline.service.core.residuals.generators import HELD_TICKS, MOST_DOUBTFUL, OUTSIDE
from faultline.service.core.signals.gate import BACK, FAR, SAMPLES
from faultline.service.core.signals.values import FloatArray

Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


class GateState(NamedTuple):
    """Columns (G,) that are gated, their least distance; last samples (SAMPLES, G), passed, refused and seen (G,)."""

    columns: Ints
    least: FloatArray
    last: FloatArray
    passed: FloatArray
    refused: FloatArray
    seen: Ints
    held: Flags


class Gated(NamedTuple):
    """Samples that passed (n, nz), and which are held back, have stepped or jumped (n, nz)."""

    passed: FloatArray
    held: Flags
    stepped: Flags
    jumped: Flags


class ModesState(NamedTuple):
    """Limits (nz,) of a step, regions (M, nz), their order (M,), signals that are needed (nz,); the last values.

    `counts` (2,) are the place of the last values and the ticks since an edge.
    """

    limit: FloatArray
    above: FloatArray
    below: FloatArray
    needed: Flags
    order: Ints
    last: FloatArray
    counts: Ints
    settle: int


class Generators(NamedTuple):
    """What a bundle says of its T generators, of the consequences (C) and of the K that have hypotheses.

    `of_tests`, `of_hypotheses` and `table` are the constants of the graphs' functions.
    """

    lower: FloatArray
    upper: FloatArray
    needs: Flags
    owner: Ints
    offset: FloatArray
    gain: FloatArray
    warm_up: Ints
    stale: FloatArray
    above: FloatArray
    below: FloatArray
    weighed: Ints
    own: Ints
    own_owner: Ints
    of_tests: FloatArray
    of_hypotheses: FloatArray
    table: FloatArray


class GeneratorState(NamedTuple):
    """States x (nx,), last good samples z (nz,), ticks that were missed and since the start (T,), since shown (C,).

    `assumed` (own nx, H) are the states of the hypotheses.
    """

    x: FloatArray
    z: FloatArray
    missed: Ints
    ticks: Ints
    since_shown: Ints
    assumed: FloatArray


class Doubtful(NamedTuple):
    """Ticks with samples that are held back (MOST_DOUBTFUL, nz), as received and as taken; their `number` (1,)."""

    raw: FloatArray
    taken: FloatArray
    usable: Flags
    number: Ints


class Row(NamedTuple):
    """The outputs of a tick: of the generators (T,) and (nx,), and of their hypotheses (K, H) and (own nx, H)."""

    r: FloatArray
    y_hat: FloatArray
    sigma: FloatArray
    x_next: FloatArray
    assumed: FloatArray
    assumed_next: FloatArray


class Outputs(NamedTuple):
    """The outputs of n ticks: (n, T), shifts (n, K, H) and consequences that were brought (n, C)."""

    r: FloatArray
    y_hat: FloatArray
    sigma: FloatArray
    usable: Flags
    held: Flags
    shift: FloatArray
    brought: Flags


def gate(state: GateState, z: FloatArray, usable: Flags, out: Gated) -> None:
    """Let samples (n, nz) pass or hold them back."""
    for k in range(len(z)):
        out.passed[k] = z[k]
        for g in range(len(state.columns)):
            column = state.columns[g]
            now, good = z[k, column], usable[k, column]
            if good:
                state.last[state.seen[g] % SAMPLES, g] = now
                state.seen[g] += 1
            outlier = False
            if good and state.seen[g] > SAMPLES:
                middle = _middle(state.last[:, g])
                spread = _middle(np.abs(state.last[:, g] - middle))
                outlier = abs(now - middle) > max(FAR * spread, state.least[g])
            before, passes = state.held[column], good and not outlier
            by = abs(now - state.passed[g])
            stepped = before and passes and abs(now - state.refused[g]) < BACK * by
            out.stepped[k, column] = stepped
            out.jumped[k, column] = stepped and by > state.least[g]
            out.held[k, column] = state.held[column] = outlier
            if passes:
                state.passed[g] = now
            if outlier:
                state.refused[g] = now
                out.passed[k, column] = state.passed[g]


@njit(cache=True)
def _middle(values: FloatArray) -> float:
    """The median of an odd number of values."""
    ordered = values.copy()
    for i in range(1, len(ordered)):
        value, j = ordered[i], i
        while j > 0 and ordered[j - 1] > value:
            ordered[j] = ordered[j - 1]
            j -= 1
        ordered[j] = value
    return float(ordered[len(ordered) // 2])


@njit(cache=True)
def _holds(z: FloatArray, above: FloatArray, below: FloatArray) -> bool:
    """Return True if samples (nz,) are in a region."""
    holds = True
    for i in range(len(z)):
        holds = holds and not (z[i] <= above[i] or z[i] >= below[i])
    return holds


def modes(state: ModesState, usable: Flags, gated: Gated, found: Ints) -> None:
    """The operating mode of each of n ticks; 0 is the edge."""
    nz = usable.shape[1]
    for k in range(len(usable)):
        z = gated.passed[k]
        known, is_edge = _known_and_edge(state, z, usable[k], gated.jumped[k])
        state.counts[1] = 0 if is_edge or not known else state.counts[1] + 1
        before = state.counts[0]
        state.counts[0] = now = (before + 1) % len(state.last)
        for i in range(nz):
            value = z[i] if usable[k, i] else state.last[before, i]
            if is_edge:
                state.last[:, i] = value
            else:
                state.last[now, i] = value
        found[k] = 0
        if state.counts[1] >= state.settle and known:
            for row in state.order:
                if _holds(z, state.above[row], state.below[row]):
                    found[k] = 1 + row
                    break


@njit(cache=True)
def _known_and_edge(state: ModesState, z: FloatArray, usable: Flags, jumped: Flags) -> tuple[bool, bool]:
    """Return whether all signals of the modes' bounds are usable, and whether some signal steps."""
    known, is_edge = True, False
    for i in range(len(z)):
        known = known and (usable[i] or not state.needed[i])
        is_edge = is_edge or (jumped[i] and state.limit[i] < np.inf)
        for j in range(len(state.last)):
            is_edge = is_edge or (usable[i] and abs(z[i] - state.last[j, i]) > state.limit[i])
    return known, is_edge


def advance(
    tests: Any,
    hypotheses: Any,
    g: Generators,
    state: GeneratorState,
    before: GeneratorState,
    doubtful: Doubtful,
    row: Row,
    z: FloatArray,
    usable: Flags,
    ages: FloatArray,
    gated: Gated,
    out: Outputs,
) -> None:
    """Advance by n ticks with samples (n, nz)."""
    T, nz = g.needs.shape
    for k in range(len(z)):
        _reconsider(tests, hypotheses, g, state, before, doubtful, row, z[k], usable[k], gated, k)
        advanced = _advance(tests, hypotheses, g, state, row, gated.passed[k], usable[k])
        out.r[k], out.y_hat[k], out.sigma[k] = row.r, row.y_hat, row.sigma
        for t in range(T):
            out.usable[k, t] = advanced[t] and state.ticks[t] > g.warm_up[t]
            held = False
            for i in range(nz):
                held = held or (g.needs[t, i] and (gated.held[k, i] or ages[k, i] > g.stale[i]))
            out.held[k, t] = held
        for c in range(len(state.since_shown)):
            out.brought[k, c] = state.since_shown[c] <= g.warm_up.max()
        _shift(row, g.weighed, out.shift[k])


@njit(cache=True)
def _shift(row: Row, weighed: Ints, shift: FloatArray) -> None:
    """Fill in what each hypothesis does to the residuals (K, H): nothing where it could not be computed."""
    good = _good(row)
    for k in range(shift.shape[0]):
        r = row.r[weighed[k]]
        for h in range(shift.shape[1]):
            shift[k, h] = r - row.assumed[k, h] if good[h] else 0.0


@njit(cache=True)
def _good(row: Row) -> Flags:
    """Return which hypotheses could be computed (H,)."""
    nothing = np.zeros(row.assumed.shape[1])  # a finite number less itself
    for k in range(len(row.assumed)):
        for h in range(len(nothing)):
            nothing[h] += row.assumed[k, h] - row.assumed[k, h]
    for c in range(len(row.assumed_next)):
        for h in range(len(nothing)):
            nothing[h] += row.assumed_next[c, h] - row.assumed_next[c, h]
    return np.asarray(nothing == 0.0)


@njit(cache=True)
def _copy(source: GeneratorState, to: GeneratorState) -> None:
    to.x[:], to.z[:], to.assumed[:] = source.x, source.z, source.assumed
    to.missed[:], to.ticks[:], to.since_shown[:] = source.missed, source.ticks, source.since_shown


@njit
def _reconsider(
    tests: Any,
    hypotheses: Any,
    g: Generators,
    state: GeneratorState,
    before: GeneratorState,
    doubtful: Doubtful,
    row: Row,
    z: FloatArray,
    usable: Flags,
    gated: Gated,
    k: int,
) -> None:
    """Compute the ticks again whose samples were held back and were a step; remember the tick if one is held."""
    stepped, held, count = gated.stepped[k], gated.held[k].any(), doubtful.number[0]
    if stepped.any() and count:
        _copy(before, state)
        for d in range(count):
            for i in range(len(z)):
                if stepped[i]:
                    doubtful.taken[d, i] = doubtful.raw[d, i]
            _advance(tests, hypotheses, g, state, row, doubtful.taken[d], doubtful.usable[d])
    if not held or count == MOST_DOUBTFUL:
        count = 0
    if held:
        if count == 0:
            _copy(state, before)
        doubtful.raw[count], doubtful.taken[count], doubtful.usable[count] = z, gated.passed[k], usable
        count += 1
    doubtful.number[0] = count


@njit
def _advance(
    tests: Any, hypotheses: Any, g: Generators, state: GeneratorState, row: Row, z: FloatArray, usable: Flags
) -> Flags:
    """Advance by one tick with these samples (nz,); return which generators did (T,)."""
    for i in range(len(z)):
        if usable[i]:
            state.z[i] = z[i]
    fresh, fed, inside = _fed(g, state, usable)
    _restart(g, state, fed & (state.missed > HELD_TICKS), fresh)
    tests(state.z, state.x, g.of_tests, row.r, row.y_hat, row.sigma, row.x_next)
    advanced = _keep_tests(g, state, row, fed, inside)
    if len(row.assumed):
        hypotheses(state.z, state.assumed, g.of_hypotheses, g.table, row.assumed, row.assumed_next)
        _keep_hypotheses(g, state, row, advanced, fresh)
    for c in range(len(state.since_shown)):
        shows = _holds(state.z, g.above[c], g.below[c])
        state.since_shown[c] = 0 if shows else state.since_shown[c] + 1
    return advanced


@njit(cache=True)
def _fed(g: Generators, state: GeneratorState, usable: Flags) -> tuple[FloatArray, Flags, Flags]:
    """States as the sensors have them (nx,), generators that have all their inputs (T,), those inside their region."""
    T, nz = g.needs.shape
    fresh = g.offset.copy()
    for c in range(len(fresh)):
        for i in range(nz):
            fresh[c] += g.gain[c, i] * state.z[i]
    fed, beyond = np.ones(T, np.bool_), np.zeros(T)
    for t in range(T):
        for i in range(nz):
            if g.needs[t, i]:
                fed[t] = fed[t] and usable[i]
                outside = max(g.lower[i] - state.z[i], state.z[i] - g.upper[i]) / (g.upper[i] - g.lower[i])
                beyond[t] += max(outside, 0.0)
    return fresh, fed, beyond <= OUTSIDE


@njit(cache=True)
def _keep_tests(g: Generators, state: GeneratorState, row: Row, fed: Flags, inside: Flags) -> Flags:
    """Keep the states of the generators that advance; return which do (T,)."""
    finite = np.isfinite(row.r) & np.isfinite(row.sigma)
    for c in range(len(g.owner)):
        if not np.isfinite(row.x_next[c]):
            finite[g.owner[c]] = False
    advanced = fed & finite & inside
    for c in range(len(g.owner)):
        if advanced[g.owner[c]]:
            state.x[c] = row.x_next[c]
    for t in range(len(fed)):
        state.missed[t] = 0 if advanced[t] else state.missed[t] + 1
        if fed[t] and not finite[t]:
            state.missed[t] = HELD_TICKS + 1
        state.ticks[t] += advanced[t]
    return advanced


@njit(cache=True)
def _keep_hypotheses(g: Generators, state: GeneratorState, row: Row, advanced: Flags, fresh: FloatArray) -> None:
    """Keep the states of the hypotheses of generators that advance; those that could not be computed start anew."""
    good = _good(row)
    for c in range(len(g.own)):
        if advanced[g.weighed[g.own_owner[c]]]:
            for h in range(len(good)):
                state.assumed[c, h] = row.assumed_next[c, h] if good[h] else fresh[g.own[c]]


@njit(cache=True)
def _restart(g: Generators, state: GeneratorState, restarted: Flags, fresh: FloatArray) -> None:
    """Take the states of these generators (T,) from the sensors and start their warm-up anew."""
    for t in range(len(restarted)):
        if restarted[t]:
            state.ticks[t] = 0
    for c in range(len(g.owner)):
        if restarted[g.owner[c]]:
            state.x[c] = fresh[c]
    for c in range(len(g.own)):
        if restarted[g.weighed[g.own_owner[c]]]:
            state.assumed[c, :] = fresh[g.own[c]]
