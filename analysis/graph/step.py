"""The implicit step of all tests as one ONNX graph (see `network` for the form of a test).

Backward Euler over h = Ts with every orifice as a chord conductance, m s = m g d, g = s/d, is linear in the new state:

    M x+ = x + h (B u + C m g beta u),      M = I - h (A + C diag(m g) alpha)

The chord itself is found by solving each orifice exactly against the rest of the linearised network (its Thevenin
equivalent: open-circuit argument d0 and impedance Z, from M^-1), in the flow domain and closed form:

    s^2 sign(s) = d0 - Z s   =>   |s| = 2 |d0| / (Z + sqrt(Z^2 + 4 |d0|)),   g = 1 / max(|s|, S_MIN)

This is repeated `sweeps` times, then x+ is solved for. It has no cycle at zero flow and no error from a rippled
neighbour, because no slope of the root is ever used away from the solution. The choice against a plain chord at the
last state, a Rosenbrock step and forward Euler is docs/decisions/001-implicit-step.md.

All tests are stacked: T tests of at most N states in M (T, N, N, B), all S orifices in one vector. A node costs the
same for one test and for ten.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.formula import Formulas
from faultline.analysis.graph.network import Values
from faultline.analysis.graph.writer import Writer

SWEEPS = 1
S_MIN = 1e-3
"""Velocity below which an orifice is laminar [m/s], 5e-4 Pa for water: it bounds the conductance, nothing else."""

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Stacked:
    """The matrices of all tests side by side, each (B, rows, columns); states padded to N a test.

    With L = T N padded states and u = [1; z]: `into` spreads x over L, `beta`, `mu` (1 + nz, S), `alpha` (L, S), h `C`
    (S, L), `M0` = I - h A (1, L N) and h `K` (S, L N) give M, -h `Z` (L N, S) the impedances, h `B` (1 + nz, L), `H`
    (L, T), `E` (1 + nz, T). Behind the signals, z has the tests' formulas one after the other; h `J` (nf, L N) is what
    they take from M, and `V` (nf, L) what they add to the states' capacities, which are 1 otherwise.
    """

    into: Array
    alpha: Array
    beta: Array
    mu: Array
    C: Array
    M0: Array
    K: Array
    Z: Array
    B: Array
    H: Array
    E: Array
    J: Array
    V: Array


STACKED = ("alpha", "beta", "mu", "C", "M0", "K", "Z", "B", "H", "E", "J", "V")
"""The fields of `Stacked` that depend on parameters."""

OF_FORMULAS = ("J", "V")
"""Those that only a bank with formulas has."""


def stack(tests: Sequence[Values], period: float) -> Stacked:
    """Stacks the tests' values for a step of `period` [s].

    The padding of a test's states is the identity, which keeps it at zero. h is multiplied in here, in numpy: as a
    scalar of the graph onnxruntime folds it into the matrix product beside it, as float32.
    """
    batch = len(tests[0].A)
    N = max(1, *(len(test.states) for test in tests))  # of static tests one that stays at zero
    S = sum(test.alpha.shape[1] for test in tests)
    F = sum(test.J.shape[1] for test in tests)
    T, L, nz = len(tests), len(tests) * N, tests[0].beta.shape[2] - tests[0].J.shape[1]  # nz with the 1
    U = nz + F
    shapes = {"alpha": (L, S), "beta": (U, S), "mu": (U, S), "C": (S, L), "M0": (1, L * N), "K": (S, L * N)}
    shapes |= {"Z": (L * N, S), "B": (U, L), "H": (L, T), "E": (U, T), "J": (F, L * N), "V": (F, L)}
    out = {name: np.zeros((batch, *shape)) for name, shape in shapes.items()}
    out["M0"][:, 0] = np.tile(np.eye(N), (T, 1)).ravel()
    into = np.zeros((sum(len(test.states) for test in tests), L))
    first = column = formula = 0
    for t, test in enumerate(tests):
        n, s, f = len(test.states), test.alpha.shape[1], test.J.shape[1]
        rows, flows = slice(t * N, t * N + n), slice(first, first + s)
        given = [*range(nz), *range(nz + formula, nz + formula + f)]
        into[np.arange(column, column + n), np.arange(t * N, t * N + n)] = 1.0
        out["alpha"][:, rows, flows] = np.swapaxes(test.alpha, 1, 2)
        out["beta"][:, given, flows] = np.swapaxes(test.beta, 1, 2)
        out["mu"][:, given, flows] = np.swapaxes(test.mu, 1, 2)
        out["C"][:, flows, rows] = period * np.swapaxes(test.C, 1, 2)
        out["B"][:, given, rows] = period * np.swapaxes(test.B, 1, 2)
        out["H"][:, rows, t] = test.H[:, 0]
        out["E"][:, given, t] = test.E[:, 0]
        own = slice(formula, formula + f)
        out["V"][:, own, rows] = test.V
        for i in range(n):
            for k in range(n):
                entry = (t * N + i) * N + k
                out["J"][:, own, entry] = period * test.J[:, :, i * n + k] - (i == k) * test.V[:, :, i]
                out["M0"][:, 0, entry] -= period * test.A[:, i, k]
                out["K"][:, flows, entry] = period * test.C[:, i, :] * test.alpha[:, :, k]
                out["Z"][:, entry, flows] = -period * test.alpha[:, :, i] * test.C[:, k, :]
        first, column, formula = first + s, column + n, formula + f
    return Stacked(into=into, **out)


def entries(pattern: Array) -> tuple[Indices, Indices]:
    """The rows and columns of the entries of a matrix (1, rows, columns) that are not zero."""
    rows, columns = np.nonzero(pattern[0])
    return rows, columns


def step_graph(
    stacked: Stacked,
    measured: Array,
    sigma: Array,
    formulas: Formulas,
    *,
    sweeps: int = SWEEPS,
    pattern: Stacked | None = None,
) -> bytes:
    """The fused graph as ONNX bytes, float64: z (B, nz), x (B, nx) -> r, y_hat, sigma (B, T), x_next (B, nx).

    `measured` (nz, T) picks the signal that each test predicts. With a `pattern` the matrices are inputs named as in
    `STACKED`: of each the `entries` that the pattern has (D, B), one set a row of the batch, and the formulas'
    parameters `theta` (P, B). Without it they are built in: one set for every row, or as many as the batch is to have
    rows. Inside, the batch is the last axis: the rows of all hypotheses lie side by side in memory.
    """
    w = Writer()
    z, x = w.input("z", ["B", measured.shape[0]]), w.input("x", ["B", stacked.into.shape[0]])
    nz, nx, parametric = measured.shape[0], stacked.into.shape[0], pattern is not None
    present = [name for name in STACKED if name not in OF_FORMULAS or formulas.expressions]
    matrix = {name: _matrix(w, name, getattr(stacked, name), pattern) for name in present}
    L, T = stacked.alpha.shape[1], measured.shape[1]
    N = L // T
    signals = w("Transpose", z)
    nothing = w("Mul", w.slice(signals, 0, 0, 1), w.constant(0.0))  # of the batch's size
    one = w("Add", nothing, w.constant(1.0))
    u = w.concat([one, signals], axis=0)
    states = w("Transpose", x) if nx else nothing
    theta = formulas.write_theta(w, parametric=parametric)
    if formulas.expressions:
        u = w.concat([u, formulas.write(w, formulas.expressions, signals, states, theta)], axis=0)
    old = w("MatMul", w.constant(stacked.into.T if nx else np.zeros((L, 1))), states)
    beta = _times(w, matrix["beta"], u)
    opening = _times(w, matrix["mu"], u)
    held, M0 = old, _times(w, matrix["M0"], one)
    if formulas.expressions:
        f = w.slice(u, 0, 1 + nz, 1 + nz + len(formulas.expressions))
        held = w("Add", old, w("Mul", old, _times(w, matrix["V"], f)))
        M0 = w("Sub", M0, _times(w, matrix["J"], f))
    driven = w("Add", held, _times(w, matrix["B"], u))
    new, inverse, g = old, "", ""
    for _ in range(sweeps + 1):
        d = w("Add", _times(w, matrix["alpha"], new), beta)
        velocity = _thevenin(w, inverse, d, g, opening, matrix["Z"], L * N) if inverse else w("Sqrt", w("Abs", d))
        g = w("Reciprocal", w("Max", velocity, w.constant(S_MIN)))
        q = w("Mul", opening, g)
        M = w("Sub", M0, _times(w, matrix["K"], q))
        inverse = _inverse(w, w.reshape(M, [T, N, N, -1]), N)
        rhs = w("Add", driven, _times(w, matrix["C"], w("Mul", q, beta)))
        new = w.reshape(w.total(w("Mul", inverse, w.reshape(rhs, [T, 1, N, -1])), 2), [L, -1])
    y_hat = w("Add", _times(w, matrix["H"], new), _times(w, matrix["E"], u))
    x_next = w("MatMul", w.constant(stacked.into), new) if nx else nothing
    if formulas.readings:
        readings = formulas.write(w, list(formulas.readings.values()), signals, x_next, theta)
        y_hat = w("Add", y_hat, w("MatMul", w.constant(np.eye(T)[:, list(formulas.readings)]), readings))
    r = w("Sub", w("MatMul", w.constant(measured.T), signals), y_hat)
    by_row = w("Transpose", y_hat)
    w.output("r", w("Transpose", r), ["B", T])
    w.output("y_hat", by_row, ["B", T])
    w.output("sigma", w("Expand", w.constant(sigma[None]), w("Shape", by_row)), ["B", T])
    w.output("x_next", w("Transpose", x_next) if nx else x, ["B", nx])
    return w.model("faultline-ode")


class _Matrix(NamedTuple):
    """A matrix of a graph, transposed: what is `common` (n, m) to all rows of a batch, and D entries of each row.

    These have `values` (D, B), take the places `rows` (D,) of a vector and are added up to n by `into` (n, D).
    """

    common: str
    rows: Indices | None = None
    values: str = ""
    into: str = ""


def _matrix(w: Writer, name: str, values: Array, pattern: Stacked | None) -> _Matrix:
    n = values.shape[2]
    differs = (values != values[:1]).any(axis=0) if pattern is None else getattr(pattern, name)[0] != 0.0
    rows, columns = np.nonzero(differs)
    common = np.where(differs, 0.0, values[0]).T
    if not len(rows):
        return _Matrix(w.constant(common))
    into = w.constant((np.arange(n)[:, None] == columns).astype(np.float64))
    if pattern is not None:
        return _Matrix("", rows, w.input(name, [len(rows), "B"]), into)
    return _Matrix(w.constant(common), rows, w.constant(values[:, rows, columns].T, by_row=True), into)


def _times(w: Writer, matrix: _Matrix, value: str) -> str:
    """A product (n, B) with a vector (m, B): by what all rows share, and the few entries in which they differ.

    A matrix of its own for every row would be megabytes that are read at every tick.
    """
    product = w("MatMul", matrix.common, value) if matrix.common else ""
    if matrix.rows is None:
        return product
    moved = w("MatMul", matrix.into, w("Mul", w.gather(value, matrix.rows, 0), matrix.values))
    return w("Add", product, moved) if product else moved


def _thevenin(w: Writer, inverse: str, d: str, g: str, opening: str, Z: _Matrix, entries: int) -> str:
    """|s| of every orifice against its own Thevenin equivalent, from the linearised network's inverse."""
    seen = _times(w, Z, w.reshape(inverse, [entries, -1]))
    impedance = w("Mul", seen, opening)
    share = w("Max", w("Sub", w.constant(1.0), w("Mul", g, impedance)), w.constant(1e-12))
    Z0 = w("Div", impedance, share)
    size = w("Abs", w("Div", d, share))
    root = w("Sqrt", w("Add", w("Mul", Z0, Z0), w("Mul", w.constant(4.0), size)))
    return w("Div", w("Mul", w.constant(2.0), size), w("Max", w("Add", Z0, root), w.constant(1e-12)))


def _inverse(w: Writer, M: str, N: int) -> str:
    """M^-1 (T, N, N, B) in place: Gauss-Jordan without pivoting, because the pivots of an M-matrix are positive.

    Pivot k replaces row k, column k and their crossing instead of adding to them: with pivots of 1e7 next to ones, the
    shorter W - (column - e_k)(row + e_k) / W_kk would lose half the digits.
    """
    work = M
    for k in range(N):
        unit = np.eye(N)[k]
        others = 1.0 - unit
        row, column = w.slice(work, 1, k, k + 1), w.slice(work, 2, k, k + 1)
        pivot = w.slice(row, 2, k, k + 1)
        right = w("Add", w("Mul", row, w.constant(others.reshape(1, 1, N, 1))), w.constant(unit.reshape(1, 1, N, 1)))
        left = w("Mul", column, w.constant(others.reshape(1, N, 1, 1)))
        left = w("Sub", w.constant(unit.reshape(1, N, 1, 1)), left)
        kept = w("Mul", work, w.constant(np.outer(others, others).reshape(1, N, N, 1)))
        work = w("Add", kept, w("Mul", left, w("Div", right, pivot)))
    return work
