"""The model: one frozen object for structure, simulation, calibration and generators.

An equation is an expression that equals zero. A differential constraint says that one unknown is the time derivative
of another, the state (Frisk et al. 2012); so every equation is algebraic. A fault enters one equation by replacing one
name: `A_t -> A_t + fA_t` (thesis 4.7).
"""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import sympy as sp

from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.model.bounds import Bounds
from faultline.analysis.model.curves import Curves
from faultline.analysis.model.errors import ModelError


@dataclass(frozen=True, kw_only=True)
class Known:
    """A measured or commanded signal, in `unit`: operating range [min, max], standard deviation `noise` of a sample.

    `zero` is the standard deviation of the zero error that a calibration of the sensor has left, `drift` that of its
    change from one drive to the next; 0 is none. An `added` sensor is one that only instrumented vehicles have. A
    sample that is older than `maximum_age_s` [s] is not used; None stands for five periods. What it shows may be late,
    by a standard deviation of `lag_s` [s]: the sensor's filter, the controller's cycle, the bus; None stands for a
    tenth of a period. A sample that is further than `outlier` from those around it, and does not last, is wrong; None
    leaves that to the noise of what a test predicts. A severe fault may take it below its operating range; tests can
    tell down to `sensor_min`, by default `min`. `label` is its name for people, the description where it is empty;
    they read it in the units `display`, coarse to fine, where there are any.
    """

    unit: str
    description: str
    min: float
    max: float
    noise: float
    zero: float = 0.0
    drift: float = 0.0
    added: bool = False
    maximum_age_s: float | None = None
    lag_s: float | None = None
    outlier: float | None = None
    sensor_min: float | None = None
    label: str = ""
    display: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """A variable that nothing measures.

    Only a state has `initial` values: expressions affine in known signals, of which the first whose signals are all at
    hand is used. `initial_text` is how the file writes them. Below `min` no value is physical, if one is given.
    """

    unit: str
    description: str
    initial: tuple[sp.Expr, ...]
    initial_text: tuple[str, ...]
    min: float | None = None


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A constant. A calibrated one has a `prior`, the standard deviation of its logarithm, or a `spread`, its own.

    The latter is for what may be zero or negative. `drift` is the standard deviation of its change from one drive to
    the next, in parts of its value: of what temperature does, for example.
    """

    unit: str
    description: str
    value: float
    min: float | None
    max: float | None
    prior: float | None
    source: str
    spread: float | None = None
    drift: float = 0.0

    @property
    def calibrated(self) -> bool:
        """Whether a calibration may change it."""
        return self.prior is not None or self.spread is not None


@dataclass(frozen=True, kw_only=True)
class Consequence:
    """A severe fault brings the effect of another `fault` where the signals are within bounds.

    A filter that is all but shut starves the pump, which then delivers less: that is one fault and not two. `sizes` are
    those of the fault that have it, the larger half where none are given.
    """

    fault: str
    where: Bounds
    sizes: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault variable, zero when there is no fault; that of a disturbance has no component.

    It replaces the name `enters` of its equation by `replacement` (`enters_text` is how the file writes that). `sizes`
    are typical ones: fractions of the parameter `relative_to`, or in SI units where that is None. One that is only
    listed, for residuals of another tool, enters nothing and has no sizes. On a J1939 network it is the suspect
    parameter `spn` with the failure mode `fmi` (SAE J1939-73), both or none. `place` is where to find the component.

    A fault may have a second form: the parameter `share_of` changes by the fractions `shares` of its value. A worn pump
    loses a constant flow by a leak, and a share of it by a slipping coupling; either is the same component's. It may
    have a `consequence`.
    """

    name: str
    component: str
    description: str
    enters: str
    replacement: sp.Expr
    enters_text: str
    sizes: tuple[float, ...]
    relative_to: str | None
    spn: int | None = None
    fmi: int | None = None
    place: str = ""
    share_of: str | None = None
    shares: tuple[float, ...] = ()
    consequence: Consequence | None = None

    def absolute(self, size: float, model: "Model") -> float:
        """The value of the fault variable [SI] for one of the `sizes`, with the parameters of `model`."""
        return size if self.relative_to is None else size * model.parameters[self.relative_to].value


@dataclass(frozen=True, kw_only=True)
class Equation:
    """`expression` = 0, without fault; `text` is how the file writes it.

    Where no formula is known there are the `variables` in it, and the expression is an unknown function of these.
    A `disturbance` is what may enter as a fault does and is none of a component: a leak of the hose, for example. It
    takes no part in structure; where it explains what is seen, the fault is unknown and near this equation.
    """

    name: str
    description: str
    text: str
    expression: sp.Expr
    fault: Fault | None
    disturbance: Fault | None = None
    variables: tuple[str, ...] = ()


EDGE = "edge"
"""The mode just after a step."""


@dataclass(frozen=True, kw_only=True)
class Mode:
    """An operating mode: it holds where every signal of `where` is within its bounds (exclusive, None is no bound).

    `description` is what it is, `instruction` what somebody does who brings the system there.
    """

    name: str
    where: Bounds
    description: str = ""
    instruction: str = ""


@dataclass(frozen=True, kw_only=True)
class OperatingModes:
    """How the operating mode follows from the signals: what residuals look like depends on it.

    It is the first of the `steady` ones that holds. The one that has no bounds holds where no other does; there is
    exactly one. For `settle_s` [s] after a signal of `edges` has moved by more than its entry within a quarter of that
    time, the mode is *edge*; no `edges`, no such mode.
    """

    steady: tuple[Mode, ...]
    edges: Mapping[str, float]
    settle_s: float

    @property
    def names(self) -> tuple[str, ...]:
        """The modes, in the order of every list by mode."""
        return EDGE, *(mode.name for mode in self.steady)

    @property
    def listed(self) -> tuple[tuple[int, str], ...]:
        """Index and name of every mode in the order of reports: the edge last."""
        return (*enumerate((mode.name for mode in self.steady), start=1), (0, EDGE))

    @property
    def rest(self) -> Mode:
        """The mode that holds where no other does."""
        return next(mode for mode in self.steady if not mode.where)

    @property
    def bounded(self) -> list[str]:
        """The signals whose levels the mode depends on, in order."""
        return list(dict.fromkeys(name for mode in self.steady for name in mode.where))

    @property
    def signals(self) -> set[str]:
        """The signals that the mode depends on."""
        return {*self.bounded, *self.edges}

    def at(self, values: Mapping[str, npt.NDArray[np.float64]], count: int) -> npt.NDArray[np.int64]:
        """Index into `names` of the mode at `count` instants by levels (count,) alone, as if nothing moved: no edge."""
        found = np.full(count, self.names.index(self.rest.name), dtype=np.int64)
        for number, mode in reversed([*enumerate(self.steady, start=1)]):
            if mode.where:
                within = np.ones(count, dtype=np.bool_)
                for name, (above, below) in mode.where.items():
                    within &= values[name] > (-np.inf if above is None else above)
                    within &= values[name] < (np.inf if below is None else below)
                found[within] = number
        return found


ONE_MODE = OperatingModes(steady=(Mode(name="operation", where={}),), edges={}, settle_s=0.0)
"""The modes of a system that states none."""

WARM_UP_S = 20.0
"""The warm-up of a model that states none [s]."""

PERIODS = 100.0
"""In a warm-up, where a system states no period."""

LAG = 0.1
"""Periods that a signal may be late by, where a system does not say."""

MISSED = 5.0
"""Periods after which a sample is too old, where a system does not say: a frame or two may be lost."""


@dataclass(frozen=True, kw_only=True)
class Differential:
    """d/dt `state` = `derivative`, both unknowns."""

    name: str
    state: str
    derivative: str


@dataclass(frozen=True, kw_only=True)
class Model:
    """A system. The mappings go from names and keep the file's order; symbols are `sympy.Symbol(name)`, no assumptions.

    `provenance` tells what was done to the parameters, oldest first: tables of the commands' own making. After
    `warm_up_s` [s] the slowest state has forgotten where it was assumed to start. Ticks are `period_s` [s] apart.

    A system without equations may be given by `residuals` of another tool instead: known signals that are zero without
    a fault, each with the names of the faults that it is sensitive to (its row of the fault signature matrix), which
    are among the `listed_faults`. `display` has by unit those that people read instead, coarse to fine.
    """

    name: str
    description: str
    source: str
    known: Mapping[str, Known]
    unknown: Mapping[str, Unknown]
    parameters: Mapping[str, Parameter]
    equations: Mapping[str, Equation]
    differentials: tuple[Differential, ...]
    provenance: tuple[Mapping[str, object], ...]
    curves: Curves = dataclasses.field(default_factory=dict)
    residuals: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    listed_faults: Mapping[str, Fault] = dataclasses.field(default_factory=dict)
    modes: OperatingModes = ONE_MODE
    warm_up_s: float = WARM_UP_S
    period_s: float = WARM_UP_S / PERIODS
    bench: BenchSetup | None = None
    display: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)

    @property
    def faults(self) -> dict[str, Fault]:
        """The faults by name, in the order of their equations, or as they are listed."""
        return {e.fault.name: e.fault for e in self.equations.values() if e.fault is not None} | {**self.listed_faults}

    @property
    def disturbances(self) -> dict[str, Fault]:
        """What is no component's fault, by name, in the order of the equations."""
        return {e.disturbance.name: e.disturbance for e in self.equations.values() if e.disturbance is not None}

    @property
    def assumable(self) -> dict[str, Fault]:
        """All that may be assumed to be wrong: the faults, then the disturbances."""
        return self.faults | self.disturbances

    @property
    def without_formula(self) -> list[str]:
        """The equations of which only the variables are known."""
        return [name for name, equation in self.equations.items() if equation.variables]

    @property
    def settling_s(self) -> float:
        """How long the slowest state takes to forget its start [s]; of a model without states, `PERIODS` periods."""
        return self.warm_up_s or PERIODS * self.period_s

    def maximum_age_s(self, signal: str) -> float:
        """The age [s] from which a sample of this known signal is not used."""
        stated = self.known[signal].maximum_age_s
        return MISSED * self.period_s if stated is None else stated

    def lag_s(self, signal: str) -> float:
        """The standard deviation of this known signal's lag [s]."""
        stated = self.known[signal].lag_s
        return LAG * self.period_s if stated is None else stated

    @property
    def sensor_set(self) -> Literal["production", "instrumented"]:
        """What a vehicle must have for it: its own sensors, or added ones besides."""
        return "instrumented" if any(known.added for known in self.known.values()) else "production"

    @property
    def calibrated(self) -> list[str]:
        """The parameters that a calibration may change."""
        return [name for name, p in self.parameters.items() if p.calibrated]

    @property
    def varying(self) -> list[str]:
        """The parameters that differ between vehicles or drives: those calibrated, then others that drift."""
        drifting = [name for name, p in self.parameters.items() if p.drift and not p.calibrated]
        return [*self.calibrated, *drifting]

    def expression(self, equation: str, *, with_fault: bool) -> sp.Expr:
        """The expression of the named equation that equals zero, with what may be wrong in it or without."""
        found = self.equations[equation]
        wrong = [each for each in (found.fault, found.disturbance) if each is not None and with_fault]
        return found.expression.xreplace({sp.Symbol(each.enters): each.replacement for each in wrong})

    def with_parameters(self, values: Mapping[str, float], provenance: Mapping[str, object]) -> "Model":
        """The same model with other parameter values, and with `provenance` added at the end.

        Raises:
            ModelError: a name is not a parameter, or a value is not finite or outside the parameter's bounds.
        """
        parameters = dict(self.parameters)
        for name, value in values.items():
            if name not in parameters:
                raise ModelError(f"{self.name}: {name} is no parameter; those are {', '.join(parameters)}")
            parameters[name] = dataclasses.replace(parameters[name], value=float(value))
            check_bounds(parameters[name], f"{self.name}: parameter.{name}")
        return dataclasses.replace(self, parameters=parameters, provenance=(*self.provenance, dict(provenance)))

    def without_drifts(self) -> "Model":
        """The same model for recordings made one after the other: nothing changes from one to the next."""
        known = {name: dataclasses.replace(each, drift=0.0) for name, each in self.known.items()}
        parameters = {name: dataclasses.replace(each, drift=0.0) for name, each in self.parameters.items()}
        return dataclasses.replace(self, known=known, parameters=parameters)


def check_bounds(parameter: Parameter, place: str) -> None:
    """Raises ModelError for a value that is not finite, outside its bounds, or not positive although it has a prior."""
    lower = -math.inf if parameter.min is None else parameter.min
    upper = math.inf if parameter.max is None else parameter.max
    if lower > upper:
        raise ModelError(f"{place}: min {lower:g} is above max {upper:g} {parameter.unit}; swap them")
    if not math.isfinite(parameter.value) or not lower <= parameter.value <= upper:
        raise ModelError(f"{place}: value {parameter.value:g} is outside [{lower:g}, {upper:g}] {parameter.unit}")
    if parameter.prior is not None and not (parameter.prior > 0 and parameter.value > 0):
        raise ModelError(f"{place}: a prior is the spread of a logarithm; it and the value must be positive")
    if parameter.spread is not None and not (parameter.spread > 0 and parameter.prior is None):
        raise ModelError(f"{place}: a spread must be positive, and there is no prior beside it; give one of the two")
