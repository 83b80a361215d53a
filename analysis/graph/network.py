r"""A test as a flow network: pressures joined by orifices, the canonical form that the implicit step solves.

Substituting a test's equations along its computational graph (thesis 3.3, 5.6) leaves, for the states x (n,) and known
signals z (nz,), with u = [1; z]:

    d_j  = alpha_j x + beta_j u                 argument of orifice j            [m2/s2]
    s_j  = sgsqrt(d_j),  m_j = mu_j u           its velocity and its opening     [m/s], [1]
    x'   = C (m s) + A x + B u                  balance of every volume          [Pa/s]
    y_hat = H x + E u                           prediction of the tested sensor  [Pa]

alpha, beta, mu, C, A, B, H and E depend on the parameters alone. What does not fit this form is made to by formulas f
of signals and last states (see `linear`): z has them as further signals, and the balance terms sum_i f_i J_i x and
volumes that depend on pressure, (1 + V f) x', in addition. A sensor that shows what is not affine adds its reading.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import sympy as sp

from faultline.analysis.graph.linear import Linear, linear_form
from faultline.analysis.model import Model, sgsqrt
from faultline.analysis.structure import Test
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]
Form = Callable[[sp.Expr], sp.Expr]


@dataclass(frozen=True)
class Network:
    """The matrices of one test as expressions of the parameters; rows of states, orifices or the output.

    Of the nz signals the last nf are the `formulas`.
    """

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
    J: sp.Matrix  # (nf, n n)
    V: sp.Matrix  # (nf, n)
    formulas: dict[sp.Symbol, sp.Expr]  # (nf,) of signals, parameters and the states at the `last` tick
    reading: sp.Expr  # of the output, beside H and E; zero where these are all


def flow_network(model: Model, test: Test, inputs: Sequence[str]) -> Network:
    """The network of a test with integral causality, over the known signals `inputs`, with the faults as parameters.

    Raises:
        InputError: an equation cannot be solved uniquely for its variable, or the test does not have the form above.
    """
    place = f"{model.name}: {test.name}"
    signals = [sp.Symbol(name) for name in inputs]
    if not test.equations:  # a residual of another tool, predicted to be zero
        return _network(test, signals, Linear([], [], sp.Integer(0), {}, sp.Integer(0)), place)
    rates, output = _rates(model, test, place, sp.expand)
    try:
        return _network(test, signals, Linear(rates, [sp.Integer(0)] * len(rates), output, {}, sp.Integer(0)), place)
    except InputError:
        rates, output = _rates(model, test, place, lambda grouped: grouped)
        middle = {sp.Symbol(name): sp.Float((model.known[name].min + model.known[name].max) / 2) for name in inputs}
        numbers = {sp.Symbol(name): sp.Float(p.value) for name, p in model.parameters.items()}
        numbers |= {sp.Symbol(name): sp.Integer(0) for name in model.assumable}
        linear = linear_form(test.name, test.states, middle, numbers, rates, output, place)
        return _network(test, signals, linear, place)


def _rates(model: Model, test: Test, place: str, form: Form) -> tuple[list[sp.Expr], sp.Expr]:
    """The rates of the test's states and its output in terms of states and known signals, each result in a `form`."""
    values = _substituted(model, test, place, form)
    derivatives = {d.state: d.derivative for d in model.differentials}
    rates = [form(values[sp.Symbol(derivatives[name])]) for name in test.states]
    residual = model.expression(test.residual, with_fault=True).xreplace(values)
    return rates, _solved(residual, sp.Symbol(test.predicts), place, form)


def _network(test: Test, known: Sequence[sp.Symbol], linear: Linear, place: str) -> Network:
    """The network of rates and output that are affine in states and signals, but for roots and for formulas."""
    states = [sp.Symbol(name) for name in test.states]
    formulas = linear.formulas
    signals = [*known, *formulas]
    output = linear.output
    rates, J = _without_products(linear.rates, formulas, states)
    velocities = sorted(set().union(*(rate.atoms(sgsqrt) for rate in rates)), key=sp.default_sort_key)
    flows: list[tuple[sp.Expr, sp.Expr]] = []  # (opening, velocity): one orifice may act with several openings
    columns: list[dict[int, sp.Expr]] = []
    rootless = [rate.xreplace(dict.fromkeys(velocities, sp.Integer(0))) for rate in rates]
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
        A=_matrix([_affine(rate, states, signals, place)[0] for rate in rootless], len(states)),
        B=_matrix([_affine(rate, states, signals, place)[1] for rate in rootless], 1 + len(signals)),
        H=_matrix([_affine(output, states, signals, place)[0]], len(states)),
        E=_matrix([_affine(output, states, signals, place)[1]], 1 + len(signals)),
        J=J,
        V=sp.Matrix(len(formulas), len(states), [sp.Integer(c == f) for f in formulas for c in linear.capacities]),
        formulas=dict(formulas),
        reading=linear.reading,
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
    J: Array
    V: Array


MATRICES = ("alpha", "beta", "mu", "C", "A", "B", "H", "E", "J", "V")


class Evaluator:
    """Evaluates networks for sets of parameters; compiled once, called with every trial of a calibration."""

    def __init__(self, networks: Sequence[Network], model: Model) -> None:
        self._networks = networks
        self._names = [*model.parameters, *model.assumable]
        self._nominal = {
            **{name: p.value for name, p in model.parameters.items()},
            **dict.fromkeys(model.assumable, 0.0),
        }
        entries = [getattr(network, field) for network in networks for field in MATRICES]
        self._shapes = [entry.shape for entry in entries]
        flat = [element for entry in entries for element in entry]
        self._function = sp.lambdify(
            [sp.Symbol(name) for name in self._names], flat, "numpy", cse=True, docstring_limit=0
        )

    def __call__(self, trials: Sequence[Mapping[str, float]]) -> list[Values]:
        """The networks' values for each trial: a mapping of the parameters and faults that differ from the nominal."""
        columns = np.array([[trial.get(n, self._nominal[n]) for trial in trials] for n in self._names])  # (P, B)
        elements = np.array([np.broadcast_to(e, len(trials)) for e in self._function(*columns)], dtype=np.float64)
        return self._values(elements)

    @cached_property
    def structure(self) -> list[Values]:
        """The networks' values with one for each entry that is not zero with all parameters and faults."""
        entries = [element for network in self._networks for field in MATRICES for element in getattr(network, field)]
        return self._values(np.array([[float(element != 0)] for element in entries]))

    def _values(self, elements: Array) -> list[Values]:
        """The values of which all `elements` (n, B) are these."""
        arrays: list[Array] = []
        start = 0
        for rows, cols in self._shapes:
            block = elements[start : start + rows * cols].reshape(rows, cols, elements.shape[1])
            arrays.append(np.moveaxis(block, -1, 0))
            start += rows * cols
        step = len(MATRICES)
        return [
            Values(network.test, network.states, *arrays[k * step : (k + 1) * step])
            for k, network in enumerate(self._networks)
        ]


def _substituted(model: Model, test: Test, place: str, form: Form) -> dict[sp.Symbol, sp.Expr]:
    """Every algebraic variable of the test in terms of states and known signals, along its computational graph."""
    values: dict[sp.Symbol, sp.Expr] = {}
    for equation, variable in test.sequence:
        expression = model.expression(equation, with_fault=True).xreplace(values)
        values[sp.Symbol(variable)] = _solved(expression, sp.Symbol(variable), f"{place}: {equation}", form)
    return values


def _solved(expression: sp.Expr, variable: sp.Symbol, place: str, form: Form) -> sp.Expr:
    """The one solution of expression = 0 for the variable; only a linear one is certain to be the only one."""
    slope = sp.diff(expression, variable)
    if slope == 0 or slope.has(variable):
        raise InputError(f"{place}: cannot be solved for {variable} with one solution only; choose another causality")
    return form(-(expression.xreplace({variable: sp.Integer(0)})) / slope)


def _without_products(
    rates: Sequence[sp.Expr], formulas: Collection[sp.Symbol], states: Sequence[sp.Symbol]
) -> tuple[list[sp.Expr], sp.Matrix]:
    """The rates without their terms J f x, and J (nf, n n)."""
    rows = [[rate.coeff(f).coeff(x) for rate in rates for x in states] for f in formulas]
    J = sp.Matrix(len(rows), len(states) ** 2, [gain for row in rows for gain in row])
    if not rows:
        return list(rates), J
    per_rate = (sp.Matrix(1, len(rows), list(formulas)) * J).reshape(len(states), len(states))
    products = per_rate * sp.Matrix(len(states), 1, states)
    return [sp.expand(rate - product) for rate, product in zip(rates, products, strict=True)], J


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
    constant = expanded.xreplace(dict.fromkeys(variables, sp.Integer(0)))
    rest = sp.simplify(expanded - constant - sum(g * v for g, v in zip(gains, variables, strict=True)))
    if rest != 0 or any(gain.free_symbols & set(variables) for gain in gains) or constant.has(sp.zoo, sp.nan):
        raise InputError(
            f"{place}: {str(rest)[:60]} is not affine in states and signals; the implicit step cannot solve it: "
            "give it a volume, or write it as a flow"
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
            left = str(sp.expand(rate - again))[:60]
            raise InputError(f"{place}: the rate of {state} has more than flows and affine terms, {left}; split it")
