r"""A test as a flow network: pressures joined by orifices, the canonical form that the implicit step solves.

Substituting a test's equations along its computational graph (thesis 3.3, 5.6) leaves, for the states x (n,) and known
signals z (nz,), with u = [1; z]:

    d_j  = alpha_j x + beta_j u                 argument of orifice j            [m2/s2]
    s_j  = sgsqrt(d_j),  m_j = mu_j u           its velocity and its opening     [m/s], [1]
    x'   = C (m s) + A x + B u                  balance of every volume          [Pa/s]
    y_hat = H x + E u                           prediction of the tested sensor  [Pa]

alpha, beta, mu, C, A, B, H and E depend on the parameters alone. What does not fit this form (a state inside another
nonlinear function, an opening that depends on a state) is refused with the reason.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import sympy as sp

from analysis.model import Model, sgsqrt
from analysis.structure import Test
from service.core.errors import InputError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Network:
    """The matrices of one test as expressions of the parameters; rows of states, orifices or the output."""

    test: str
    states: tuple[str, ...]
    alpha: sp.Matrix  # (S, n)
    beta: sp.Matrix  # (S, 1 + nz)
    mu: sp.Matrix  # (S, 1 + nz)
    C: sp.Matrix  # (n, S)
    A: sp.Matrix  # (n, n)
    B: sp.Matrix  # (n, 1 + nz)
    H: sp.Matrix  # (1, n)
    E: sp.Matrix  # (1, 1 + nz)


def flow_network(model: Model, test: Test, inputs: Sequence[str]) -> Network:
    """The network of a test with integral causality, over the known signals `inputs`, with the faults as parameters.

    Raises:
        InputError: an equation cannot be solved uniquely for its variable, or the test does not have the form above.
    """
    place = f"{model.name}: {test.name}"
    values = _substituted(model, test, place)
    derivatives = {d.state: d.derivative for d in model.differentials}
    states = [sp.Symbol(name) for name in test.states]
    signals = [sp.Symbol(name) for name in inputs]
    rates = [sp.expand(values[sp.Symbol(derivatives[name])]) for name in test.states]
    output = _solved(model.expression(test.residual, with_fault=True).subs(values), sp.Symbol(test.predicts), place)

    velocities = sorted(set().union(*(rate.atoms(sgsqrt) for rate in rates)), key=sp.default_sort_key)
    flows: list[tuple[sp.Expr, sp.Expr]] = []  # (opening, velocity): one orifice may act with several openings
    columns: list[dict[int, sp.Expr]] = []
    linear = [rate.subs(dict.fromkeys(velocities, 0)) for rate in rates]
    for velocity in velocities:
        for row, rate in enumerate(rates):
            coefficient = sp.expand(rate.coeff(velocity))
            if coefficient == 0:
                continue
            if coefficient.free_symbols & set(states) or coefficient.atoms(sgsqrt):
                raise InputError(
                    f"{place}: the flow {velocity} is multiplied by a state; write it as a flow of its own"
                )
            for opening, gain in _openings(coefficient, signals):
                key = (opening, velocity)
                if key not in flows:
                    flows.append(key)
                    columns.append({})
                columns[flows.index(key)][row] = gain
    arguments = [velocity.args[0] for _, velocity in flows]
    network = Network(
        test=test.name,
        states=test.states,
        alpha=_matrix([_affine(a, states, signals, place)[0] for a in arguments], len(states)),
        beta=_matrix([_affine(a, states, signals, place)[1] for a in arguments], 1 + len(signals)),
        mu=_matrix([_affine(opening, states, signals, place)[1] for opening, _ in flows], 1 + len(signals)),
        C=sp.Matrix(len(states), len(flows), lambda i, j: columns[j].get(i, 0)),
        A=_matrix([_affine(rate, states, signals, place)[0] for rate in linear], len(states)),
        B=_matrix([_affine(rate, states, signals, place)[1] for rate in linear], 1 + len(signals)),
        H=_matrix([_affine(output, states, signals, place)[0]], len(states)),
        E=_matrix([_affine(output, states, signals, place)[1]], 1 + len(signals)),
    )
    _check_rebuilt(network, rates, flows, states, signals, place)
    return network


@dataclass(frozen=True)
class Values:
    """A network's matrices as numbers for B sets of parameters: every array is (B, rows, columns)."""

    test: str
    states: tuple[str, ...]
    alpha: Array
    beta: Array
    mu: Array
    C: Array
    A: Array
    B: Array
    H: Array
    E: Array


MATRICES = ("alpha", "beta", "mu", "C", "A", "B", "H", "E")


class Evaluator:
    """Evaluates networks for sets of parameters; compiled once, called with every trial of a calibration."""

    def __init__(self, networks: Sequence[Network], model: Model) -> None:
        self._networks = networks
        self._names = [*model.parameters, *model.faults]
        self._nominal = {**{name: p.value for name, p in model.parameters.items()}, **dict.fromkeys(model.faults, 0.0)}
        entries = [getattr(network, field) for network in networks for field in MATRICES]
        self._shapes = [entry.shape for entry in entries]
        flat = [element for entry in entries for element in entry]
        self._function = sp.lambdify([sp.Symbol(name) for name in self._names], flat, modules="numpy", cse=True)

    def __call__(self, trials: Sequence[Mapping[str, float]]) -> list[Values]:
        """The networks' values for each trial: a mapping of the parameters and faults that differ from the nominal."""
        columns = np.array([[trial.get(n, self._nominal[n]) for trial in trials] for n in self._names])  # (P, B)
        elements = np.array([np.broadcast_to(e, len(trials)) for e in self._function(*columns)], dtype=np.float64)
        arrays: list[Array] = []
        start = 0
        for rows, cols in self._shapes:
            block = elements[start : start + rows * cols].reshape(rows, cols, len(trials))
            arrays.append(np.moveaxis(block, -1, 0))
            start += rows * cols
        step = len(MATRICES)
        return [
            Values(network.test, network.states, *arrays[k * step : (k + 1) * step])
            for k, network in enumerate(self._networks)
        ]


def _substituted(model: Model, test: Test, place: str) -> dict[sp.Symbol, sp.Expr]:
    """Every algebraic variable of the test in terms of states and known signals, along its computational graph."""
    values: dict[sp.Symbol, sp.Expr] = {}
    for equation, variable in test.sequence:
        expression = model.expression(equation, with_fault=True).subs(values)
        values[sp.Symbol(variable)] = _solved(expression, sp.Symbol(variable), f"{place}: {equation}")
    return values


def _solved(expression: sp.Expr, variable: sp.Symbol, place: str) -> sp.Expr:
    """The one solution of expression = 0 for the variable; only a linear one is certain to be the only one."""
    slope = sp.diff(expression, variable)
    if slope == 0 or slope.has(variable):
        raise InputError(f"{place}: cannot be solved for {variable} with one solution only; choose another causality")
    return sp.expand(-(expression.subs(variable, 0)) / slope)


def _openings(coefficient: sp.Expr, signals: Sequence[sp.Symbol]) -> list[tuple[sp.Expr, sp.Expr]]:
    """Splits a flow's coefficient into (opening in the signals, gain in the parameters) terms."""
    terms: dict[sp.Expr, sp.Expr] = {}
    for term in sp.Add.make_args(coefficient):
        gain, opening = term.as_independent(*signals, as_Add=False)
        terms[opening] = terms.get(opening, sp.Integer(0)) + gain
    return list(terms.items())


def _affine(
    expression: sp.Expr, states: Sequence[sp.Symbol], signals: Sequence[sp.Symbol], place: str
) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Coefficients of the states, and of [1; signals]; refused where the expression is anything but affine in both."""
    variables = [*states, *signals]
    expanded = sp.expand(expression)
    gains = [expanded.coeff(variable) for variable in variables]
    constant = expanded.subs(dict.fromkeys(variables, 0))
    rest = sp.simplify(expanded - constant - sum(g * v for g, v in zip(gains, variables, strict=True)))
    if rest != 0 or any(gain.free_symbols & set(variables) for gain in gains) or constant.has(sp.zoo, sp.nan):
        raise InputError(
            f"{place}: {expression} is not affine in states and signals; the implicit step cannot solve it"
        )
    return gains[: len(states)], [constant, *gains[len(states) :]]


def _matrix(rows: list[list[sp.Expr]], columns: int) -> sp.Matrix:
    return sp.Matrix(len(rows), columns, [element for row in rows for element in row])


def _check_rebuilt(
    network: Network,
    rates: Sequence[sp.Expr],
    flows: Sequence[tuple[sp.Expr, sp.Expr]],
    states: Sequence[sp.Symbol],
    signals: Sequence[sp.Symbol],
    place: str,
) -> None:
    """The network must be the equations, term by term: what was not captured (a product of flows) is refused."""
    u = sp.Matrix([1, *signals])
    products = sp.Matrix(len(flows), 1, [opening * velocity for opening, velocity in flows])
    rebuilt = network.C * products + network.A * sp.Matrix(len(states), 1, states) + network.B * u
    for state, rate, again in zip(network.states, rates, rebuilt, strict=True):
        if sp.expand(rate - again) != 0:
            raise InputError(f"{place}: the rate of {state} is not a sum of flows and affine terms: {rate}")
