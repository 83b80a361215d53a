"""Trained networks as one ONNX graph: all functions of all tests and members side by side.

A cell advances its states by functions f of [states; signals] and predicts by functions h, each a linear part plus a
small network (thesis 3.3, 5.10):

    x+ = x + s (f(x, z) - x)   or   x + Ts f(x, z);        y = h(x+, z)   or, with the old input (thesis 3.6), h(x, z)

of M members, x+ kept within bounds; z are the signals now and, where a test holds them as further states, those a tick
before. What leaves the graph is the mean prediction of the members, and sigma from a variance network and from the
members' spread. Scaling is done in float64 at the edge, all else in float32.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.writer import Writer

WIDE = 32
"""Inputs of a product of several functions at most: with more, its zeros cost more than the product spares."""

LARGEST_LOG_V = 20.0
"""A sigma of some 20,000 spreads of the signal: where a network that runs away would say more, float32 ends."""

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Functions:
    """N functions, the first member's first, of `columns` (N / M, D), which all members share.

    `layers` are weights (N, after, before) and biases (N, after), with ReLU in between; the last one has one output.
    """

    columns: Columns
    layers: tuple[tuple[Array, Array], ...]


@dataclass(frozen=True)
class Variance:
    """log v of each test, `LARGEST_LOG_V` at most; sigma is `factor` (T,) times sqrt(v + spread^2), all scaled.

    The columns of `functions` are of [new states; old states; signals; held; 0].
    """

    functions: Functions
    factor: Array


@dataclass(frozen=True)
class Cells:
    """Trained networks of T tests with F states, M members; a value is offset + size * scaled.

    `owner` (F,) is the test of a state, `held` are test and signal of H values a tick before, `predicts` (T,) the
    signal of each test. `speed` (M, F) is s, or Ts throughout where `relaxes` is false; states are kept within
    `lowest` and `highest` (M, F), scaled; `newest` whether h sees the new states.
    Columns of functions count [states (F); signals (nz); held (H); 0]; variance looks at the ensemble's mean states.
    Weights of the column that is 0 are zero.
    """

    members: int
    z_offset: Array
    z_size: Array
    x_offset: Array
    x_size: Array
    owner: Columns
    held: tuple[tuple[int, int], ...]
    rates: Functions
    outputs: Functions
    speed: Array
    lowest: Array
    highest: Array
    relaxes: bool
    newest: bool
    predicts: Columns
    variance: Variance


def cell_graph(c: Cells) -> bytes:
    """The fused graph as ONNX bytes: z (B, nz), x (B, M F + H) -> r, y_hat, sigma (B, T), x_next as x.

    States are those of the first test, member by member, and what it holds; then those of the second, and so on.
    """
    M, F, H, nz, T = c.members, len(c.x_offset), len(c.held), len(c.z_offset), len(c.predicts)
    w = Writer()
    z, x = w.input("z", ["B", nz]), w.input("x", ["B", M * F + H])
    test, signal = np.array(c.held, dtype=np.intp).reshape(-1, 2).T
    # inside, states are sorted by members, and what is held comes last
    outside = np.argsort(np.concatenate([np.tile(c.owner, M), test]), kind="stable")
    every = _scaled(w, w.concat([x, z], axis=1), c, np.argsort(outside), signal)
    old = w.slice(every, 1, 0, M * F)
    new = _advanced(w, c, old, every) if F else old
    seen, first = (w.concat([new, every], axis=1), 2 * M * F) if c.newest else (every, M * F)
    y = _functions(w, seen, _columns(c.outputs, M, F, first), c.outputs.layers)
    mean, among = _mean(w, y, M, T), _spread(w, y, M, T)
    known = w.slice(every, 1, M * F, M * F + nz + H + 1)
    centres = [_mean(w, each, M, F) for each in (new if c.newest else old, old)] if F else []
    own = w.concat([*centres, known], axis=1)
    log_v = _functions(w, own, c.variance.functions.columns, c.variance.functions.layers)
    log_v = _below(w, log_v, np.array(LARGEST_LOG_V))
    sigma = w.cast(w("Sqrt", w("Add", w("Exp", log_v), among)), np.float64)
    size, offset = c.z_size[c.predicts], c.z_offset[c.predicts]
    y_hat = w("Add", w("Mul", w.cast(mean, np.float64), w.constant(size)), w.constant(offset))
    w.output("r", w("Sub", w.gather(z, c.predicts, 1), y_hat), ["B", T])
    w.output("y_hat", y_hat, ["B", T])
    w.output("sigma", w("Mul", sigma, w.constant(size * c.variance.factor)), ["B", T])
    after = w("Mul", w.cast(new, np.float64), w.constant(np.tile(c.x_size, M)))
    after = w.concat([w("Add", after, w.constant(np.tile(c.x_offset, M))), z], axis=1)
    held_next = np.concatenate([np.arange(M * F), M * F + signal])
    w.output("x_next", w.gather(after, held_next[outside], 1), ["B", M * F + H])
    return w.model("faultline-rnn")


def _advanced(w: Writer, c: Cells, old: str, every: str) -> str:
    """The states (B, M F) after a tick."""
    M, F = c.members, len(c.x_offset)
    way = _functions(w, every, _columns(c.rates, M, F, M * F), _slowed(c.rates.layers, c.speed))
    new = w("Add", w("Mul", old, _float(w, 1.0 - c.speed.reshape(1, -1))) if c.relaxes else old, way)
    return _bounded(w, new, c.lowest.reshape(1, -1), c.highest.reshape(1, -1))


def _bounded(w: Writer, values: str, lowest: Array, highest: Array) -> str:
    """The values within bounds; infinite ones, of networks that have not been trained, are none."""
    if not np.isfinite([lowest, highest]).all():
        return values
    bound = _float(w, lowest)
    return _below(w, w("Add", bound, w("Relu", w("Sub", values, bound))), highest)


def _below(w: Writer, values: str, highest: Array) -> str:
    """The values, or the highest where they are above."""
    bound = _float(w, highest)
    return w("Sub", bound, w("Relu", w("Sub", bound, values)))


def _scaled(w: Writer, given: str, c: Cells, inside: Columns, signal: Columns) -> str:
    """[states (M F); signals (nz); held (H); 0] in float32, of what is given: x as it is outside, and z."""
    M, F, H, nz = c.members, len(c.x_offset), len(c.held), len(c.z_offset)
    states, held = np.split(inside, [M * F])
    first = M * F + H
    places = np.concatenate([states, first + np.arange(nz), held, [first]])
    offset = np.concatenate([np.tile(c.x_offset, M), c.z_offset, c.z_offset[signal], [0.0]])
    size = np.concatenate([np.tile(c.x_size, M), c.z_size, c.z_size[signal], [np.inf]])
    shifted = w("Sub", w.gather(given, places, 1), w.constant(offset))
    return w.cast(w("Mul", shifted, w.constant(1.0 / size)), np.float32)


def _columns(of: Functions, members: int, states: int, first: int) -> Columns:
    """Columns (N, D) of all members where their states come one after the other, and from `first` on the rest."""
    own = of.columns < states
    return np.concatenate([np.where(own, of.columns + m * states, of.columns - states + first) for m in range(members)])


def _slowed(layers: tuple[tuple[Array, Array], ...], speed: Array) -> tuple[tuple[Array, Array], ...]:
    """The functions times `speed` (M, F)."""
    weight, bias = layers[-1]
    return (*layers[:-1], (weight * speed.reshape(-1, 1, 1), bias * speed.reshape(-1, 1)))


def _functions(w: Writer, values: str, columns: Columns, layers: tuple[tuple[Array, Array], ...]) -> str:
    """N networks (B, N) of the columns (N, D) of values (B, C)."""
    count, inputs = columns.shape
    together = _neighbours(count, inputs) if len(layers) > 1 else 1
    a = w.gather(values, columns.reshape(count // together, 1, -1), 1)  # (B, N / together, 1, together D)
    for weight, bias in layers[:-1]:
        after, before = weight.shape[1:]
        if (wanted := _neighbours(count, before)) != together:
            together = wanted
            a = w.reshape(a, [-1, count // together, 1, together * before])
        a = w("MatMul", a, _float(w, _blocks(weight.swapaxes(1, 2), together)))
        a = w("Relu", w("Add", a, _float(w, bias.reshape(count // together, 1, -1))))
        inputs = after
    a = w.reshape(a, [-1, count, 1, inputs]) if together != 1 else a
    weight, bias = layers[-1]
    return w("Add", w.total(w("Mul", a, _float(w, weight)), 2, 3), _float(w, bias[:, 0]))


def _neighbours(count: int, inputs: int) -> int:
    """How many neighbouring functions are one product: a product costs 0.2 us, however small its matrix is."""
    return max(g for g in range(1, count + 1) if count % g == 0 and (g == 1 or g * inputs <= WIDE))


def _blocks(weight: Array, together: int) -> Array:
    """Matrices (N, D, H) as block-diagonal ones (N / g, g D, g H)."""
    count, before, after = weight.shape
    grouped = weight.reshape(count // together, together, before, after)
    out = np.zeros((count // together, together, before, together, after))
    for k in range(together):
        out[:, k, :, k] = grouped[:, k]
    return out.reshape(count // together, together * before, together * after)


def _mean(w: Writer, values: str, members: int, count: int) -> str:
    """The members' mean (B, count) of values (B, members count), as a product: one node instead of two."""
    return w("MatMul", values, _float(w, np.tile(np.eye(count), (members, 1)) / members))


def _spread(w: Writer, values: str, members: int, count: int) -> str:
    """The members' sample variance (B, count); of a single one, zero."""
    mean = np.tile(np.eye(count), (members, members)) / members
    away = w("MatMul", values, _float(w, np.eye(members * count) - mean))
    total = np.tile(np.eye(count), (members, 1)) / max(members - 1, 1)
    return w("MatMul", w("Mul", away, away), _float(w, total))


def _float(w: Writer, value: Array) -> str:
    return w.constant(value, np.float32)
