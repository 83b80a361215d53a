"""The implicit step of all tests as one ONNX graph (see `network` for the form of a test).

Backward Euler over h = Ts with every orifice as a chord conductance, m s = m g d, g = s/d, is linear in the new state:

    M x+ = x + h (B u + C m g beta u),      M = I - h (A + C diag(m g) alpha)

The chord itself is found by solving each orifice exactly against the rest of the linearised network (its Thevenin
equivalent: open-circuit argument d0 and impedance Z, from M^-1), in the flow domain and closed form:

    s^2 sign(s) = d0 - Z s   =>   |s| = 2 |d0| / (Z + sqrt(Z^2 + 4 |d0|)),   g = 1 / max(|s|, S_MIN)

This is repeated `sweeps` times, then x+ is solved for. It has no cycle at zero flow and no error from a rippled
neighbour, because no slope of the root is ever used away from the solution. The choice against a plain chord at the
last state, a Rosenbrock step and forward Euler is docs/decisions/001-implicit-step.md.

All tests are stacked: T tests of at most N states in M (B, T, N, N), all S orifices in one vector. A node costs the
same for one test and for ten.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.formula import Formulas
from faultline.analysis.graph.network import Values
from faultline.analysis.graph.writer import Writer

SWEEPS = 1
S_MIN = 1e-3
"""Velocity below which an orifice is laminar [m/s], 5e-4 Pa for water: it bounds the conductance, nothing else."""

Array = npt.NDArray[np.float64]


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


def step_graph(
    stacked: Stacked,
    measured: Array,
    sigma: Array,
    formulas: Formulas,
    *,
    sweeps: int = SWEEPS,
    parametric: bool = False,
) -> bytes:
    """The fused graph as ONNX bytes, float64: z (B, nz), x (B, nx) -> r, y_hat, sigma (B, T), x_next (B, nx).

    `measured` (nz, T) picks the signal that each test predicts. With `parametric` the matrices are inputs named as in
    `STACKED`, one set per row of the batch, and the formulas' parameters `theta`; without it they are built in: one set
    for every row, or as many as the batch is to have rows.
    """
    w = Writer()
    z, x = w.input("z", ["B", measured.shape[0]]), w.input("x", ["B", stacked.into.shape[0]])
    nz, nx = measured.shape[0], stacked.into.shape[0]
    present = [name for name in STACKED if name not in OF_FORMULAS or formulas.expressions]
    matrix = {name: _matrix(w, name, getattr(stacked, name), parametric) for name in present}
    L, T = stacked.alpha.shape[1], measured.shape[1]
    N = L // T
    z3 = w.reshape(z, [-1, 1, nz])
    u = w.concat([w("Add", w("Mul", w.slice(z3, 2, 0, 1), w.constant(0.0)), w.constant(1.0)), z3], axis=2)
    nothing = w("Mul", w.slice(z3, 2, 0, 1), w.constant(0.0))  # of the batch's size
    x3 = w.reshape(x, [-1, 1, nx]) if nx else nothing
    theta = formulas.write_theta(w, parametric=parametric)
    if formulas.expressions:
        u = w.concat([u, formulas.write(w, formulas.expressions, z3, x3, theta)], axis=2)
    old = w("MatMul", x3, w.constant(stacked.into if nx else np.zeros((1, L))))
    beta = w("MatMul", u, matrix["beta"])
    opening = w("MatMul", u, matrix["mu"])
    held, M0 = old, matrix["M0"]
    if formulas.expressions:
        f = w.slice(u, 2, 1 + nz, 1 + nz + len(formulas.expressions))
        held = w("Add", old, w("Mul", old, w("MatMul", f, matrix["V"])))
        M0 = w("Sub", M0, w("MatMul", f, matrix["J"]))
    driven = w("Add", held, w("MatMul", u, matrix["B"]))
    new, inverse, g = old, "", ""
    for _ in range(sweeps + 1):
        d = w("Add", w("MatMul", new, matrix["alpha"]), beta)
        velocity = _thevenin(w, inverse, d, g, opening, matrix["Z"], L * N) if inverse else w("Sqrt", w("Abs", d))
        g = w("Reciprocal", w("Max", velocity, w.constant(S_MIN)))
        q = w("Mul", opening, g)
        M = w("Sub", M0, w("MatMul", q, matrix["K"]))
        inverse = _inverse(w, w.reshape(M, [-1, T, N, N]), N)
        rhs = w("Add", driven, w("MatMul", w("Mul", q, beta), matrix["C"]))
        new = w.reshape(w("MatMul", inverse, w.reshape(rhs, [-1, T, N, 1])), [-1, 1, L])
    y_hat = w("Add", w("MatMul", new, matrix["H"]), w("MatMul", u, matrix["E"]))
    x_next = w("MatMul", new, w.constant(stacked.into.T)) if nx else nothing
    if formulas.readings:
        readings = formulas.write(w, list(formulas.readings.values()), z3, x_next, theta)
        y_hat = w("Add", y_hat, w("MatMul", readings, w.constant(np.eye(T)[list(formulas.readings)])))
    y_hat = w.reshape(y_hat, [-1, T])
    w.output("r", w("Sub", w("MatMul", z, w.constant(measured)), y_hat), ["B", T])
    w.output("y_hat", y_hat, ["B", T])
    w.output("sigma", w("Expand", w.constant(sigma[None]), w("Shape", y_hat)), ["B", T])
    w.output("x_next", w.reshape(x_next, [-1, nx]) if nx else x, ["B", nx])
    return w.model("faultline-ode")


def _matrix(w: Writer, name: str, values: Array, parametric: bool) -> str:
    if parametric:
        return w.input(name, ["B", *values.shape[1:]])
    return w.constant(values[0] if (values == values[:1]).all() else values)


def _thevenin(w: Writer, inverse: str, d: str, g: str, opening: str, Z: str, entries: int) -> str:
    """|s| of every orifice against its own Thevenin equivalent, from the linearised network's inverse."""
    seen = w("MatMul", w.reshape(inverse, [-1, 1, entries]), Z)
    impedance = w("Mul", seen, opening)
    share = w("Max", w("Sub", w.constant(1.0), w("Mul", g, impedance)), w.constant(1e-12))
    Z0 = w("Div", impedance, share)
    size = w("Abs", w("Div", d, share))
    root = w("Sqrt", w("Add", w("Mul", Z0, Z0), w("Mul", w.constant(4.0), size)))
    return w("Div", w("Mul", w.constant(2.0), size), w("Max", w("Add", Z0, root), w.constant(1e-12)))


def _inverse(w: Writer, M: str, N: int) -> str:
    """M^-1 (B, T, N, N) in place: Gauss-Jordan without pivoting, because the pivots of an M-matrix are positive.

    Pivot k replaces row k, column k and their crossing instead of adding to them: with pivots of 1e7 next to ones, the
    shorter W - (column - e_k)(row + e_k) / W_kk would lose half the digits.
    """
    work = M
    for k in range(N):
        unit = np.eye(N)[k]
        others = 1.0 - unit
        row, column = w.slice(work, 2, k, k + 1), w.slice(work, 3, k, k + 1)
        pivot = w.slice(row, 3, k, k + 1)
        right = w("Add", w("Mul", row, w.constant(others.reshape(1, 1, 1, N))), w.constant(unit.reshape(1, 1, 1, N)))
        left = w("Mul", column, w.constant(others.reshape(1, 1, N, 1)))
        left = w("Sub", w.constant(unit.reshape(1, 1, N, 1)), left)
        kept = w("Mul", work, w.constant(np.outer(others, others).reshape(1, 1, N, N)))
        work = w("Add", kept, w("Mul", left, w("Div", right, pivot)))
    return work
