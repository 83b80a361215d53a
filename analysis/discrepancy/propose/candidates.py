"""Candidates for a missing term of an equation: a shape at a place, as the table of a library's entry.

A term enters at a name of the equation: added to it, `s + c*h`, with the unit of the name, or as a factor,
`s*(1 + c*h)`. Besides there are what sensors and actuators do with a name: a lag, backlash, a dead band. So a formula
is consistent in its units by the way it is made.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.find.quantities import compiled
from faultline.analysis.discrepancy.propose.dynamic import late
from faultline.analysis.discrepancy.propose.grammar import shapes
from faultline.analysis.discrepancy.propose.shape import Shape, Tables, nice, scale

Array = npt.NDArray[np.float64]
Table = dict[str, object]

SIZE = 0.2
"""Of how much an equation's largest term varies: a term of this size would be seen well."""

FLAT = 0.1
"""Of an equation's largest term itself: one that hardly varies may lack as much."""

SMALL = 1e-3
"""Part of a name's size by which it is moved for a derivative."""

LEFT = 0.05
"""Of what a factor multiplies, at least so much stays."""

BANDS = (0.02, 0.06, 0.2)
"""Half widths of a backlash, in standard deviations of its signal, tried; it is fitted then."""

FOREIGN = 10.0
"""Evidence [nats] that a signal must bring which the equation does not contain."""

FORMS: Mapping[str, float] = {"constant": 0.0, "linear": 0.0, "step": 0.0, "time": 1.0, "lag": 1.0, "level": 4.0}
OTHER = 2.0
"""The same for a form; `OTHER` for those that are not listed."""

ASIDE, DEEP = 1.0, 3.0
"""The same for a term at an input, a fixed parameter or within a function, and for a factor of an unknown within it."""

SOURCE = "composed by `faultline discover` from recordings, and to be reviewed: a formula, no known physics"


@dataclass(frozen=True)
class Candidate:
    """A term for an `equation` at its name `symbol`, in a `form`, as the `table` of an entry.

    `direction` (K,) is what disturbance of the equation it is for a strength of one spread, to first order. A strength
    that is `one_sided` is positive. Of one `family` all but a fitted constant is the same. `cost` [nats] is what it
    must bring more than another: of two that explain alike the simpler one is meant.
    """

    equation: str
    symbol: str
    form: str
    words: str
    table: Table
    direction: Array
    family: tuple[str, ...]
    cost: float
    one_sided: bool = False

    @property
    def name(self) -> str:
        """The entry's name."""
        return str(self.table["name"])


def candidates(operation: Operation, equation: str) -> list[Candidate]:
    """Return all candidates for an equation."""
    place = _Place(operation, equation)
    found: list[Candidate] = []
    for symbol in place.added:
        found += [place.sum(symbol, shape) for shape in place.shapes]
        found += place.memories(symbol)
    for symbol in place.factors:
        found += [place.times(symbol, shape) for shape in place.shapes if not shape.bare]
    return [c for c in found if np.isfinite(c.direction).all() and np.abs(c.direction).max() > 0.0]


class _Place:
    """An equation along a run: where a term may enter, and what a change of a name there does to it."""

    def __init__(self, operation: Operation, equation: str) -> None:
        self._operation, self._equation, self._model = operation, equation, operation.model
        expression = self._model.equations[equation].expression
        self._names = sorted(symbol.name for symbol in expression.free_symbols)
        self._function: Callable[..., Array] = compiled(expression, self._names)
        self._values = {name: operation.value(name) for name in self._names}
        self._usual = self._function(*self._values.values())
        terms = operation.terms(equation)
        size = float(np.std(terms[0].value)) * abs(terms[0].factor)
        self._target = SIZE * max(size, FLAT * terms[0].size)
        derivatives = {d.derivative for d in self._model.differentials}
        linear = [term.variable for term in terms if term.variable]
        stored = [name for name in linear if name in derivatives]
        flows = [name for name in linear if name not in derivatives] or linear
        nonlinear = [n for n in self._names if n in self._model.unknown and n not in linear]
        inputs = [n for n in self._names if n in operation.inputs]
        calibrated = [n for n in self._names if n in self._model.parameters and self._model.parameters[n].calibrated]
        self._deep, self._aside = {*nonlinear}, {*inputs, *nonlinear}
        self.added = [*flows[:1], *inputs, *nonlinear]
        fixed = [n for n in self._names if n in self._model.parameters and n not in calibrated]
        self._aside |= {*fixed}
        self.factors = [*(stored or flows), *nonlinear, *inputs, *calibrated, *fixed]
        self._sensor = any(n in self._model.known and n not in operation.inputs for n in self._names)
        self.shapes = shapes(operation, equation)

    def sum(self, symbol: str, shape: Shape) -> Candidate:
        """`symbol` with a multiple of a shape added."""
        unit = self._operation.unit(symbol)
        direction, spread = self._of(symbol, shape.value)
        strength: Table = {"unit": unit, "description": f"what is added to {symbol} {shape.words}", "null": 0.0}
        replacement = f"{symbol} + c" if shape.formula == "1" else f"{symbol} + c*({shape.formula})"
        return self._candidate(symbol, shape, "plus", replacement, {**strength, "spread": spread}, direction)

    def times(self, symbol: str, shape: Shape) -> Candidate:
        """`symbol` times one and a multiple of a shape."""
        direction, spread = self._of(symbol, self._values[symbol] * shape.value)
        most, least = float(shape.value.max()), float(shape.value.min())
        limit = (1.0 - LEFT) / max(most, -least)
        strength: Table = {"unit": "1", "description": f"part by which {symbol} changes {shape.words}", "null": 0.0}
        strength["spread"] = nice(min(spread, 0.5 * limit))
        direction = direction * (float(str(strength["spread"])) / spread)
        if most > 0.0:
            strength["min"] = -nice((1.0 - LEFT) / most, 2)
        if least < 0.0:
            strength["max"] = nice((1.0 - LEFT) / -least, 2)
        return self._candidate(symbol, shape, "times", f"{symbol}*(1 + c*({shape.formula}))", strength, direction)

    def memories(self, symbol: str) -> Iterator[Candidate]:
        """A lag and backlash of a state or input, a dead band of what goes through zero."""
        operation, value = self._operation, self._values[symbol]
        unit, initial = operation.unit(symbol), self._initial(symbol)
        if initial and np.ptp(value) > 0.0:
            unknowns: Tables = {
                "z": {"unit": unit, "description": f"{symbol} as it is seen", "initial": initial},
                "dz": {"unit": f"{unit}/s"},
            }
            differential: tuple[Table, ...] = ({"name": "d", "state": "z", "derivative": "dz"},)
            tau = nice(0.1 * self._model.settling_s)
            delta = late(operation, value, tau) - value
            lagging = Shape(
                "lag", f"{symbol} acts late", "", delta, "lag", unknowns=unknowns, differentials=differential,
                equations=({"name": "lag", "description": "lag of first order", "expr": f"tau*dz - ({symbol} - z)"},),
            )  # fmt: skip
            strength: Table = {"unit": "s", "description": "time constant", "null": 0.0, "spread": tau, "min": 0.0}
            yield self._one_sided(symbol, lagging, "tau", "z", strength)
            yield from self._backlashes(symbol, unknowns, differential)
        if np.abs(value).min() < SMALL * np.abs(value).max():
            d = nice(0.05 * float(np.abs(value).max()))
            band = Shape("dead band", f"{symbol} does nothing near zero", "", -np.clip(value, -d, d), "dead band")
            strength = {"unit": unit, "description": "half width", "null": 0.0, "spread": d, "min": 0.0}
            formula = f"{symbol} - (abs({symbol} + d) - abs({symbol} - d))/2"
            yield self._one_sided(symbol, band, "d", formula, strength)

    def _backlashes(self, symbol: str, unknowns: Tables, differential: tuple[Table, ...]) -> Iterator[Candidate]:
        value, unit, period = self._values[symbol], self._operation.unit(symbol), self._model.period_s
        inside = f"(abs({symbol} - z + b) - abs({symbol} - z - b))/2"
        for share in BANDS:
            b = nice(share * float(np.std(value)))
            delta = np.concatenate([_play(part, b) - part for part in self._operation.split(value)])
            shape = Shape(
                "backlash", f"{symbol} sticks until it has moved by a band", "", delta, "backlash",
                parameters={"tau": scale("s", period, "time to follow")}, unknowns=unknowns,
                equations=({"name": "play", "description": "play", "expr": f"tau*dz - ({symbol} - z - {inside})"},),
                differentials=differential,
            )  # fmt: skip
            strength: Table = {"unit": unit, "description": "half width", "null": 0.0, "spread": b, "min": 0.0}
            yield self._one_sided(symbol, shape, "b", f"{symbol} - {inside}", strength)

    def _one_sided(self, symbol: str, shape: Shape, own: str, formula: str, strength: Table) -> Candidate:
        direction = self._response(symbol, shape.value)
        return self._candidate(symbol, shape, "as", formula, strength, direction, own, one_sided=True)

    def _initial(self, symbol: str) -> list[str]:
        if symbol in self._model.known:
            return [symbol]
        return list(self._model.unknown[symbol].initial_text) if symbol in self._model.unknown else []

    def _of(self, symbol: str, delta: Array) -> tuple[Array, float]:
        """The direction for a strength that would be seen well, and that strength."""
        direction = self._response(symbol, delta)
        size = float(np.sqrt(np.mean(direction**2)))
        spread = nice(self._target / size) if size > 0.0 else 1.0
        return spread * direction, spread

    def _response(self, symbol: str, delta: Array) -> Array:
        """The disturbance of the equation that a change of a name does (K,), to first order."""
        most = float(np.abs(delta).max())
        if most == 0.0:
            return np.zeros(len(self._operation.time))
        small = SMALL * max(float(np.abs(self._values[symbol]).max()), 1e-300) / most
        moved = self._function(*{**self._values, symbol: self._values[symbol] + small * delta}.values())
        return np.asarray(-(moved - self._usual) / small * np.ones(len(self._operation.time)))

    def _candidate(
        self, symbol: str, shape: Shape, how: str, formula: str, strength: Table, direction: Array, own: str = "c",
        *, one_sided: bool = False,
    ) -> Candidate:  # fmt: skip
        equation, component = self._model.equations[self._equation], ""
        component = equation.fault.component if equation.fault else equation.description
        words = shape.words if how == "as" else f"{symbol} changes {shape.words}"
        family = (self._equation, symbol, how, shape.form, shape.family)
        name = "_".join((self._equation, symbol, how, *shape.family.replace("*", " ").split()))
        unknowns, equations = dict(shape.unknowns), list(shape.equations)
        more = bool(unknowns) or shape.form in ("rate", "direction")  # names besides the symbol; a sensor shows one
        if self._sensor and more and formula not in unknowns:
            what = f"{symbol} as it is shown"
            unknowns["seen"] = {"unit": self._operation.unit(symbol), "description": what}
            equations.append({"name": "seen", "description": what, "expr": f"seen - ({formula})"})
            formula = "seen"
        table: Table = {
            "name": "".join(letter for letter in name if letter.isalnum() or letter == "_"),
            "statement": f"{equation.description}: {words}",
            "component": component,
            "source": SOURCE,
            "signature": words,
            "parameter": {own: strength, **shape.parameters},
            "unknown": unknowns,
            "change": [{"where": self._names, "replace": f"{symbol} -> {formula}"}],
            "equation": equations,
            "differential": list(shape.differentials),
        }
        deep = how == "times" and symbol in self._deep
        cost = FORMS.get(shape.form, OTHER) + (FOREIGN if shape.foreign else 0.0)
        cost += DEEP if deep else ASIDE if symbol in self._aside else 0.0
        return Candidate(self._equation, symbol, shape.form, words, table, direction, family, cost, one_sided)


def _play(value: Array, b: float) -> Array:
    """What backlash makes of a course (K,): it follows only once the course has moved by the band."""
    found, z = np.empty_like(value), float(value[0])
    for k, s in enumerate(value.tolist()):
        z = min(max(z, s - b), s + b)
        found[k] = z
    return found
