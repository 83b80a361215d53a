"""The implicit step of `analysis.graph.step` as straight-line code: one small network, its matrices as numbers.

Zeros of the matrices are left out and nothing else is changed: every operation is the graph's, in its order. See
docs/decisions/001-implicit-step.md for the method, `step.py` for the letters.
"""

from collections.abc import Sequence

from faultline.analysis.codegen.identifiers import Names
from faultline.analysis.codegen.program import Line
from faultline.analysis.codegen.text import number, weighted
from faultline.analysis.graph.network import Array, Values
from faultline.analysis.graph.step import S_MIN, SWEEPS, stack

Pattern = list[list[bool]]
"""Where a matrix is not zero."""


def step_lines(
    values: Values,
    period: float,
    names: Names,
    *,
    last: Sequence[str],
    new: Sequence[str],
    signals: Sequence[str],
    orifices: Sequence[str],
) -> list[Line]:
    """One step of `period` [s]: the identifiers `last` of the states to the identifiers `new`, with inputs `signals`.

    The last of these are the network's formulas. `orifices` say which equation each orifice is.
    """
    step = _Step(values, period, names, new, orifices)
    lines = step.given(last, ["", *signals])
    lines += [*step.arguments(last, 0), *step.first_velocities(), *step.conductances()]
    lines += step.solved(0)
    for sweep in range(1, SWEEPS + 1):
        lines += [*step.arguments(new, sweep), *step.velocities(), *step.conductances()]
        lines += step.solved(sweep)
    return lines


class _Step:
    """The identifiers of a step: per orifice and per state, and of M; and the parts that it is made of."""

    def __init__(
        self, values: Values, period: float, names: Names, new: Sequence[str], orifices: Sequence[str]
    ) -> None:
        self.m = stack([values], period)
        self.new, self.orifices = new, orifices
        self.n, self.flows = len(new), range(len(orifices))
        self.d, self.opening, self.g, self.q, self.beta, self.v = (
            [names.fresh(f"{letter}{j + 1}") for j in self.flows] for letter in "dmgqbv"
        )
        self.driven = [names.fresh(f"driven_{name}") for name in new]
        self.rhs = [names.fresh(f"rhs_{name}") for name in new]
        self.M = [[names.fresh(f"M{i + 1}{k + 1}") for k in range(self.n)] for i in range(self.n)]
        filled = (self.m.M0[0, 0] != 0) | (self.m.K[0] != 0).any(axis=0) | (self.m.J[0] != 0).any(axis=0)
        self.pattern: Pattern = filled.reshape(self.n, self.n).tolist()
        self.inverse, self.filled = _inverted(self.M, self.pattern)

    def given(self, last: Sequence[str], u: Sequence[str]) -> list[Line]:
        """What the inputs u = [1; z] give, whatever the new state."""
        m, lines = self.m, list[Line]()
        self.formulas = u[len(u) - m.J.shape[1] :]
        for j, place in enumerate(self.orifices):
            lines.append(Line(self.beta[j], _sum(u, m.beta[0, :, j]), f"{place}: argument without the states"))
            lines.append(Line(self.opening[j], _sum(u, m.mu[0, :, j]), f"{place}: opening"))
        for i, state in enumerate(self.new):
            capacity = weighted({"": 1.0, **dict(zip(self.formulas, m.V[0, :, i], strict=True))})
            held = last[i] if capacity == "1.0" else f"({capacity})*{last[i]}"
            text = _plus(held, _sum(u, m.B[0, :, i]))
            lines.append(Line(self.driven[i], text, f"{state} with the inputs alone"))
        return lines

    def arguments(self, states: Sequence[str], sweep: int) -> list[Line]:
        """The arguments d = alpha x + beta u."""
        texts = [_plus(_sum(states, self.m.alpha[0, :, j]), self.beta[j]) for j in self.flows]
        return self._by_orifice(self.d, texts, f"argument of the root, sweep {sweep}")

    def first_velocities(self) -> list[Line]:
        """|s| at the last state."""
        return self._by_orifice(self.v, [f"sqrt(fabs({d}))" for d in self.d], "velocity at the last state")

    def velocities(self) -> list[Line]:
        """|s| of every orifice against its own Thevenin equivalent, from the inverse of M of the sweep before."""
        texts = []
        for j in self.flows:
            pairs = [(i, k) for i in range(self.n) for k in range(self.n) if self.filled[i][k]]
            seen = weighted({self.M[i][k]: self.m.Z[0, i * self.n + k, j] for i, k in pairs})
            texts.append(f"velocity({self.d[j]}, {self.g[j]}, ({seen})*{self.opening[j]})")
        return self._by_orifice(self.v, texts, "velocity against the rest of the network")

    def conductances(self) -> list[Line]:
        """The chords g = 1/|s|, and q = m g."""
        chords = [f"1.0/at_least({v}, {number(S_MIN)})" for v in self.v]
        flows = [f"{opening}*{g}" for opening, g in zip(self.opening, self.g, strict=True)]
        return [
            *self._by_orifice(self.g, chords, "chord conductance"),
            *self._by_orifice(self.q, flows, "times the opening"),
        ]

    def solved(self, sweep: int) -> list[Line]:
        """M x = rhs by the inverse of M = I - h (A + C diag(m g) alpha)."""
        n, m, lines = self.n, self.m, []
        for i, k in ((i, k) for i in range(n) for k in range(n) if self.pattern[i][k]):
            terms = {"": m.M0[0, 0, i * n + k], **{q: -m.K[0, j, i * n + k] for j, q in enumerate(self.q)}}
            terms |= {formula: -m.J[0, j, i * n + k] for j, formula in enumerate(self.formulas)}
            lines.append(Line(self.M[i][k], weighted(terms), f"M, row of {self.new[i]}, column of {self.new[k]}"))
        lines += self.inverse
        for i, state in enumerate(self.new):
            flow = weighted({f"{self.q[j]}*{self.beta[j]}": m.C[0, j, i] for j in self.flows})
            lines.append(Line(self.rhs[i], _plus(self.driven[i], flow), f"right-hand side of {state}"))
        for i, state in enumerate(self.new):
            products = [f"{self.M[i][k]}*{self.rhs[k]}" for k in range(n) if self.filled[i][k]]
            lines.append(Line(state, " + ".join(products), f"state after sweep {sweep}"))
        return lines

    def _by_orifice(self, targets: Sequence[str], texts: Sequence[str], note: str) -> list[Line]:
        notes = [f"{place}: {note}" for place in self.orifices]
        return [Line(*parts) for parts in zip(targets, texts, notes, strict=True)]


def _inverted(M: list[list[str]], pattern: Pattern) -> tuple[list[Line], Pattern]:
    """Gauss-Jordan in place without pivoting, and where the inverse is not zero."""
    n, filled = len(M), [list(row) for row in pattern]
    lines: list[Line] = []
    for k in range(n):
        others = [j for j in range(n) if j != k and filled[k][j]]
        lines += [Line(M[k][j], f"{M[k][j]}/{M[k][k]}") for j in others]
        lines.append(Line(M[k][k], f"1.0/{M[k][k]}", f"inverse of M: pivot {k + 1} of {n}"))
        for i in (i for i in range(n) if i != k and filled[i][k]):
            for j in others:
                old = f"{M[i][j]} - " if filled[i][j] else "-"
                lines.append(Line(M[i][j], f"{old}{M[i][k]}*{M[k][j]}"))
                filled[i][j] = True
            lines.append(Line(M[i][k], f"-{M[i][k]}*{M[k][k]}"))
    return lines, filled


def _sum(names: Sequence[str], factors: Array) -> str:
    return weighted(dict(zip(names, factors, strict=True)))


def _plus(first: str, second: str) -> str:
    """The sum of two texts; a zero is left out."""
    if "0.0" in (first, second):
        return second if first == "0.0" else first
    return f"{first} - {second[1:]}" if second.startswith("-") else f"{first} + {second}"
