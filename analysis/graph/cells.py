"""Trained networks as one ONNX graph: all functions of all tests and members side by side.

A cell advances its states by functions f of [states; signals] and predicts by functions h, each a linear part plus a
small network (thesis 3.3, 5.10):

    x+ = x + s (f(x, z) - x)   or   x + Ts f(x, z);        y = h(x+, z)   or, with the old input (thesis 3.6), h(x, z)

of M members; z are the signals now and, where a test holds them as further states, those a tick before. What leaves the
graph is the mean prediction of the members, sigma from a variance network and from the members' spread, and the novelty
of the operating point: the distance from the nearest of some centres of what was trained, in parts of that centre's
reach. Scaling is done in float64 at the edge, all else in float32.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.graph.writer import Writer

WIDE = 32
"""Inputs of a product of several functions at most: with more, its zeros cost more than the product spares."""

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Functions:
    """F functions of M members: of `columns` (F, D), linear parts `lin` (M F, D) and `bias` (M F,).

    `layers` are weights (M F, after, before) and biases (M F, after) of the network: hidden layers and the last one.
    """

    columns: Columns
    lin: Array
    bias: Array
    layers: tuple[tuple[Array, Array], ...]


@dataclass(frozen=True)
class Variance:
    """log v of each test by a network with layers as above.

    It is of `columns` (T, D) of [new states; old states; signals; held; 0]. Then sigma is `factor` (T,) times
    sqrt(v + spread^2), all scaled.
    """

    columns: Columns
    layers: tuple[tuple[Array, Array], ...]
    factor: Array


@dataclass(frozen=True)
class Novelty:
    """`centres` (T, N, D) in `columns` (T, D) of [new states; signals; 0], each with its `reach` (T, N)."""

    columns: Columns
    centres: Array
    reach: Array


@dataclass(frozen=True)
class Cells:
    """Trained networks of T tests with F states, M members; a value is offset + size * scaled.

    `owner` (F,) is the test of a state, `held` are test and signal of H values a tick before, `predicts` (T,) the
    signal of each test. `speed` (M, F) is s, or Ts throughout where `relaxes` is false; `newest` whether h sees the new
    states. Columns of functions count [states (F); signals (nz); held (H); 0]; variance and novelty look at the
    ensemble's mean states.
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
    relaxes: bool
    newest: bool
    predicts: Columns
    variance: Variance
    novelty: Novelty


def cell_graph(c: Cells) -> bytes:
    """The fused graph as ONNX bytes: z (B, nz), x (B, M F + H) -> r, y_hat, sigma, novelty (B, T), x_next as x.

    States are those of the first test, member by member, and what it holds; then those of the second, and so on.
    """
    M, F, H, nz, T = c.members, len(c.x_offset), len(c.held), len(c.z_offset), len(c.predicts)
    w = Writer()
    z, x = w.input("z", ["B", nz]), w.input("x", ["B", M * F + H])
    test, signal = np.array(c.held, dtype=np.intp).reshape(-1, 2).T
    x_offset = np.concatenate([np.tile(c.x_offset, M), c.z_offset[signal]])
    x_size = np.concatenate([np.tile(c.x_size, M), c.z_size[signal]])
    # inside, states are sorted by members, and what is held comes last
    outside = np.argsort(np.concatenate([np.tile(c.owner, M), test]), kind="stable")
    u = _single(w, w("Div", w("Sub", z, w.constant(c.z_offset)), w.constant(c.z_size)))
    given = w.gather(x, np.argsort(outside), 1)
    scaled = _single(w, w("Div", w("Sub", given, w.constant(x_offset)), w.constant(x_size)))
    old = w.slice(scaled, 1, 0, M * F) if H else scaled
    nothing = _nothing(w, u)
    inputs = w.concat([u, w.slice(scaled, 1, M * F, M * F + H), nothing] if H else [u, nothing], axis=1)
    f = _functions(w, c.rates, old, inputs, M, F)
    way = w("Sub", f, old) if c.relaxes else f
    new = w("Add", old, w("Mul", way, _float(w, c.speed.reshape(1, -1))))
    seen = new if c.newest else old
    y = w.reshape(_functions(w, c.outputs, seen, inputs, M, F), [-1, M, T])
    mean = w.mean(y, 1)
    spread = w("Sub", y, w.reshape(mean, [-1, 1, T]))
    among = w("Mul", w.mean(w("Mul", spread, spread), 1), _float(w, np.array(M / max(M - 1, 1))))
    centre, before = (w.mean(w.reshape(part, [-1, M, F]), 1) for part in (seen, old))
    own = w.concat([centre, before, inputs], axis=1)
    log_v = _layers(w, _taken(w, own, c.variance.columns), c.variance.layers)
    sigma = w("Mul", w("Sqrt", w("Add", w("Exp", log_v), among)), _float(w, c.variance.factor[None]))
    size, offset = c.z_size[c.predicts], c.z_offset[c.predicts]
    y_hat = w("Add", w("Mul", w.cast(mean, np.float64), w.constant(size)), w.constant(offset))
    w.output("r", w("Sub", w.gather(z, c.predicts, 1), y_hat), ["B", T])
    w.output("y_hat", y_hat, ["B", T])
    w.output("sigma", w("Mul", w.cast(sigma, np.float64), w.constant(size)), ["B", T])
    w.output("novelty", w.cast(_novelty(w, c.novelty, w.concat([centre, u, nothing], axis=1)), np.float64), ["B", T])
    after = w("Mul", w.cast(new, np.float64), w.constant(x_size[: M * F]))
    after = w("Add", after, w.constant(x_offset[: M * F]))
    after = w.concat([after, w.gather(z, signal, 1)], axis=1) if H else after
    w.output("x_next", w.gather(after, outside, 1), ["B", M * F + H])
    return w.model("faultline-rnn")


def _functions(w: Writer, of: Functions, x: str, inputs: str, members: int, states: int) -> str:
    """The functions' values (B, M F) at scaled states x (B, M states) and inputs [signals; held; 0] (B, nz + H + 1)."""
    both = w.concat([x, inputs], axis=1)
    # a member's own states, then the inputs, which all members share
    own = [
        np.where(of.columns < states, of.columns + m * states, of.columns + (members - 1) * states)
        for m in range(members)
    ]
    a = _taken(w, both, np.concatenate(own))
    out = w("Add", _dot(w, a, of.lin), _float(w, of.bias))
    return w("Add", out, _layers(w, a, of.layers)) if of.layers else out


def _layers(w: Writer, a: str, layers: tuple[tuple[Array, Array], ...]) -> str:
    """The networks' values (B, N) at a (B, N, D): ReLU between the layers."""
    for weight, bias in layers[:-1]:
        count, after, before = weight.shape
        together = _neighbours(count, before)
        a = w.reshape(a, [-1, count // together, 1, together * before])
        a = w("MatMul", a, _float(w, _blocks(weight.swapaxes(1, 2), together)))
        a = w("Relu", w("Add", w.reshape(a, [-1, count, after]), _float(w, bias)))
    weight, bias = layers[-1]
    return w("Add", _dot(w, a, weight[:, 0]), _float(w, bias[:, 0]))


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


def _dot(w: Writer, a: str, weight: Array) -> str:
    """The sums (B, N) of a (B, N, D) times weight (N, D)."""
    return w.total(w("Mul", a, _float(w, weight)), 2)


def _taken(w: Writer, values: str, columns: Columns) -> str:
    """The columns (N, D) of values (B, C) as (B, N, D)."""
    return w.reshape(w.gather(values, columns.ravel(), 1), [-1, *columns.shape])


def _novelty(w: Writer, n: Novelty, values: str) -> str:
    """The least distance from a centre, in parts of its reach (B, T)."""
    point = w.reshape(_taken(w, values, n.columns), [-1, len(n.columns), 1, n.columns.shape[1]])
    away = w("Sub", point, _float(w, n.centres))
    square = w.total(w("Mul", away, away), 3)
    return w("Sqrt", w.least(w("Div", square, _float(w, n.reach**2)), 2))


def _nothing(w: Writer, u: str) -> str:
    """A column (B, 1) of zeros."""
    return w("Mul", w.slice(u, 1, 0, 1), _float(w, np.array(0.0)))


def _single(w: Writer, value: str) -> str:
    return w.cast(value, np.float32)


def _float(w: Writer, value: Array) -> str:
    return w.constant(value, np.float32)
