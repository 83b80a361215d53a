"""What a missing effect may depend on: the operating modes, signals, rates, time, and what has gone through before.

A feature is a course over time, of size one at its largest, times the size of what it changes: a term of the equation,
so that its coefficient is a fraction of that, or a constant.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.discrepancy.find.disturbed import DisturbedRuns
from faultline.analysis.discrepancy.find.quantities import Term, mode_of, quantities, terms_of
from faultline.analysis.model import Model

Array = npt.NDArray[np.float64]

SELDOM = 0.02
"""A mode that fills less of the time than this, or leaves less, says nothing."""

FASTEST = 0.99
"""The quantile of a rate that counts as its largest: a step's corner is no measure."""

FOREIGN = 20.0
"""What a feature must be better, twice in nats, that uses a quantity which the equation does not contain."""


EVERYWHERE = 12.0
"""What an effect in all modes but the ends must be better: where a valve is shut or held open is where models end."""

PRODUCT = 1.0
"""The same for a term that changes with something, beside a constant that does."""


@dataclass(frozen=True)
class Course:
    """`value` (K,) over time, all sections one after the other; `words` follow an amount; `cost` is what it must gain.

    `cost` is twice in nats: of two that explain alike the simpler is meant, and one with the equation's own quantities.
    What `scales` may be a factor of a term as well as something added to it. A rate is added; and a constant factor is
    no missing effect but a parameter.
    """

    words: str
    value: Array
    cost: float
    scales: bool = True


@dataclass(frozen=True)
class Feature:
    """A course times a `term`, as `direction` (K,) of the equation's disturbance for a coefficient of one.

    The coefficient is a fraction: of the term if `relative`, else of its root mean square, a constant.
    """

    course: Course
    term: Term
    relative: bool

    @property
    def cost(self) -> float:
        """What it must gain, twice in nats."""
        return self.course.cost + (PRODUCT if self.relative and self.course.cost > 0.0 else 0.0)

    @property
    def direction(self) -> Array:
        """What the disturbance is for a coefficient of one."""
        constant = self.term.size * np.ones_like(self.course.value)
        return self.course.value * (abs(self.term.factor) * self.term.value if self.relative else constant)


class Operation:
    """Everything that is known of the runs: `values` (K,) by name, all sections one after the other."""

    def __init__(self, runs: DisturbedRuns) -> None:
        self.runs, self.model = runs, runs.system.model
        by_section = [quantities(run) for run in runs.trajectories]
        self._lengths = [len(run.w) for run in runs.trajectories]
        self.inputs = [name for name in runs.system.inputs if name in self.model.known]
        self.values = {name: np.concatenate([part[name] for part in by_section]) for name in by_section[0]}
        self.numbers = {name: p.value for name, p in self.model.parameters.items()} | dict(
            runs.trajectories[0].parameters
        )
        self.time = np.concatenate([section.start_s + section.t for section in runs.sections])
        self._mode = np.concatenate([mode_of(self.model, runs.system, section) for section in runs.sections])

    def terms(self, equation: str) -> list[Term]:
        """The equation's terms, the largest first."""
        return terms_of(self.model, equation, self.values, self.numbers)

    def split(self, value: Array) -> list[Array]:
        """Values (K, ...) by section."""
        return np.split(value, np.cumsum(self._lengths)[:-1])

    def value(self, name: str) -> Array:
        """The course (K,) of any name of the model; of an output it is the measured one."""
        if name in self.values:
            return self.values[name]
        if name in self.numbers:
            return np.full(self.time.shape, self.numbers[name])
        samples = [(section.t, section.samples[name]) for section in self.runs.sections]
        return np.concatenate([np.interp(t, s.t, s.value) for t, s in samples])

    def unit(self, name: str) -> str:
        """The unit of any name of the model."""
        model = self.model
        return (model.known.get(name) or model.unknown.get(name) or model.parameters[name]).unit

    def total(self, name: str) -> Array:
        """A signal's integral (K,) since its recording began."""
        found, before = list[Array](), 0.0
        for section, part in zip(self.runs.sections, self.split(self.values[name]), strict=True):
            before = before if section.number else 0.0
            found.append(before + np.cumsum(part) * section.drive.step_s)
            before = float(found[-1][-1])
        return np.concatenate(found)

    def features(self, equation: str) -> list[Feature]:
        """All features of an equation."""
        terms, courses = self.terms(equation), self._courses(equation)
        derivatives = {d.derivative for d in self.model.differentials}
        stored = [term for term in terms if term.variable in derivatives]
        own = stored or [term for term in terms if term.variable]  # a flow of a balance has an equation of its own
        rest = [Feature(course, term, True) for term in own for course in courses if course.scales]
        return [Feature(course, terms[0], False) for course in courses] + rest

    def _courses(self, equation: str) -> list[Course]:
        own = self.own(equation)
        return [
            Course("always", np.ones(len(self.time)), 0.0, scales=False),
            *self._of_modes(own),
            *(course for name in self._signals() for course in self._of_signal(name, own)),
            *(course for name in self._rates() if name in own for course in self._of_rate(name)),
            Course(f"growing with time, at the end of {np.ptp(self.time):.0f} s", _ramp(self.time), 4.0),
            *(course for name in self._summed(own) for course in self._of_sum(name, own)),
        ]

    def own(self, equation: str) -> set[str]:
        """The equation's quantities, with the states of derivatives and the derivatives of states."""
        found = {symbol.name for symbol in self.model.equations[equation].expression.free_symbols}
        for d in self.model.differentials:
            if found & {d.state, d.derivative}:
                found |= {d.state, d.derivative}
        return found

    def _signals(self) -> list[str]:
        states = [d.state for d in self.model.differentials]
        return [*self.inputs, *states]

    def _rates(self) -> list[str]:
        return [d.derivative for d in self.model.differentials]

    def _summed(self, own: set[str]) -> list[str]:
        """The inputs, and the equation's own flows: unknowns that are no state and no derivative."""
        no_flows = {name for d in self.model.differentials for name in (d.state, d.derivative)}
        flows = [name for name in self.model.unknown if name in own - no_flows and name in self.values]
        return [*self.inputs, *flows]

    def _of_modes(self, own: set[str]) -> list[Course]:
        rule, found = self.model.modes, []
        rest, first = rule.names.index(rule.rest.name), rule.bounded[0] if rule.bounded else ""
        for k, name in enumerate(rule.names):
            there = self._mode == k
            if len(rule.steady) > 1 and SELDOM < np.mean(there) < 1.0 - SELDOM:
                found.append(
                    Course(
                        f"only at {name} {first}",
                        there * 1.0,
                        _cost(EVERYWHERE if k == rest else 2.0, first, own),
                    )
                )
        return found

    def _of_signal(self, name: str, own: set[str]) -> list[Course]:
        u, words = self.values[name], _named(self.model, name)
        if np.ptp(u) <= 0.0:
            return []
        centred = (u - u.mean()) / np.ptp(u)
        square = u * u / float(np.max(u * u))
        usual = float(np.median(u))
        parts = (("largest", np.maximum(u - usual, 0.0)), ("least", np.maximum(usual - u, 0.0)))
        beyond = [(end, part / float(part.max())) for end, part in parts if part.max() > 0.0]
        return [
            Course(f"from the lowest to the highest {words}", centred, _cost(4.0, name, own)),
            Course(f"with the square of {words}, at its largest", square, _cost(8.0, name, own)),
            *(Course(f"beyond the usual {words}, at its {end}", value, _cost(6.0, name, own)) for end, value in beyond),
        ]

    def _of_rate(self, name: str) -> list[Course]:
        d, state = self.values[name], next(x.state for x in self.model.differentials if x.derivative == name)
        words, size = _named(self.model, state), float(np.quantile(np.abs(d), FASTEST))
        if size <= 0.0:
            return []
        moving = np.asarray(np.abs(d) / size, dtype=np.float64)
        return [
            Course(f"with the rate of {words}, at its fastest rise", d / size, 4.0, scales=False),
            Course(f"while moving either way: {words}, at its fastest", moving, 6.0, scales=False),
            Course(f"while rising: {words}", np.where(d > 0.0, 1.0, 0.0), 6.0, scales=False),
        ]

    def _of_sum(self, name: str, own: set[str]) -> list[Course]:
        joined = self.total(name)
        if np.ptp(joined) <= 0.0:
            return []
        words = f"growing with the sum of {_named(self.model, name)}, at its end"
        return [Course(words, _ramp(joined), _cost(5.0, name, own))]


def _named(model: Model, name: str) -> str:
    known: Mapping[str, object] = {**model.known, **model.unknown}
    text = str(getattr(known[name], "description", "")).split(",")[0]
    return f"{text} ({name})" if text else name


def _ramp(value: Array) -> Array:
    """From nought to one."""
    return np.asarray((value - value.min()) / max(float(np.ptp(value)), 1e-300))


def _cost(base: float, name: str, own: set[str]) -> float:
    return base if name in own else base + FOREIGN
