"""Builds the program of a residual from its computation sequence: solves, differentiates and integrates, in order."""

import keyword
import re
from collections.abc import Mapping, Sequence

import sympy as sp

from faultline.analysis.codegen.block import Block, independent, names_in, state_network
from faultline.analysis.codegen.elimination import Solved
from faultline.analysis.codegen.identifiers import RESERVED, Names, file_scope, words_in
from faultline.analysis.codegen.implicit import step_lines
from faultline.analysis.codegen.loops import solve_component
from faultline.analysis.codegen.program import Constant, Input, Line, Program, State, alive
from faultline.analysis.codegen.sequence import Component, ComputationSequence
from faultline.analysis.codegen.text import Writer, number
from faultline.analysis.model import Differential, Model
from faultline.service.core.errors import InputError

LISTED = 5
"""Equations of a loop that a comment lists; of more it says how many they are."""

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def residual_program(
    model: Model, sequence: ComputationSequence, *, name: str, period: float | None = None, filter_s: float = 0.0
) -> Program:
    """The program of a residual of a fault-free model, for samples every `period` [s], else the model's.

    Integrated states advance by the implicit step of the ONNX graph and start from the sensors. Derivatives are
    backward difference quotients, behind a first-order low-pass of time constant `filter_s` [s] if it is not zero. The
    residual is that of the equation as it is written; if it is a sensor's, in the unit of that and measured less
    predicted. It is NaN where a division by a signal has no result (the efficiency of a pump that stands still), and
    in the first step of a derivative. Causality says nothing of stability: a mixed sequence may run away, and a
    constraint as the residual in integral form drifts. `name` begins the identifiers of the code.

    Raises:
        InputError: a component has no solution that is certain to be the only one, or does not have the form that the
            implicit step solves; a state has no initial value from the signals at hand; `name` is no identifier.
    """
    if not _IDENTIFIER.fullmatch(name) or name in RESERVED or keyword.iskeyword(name):
        raise InputError(f"name {name!r}: is no identifier of Python and C; use letters, digits and _ as in uds_t02")
    if not sequence.known:
        raise InputError(
            f"{model.name}: {', '.join(sequence.equations)} contain no known signal; nothing can be tested"
        )
    period = model.period_s if period is None else period
    if not period > 0 or not filter_s >= 0:
        raise InputError(
            f"period {period:g} s and filter {filter_s:g} s: give a positive period and no negative filter"
        )
    return _Builder(model, sequence, name, period, filter_s).program()


class _Builder:
    def __init__(self, model: Model, sequence: ComputationSequence, name: str, period: float, filter_s: float) -> None:
        self._model, self._sequence = model, sequence
        self._name, self._period, self._filter_s = name, period, filter_s
        self._place = f"{model.name}: residual {sequence.residual} of {', '.join(sequence.equations)}"
        self._fresh = Names()
        for taken in file_scope(name):
            self._fresh.fresh(taken)
        self._numbers = {key: parameter.value for key, parameter in model.parameters.items()}
        self._identifiers = {key: self._fresh.fresh(key) for key in [*model.known, *model.unknown, *model.parameters]}
        self._write = Writer(self._identifiers, self._numbers, self._place)
        self._constraints = {d.name: d for d in model.differentials}
        self._lines: list[Line] = []
        self._states: list[State] = []

    def program(self) -> Program:
        for component in self._sequence.components:
            match component.kind:
                case "algebraic":
                    self._solve(component)
                case "derivative":
                    self._differentiate(self._constraints[component.equations[0]])
                case "integral" if not component.inside:
                    self._sum_up(self._constraints[component.equations[0]])
                case "integral":
                    self._advance(component)
                case "mixed":
                    self._solve_discretised(component)
        residual, unit = self._residual()
        lines = alive(self._lines, [residual, *(state.next for state in self._states)])
        used = set().union(words_in(residual), *(words_in(line.text) for line in lines))
        return Program(
            name=self._name,
            notes=tuple(self._notes()),
            unit=unit,
            inputs=tuple(Input(self._identifiers[k], k, self._note(k)) for k in self._sequence.known),
            constants=tuple(
                Constant(self._identifiers[k], p.value, self._note(k))
                for k, p in self._model.parameters.items()
                if self._identifiers[k] in used
            ),
            states=tuple(state for state in self._states if state.name in used),
            lines=tuple(lines),
            residual=residual,
        )

    def _notes(self) -> list[str]:
        sequence = self._sequence
        notes = [
            f"Residual generator of the model {self._model.name}, for samples every {self._period:g} s.",
            f"Equations: {', '.join(sequence.equations)}. Residual equation: {sequence.residual}.",
            f"Causality: {sequence.causality}.",
        ]
        if self._filter_s:
            notes.append(f"Derivatives pass a first-order low-pass of {self._filter_s:g} s.")
        return [*notes, "Where something needed is not known (NaN) the residual is NaN; it starts again by itself."]

    def _note(self, key: str) -> str:
        """Unit and description of a name of the model."""
        found = self._model.known.get(key) or self._model.unknown.get(key) or self._model.parameters[key]
        return f"[{found.unit}] {found.description}".strip()

    def _expression(self, equation: str) -> sp.Expr:
        return self._model.expression(equation, with_fault=False)

    def _describe(self, equation: str, variable: str) -> str:
        if equation in self._constraints:
            return f"{equation} for {variable}"
        described = self._model.equations[equation].description
        return f"{equation} for {variable}{': ' if described else ''}{described}"

    def _carry(self, variable: str, following: str) -> str:
        """A state that keeps a variable's value; gives the local that has the old one, NaN at first."""
        name = self._fresh.fresh(f"{variable}_last")
        self._states.append(State(name, following, f"{self._note(variable)}, at the last step"))
        return name

    def _started(self, state: str, following: str) -> str:
        """As `_carry`, but where it is not known it starts from the sensors."""
        carried = self._carry(state, following)
        old = self._fresh.fresh(f"{state}_old")
        self._lines.append(
            Line(old, f"kept({carried}, {self._initial(state)})", f"{state} at the last step, or its start")
        )
        return old

    def _initial(self, state: str) -> str:
        """The first of the state's initial expressions that needs no signal from outside."""
        for expression in self._model.unknown[state].initial:
            signals = [symbol.name for symbol in expression.free_symbols if symbol.name in self._model.known]
            if set(signals) <= set(self._sequence.known):
                return self._write(expression)
        raise InputError(
            f"{self._model.name}: unknown.{state}.initial: no expression uses only {', '.join(self._sequence.known)}; "
            "add one, a parameter alone will do"
        )

    def _solutions(self, component: Component, extra: Mapping[str, sp.Expr] | None = None) -> list[Solved]:
        extra = extra or {}
        expressions = {name: extra[name] if name in extra else self._expression(name) for name in component.equations}
        found = solve_component(expressions, component.variables, self._numbers, self._place, self._fresh.fresh)
        for solved in found:
            self._identifiers.setdefault(solved.variable, solved.variable)
            if solved.number is not None:
                self._numbers[solved.variable] = solved.number
        return found

    def _assign(self, found: Sequence[Solved], loop: Sequence[str] = ()) -> None:
        around = ""
        if len(loop) > 1:
            around = f" (loop of {', '.join(loop) if len(loop) <= LISTED else f'{len(loop)} equations'})"
        for solved in found:
            note = solved.part or self._describe(solved.equation, solved.variable) + around
            self._lines.append(Line(self._identifiers[solved.variable], self._write(solved.value), note))

    def _solve(self, component: Component) -> None:
        self._assign(self._solutions(component), component.equations)

    def _differentiate(self, constraint: Differential) -> None:
        now = self._identifiers[constraint.state]
        quotient = f"({now} - {self._carry(constraint.state, now)})/{number(self._period)}"
        self._smooth(self._identifiers[constraint.derivative], constraint, quotient)

    def _smooth(self, target: str, constraint: Differential, quotient: str) -> None:
        note = f"{constraint.name}: difference quotient of {constraint.state}"
        if self._filter_s:
            share = number(self._period / (self._period + self._filter_s))
            quotient = f"low_pass({self._carry(constraint.derivative, target)}, {quotient}, {share})"
            note += f", low-pass of {self._filter_s:g} s"
        self._lines.append(Line(target, quotient, note))

    def _sum_up(self, constraint: Differential) -> None:
        """Integrates a derivative that is computed from other things than its state."""
        now, rate = self._identifiers[constraint.state], self._identifiers[constraint.derivative]
        text = f"{self._started(constraint.state, now)} + {number(self._period)}*{rate}"
        self._lines.append(Line(now, text, f"{constraint.name}: {constraint.state} integrated"))

    def _solve_discretised(self, component: Component) -> None:
        """A loop that differentiates within: backward Euler makes its constraints algebraic."""
        discrete: dict[str, sp.Expr] = {}
        for equation in component.equations:
            if equation in self._constraints:
                d = self._constraints[equation]
                old = sp.Symbol(self._started(d.state, self._identifiers[d.state]))
                self._identifiers[old.name] = old.name
                rate, state = sp.Symbol(d.derivative), sp.Symbol(d.state)
                discrete[equation] = rate - (state - old) / sp.Float(self._period)
        self._assign(self._solutions(component, discrete), component.equations)

    def _advance(self, component: Component) -> None:
        """The implicit step of the states, then what follows from them."""
        constraints = [self._constraints[name] for name in component.equations if name in self._constraints]
        explicit = [solved for inner in component.inside for solved in self._solutions(inner)]
        new = [self._identifiers[d.state] for d in constraints]
        last = [self._started(d.state, now) for d, now in zip(constraints, new, strict=True)]
        # What follows from the inputs alone may be any function of them, if it is an input itself. The parts of a large
        # loop's elimination mostly do, and would make the network's formulas long.
        given = independent(explicit, {d.state for d in constraints})
        fixed = given if any(solved.part for solved in given) else []
        try:
            block = self._block(constraints, [solved for solved in explicit if solved not in fixed])
        except InputError:
            if fixed or not given:
                raise
            fixed = given
            block = self._block(constraints, [solved for solved in explicit if solved not in fixed])
        self._assign(fixed)
        inputs = [self._identifiers[key] for key in block.signals] + self._formulas(block, last)
        self._lines += step_lines(
            block.values, self._period, self._fresh, last=last, new=new, signals=inputs, orifices=block.orifices
        )
        self._assign([solved for solved in explicit if solved not in fixed])

    def _formulas(self, block: Block, last: Sequence[str]) -> list[str]:
        """The identifiers of a network's formulas, of which the lines are written."""
        self._identifiers |= {symbol.name: name for symbol, name in zip(block.last, last, strict=True)}
        names = [self._fresh.fresh(f"formula{k}") for k in range(1, len(block.formulas) + 1)]
        for name, formula in zip(names, block.formulas.values(), strict=True):
            self._lines.append(Line(name, self._write(formula), "a coefficient, with the states of the last step"))
        return names

    def _block(self, constraints: Sequence[Differential], explicit: Sequence[Solved]) -> Block:
        """The network of the states."""
        parts = {sp.Symbol(key): value for key, value in self._numbers.items() if key not in self._model.parameters}
        explicit = [solved._replace(value=solved.value.xreplace(parts)) for solved in explicit]
        own = {d.state for d in constraints} | {solved.variable for solved in explicit}
        entering = {d.derivative for d in constraints}.union(*(names_in(solved.value) for solved in explicit))
        signals = [key for key in self._identifiers if key in entering and key not in own and key not in self._numbers]
        return state_network(self._model, constraints, explicit, signals, self._place)

    def _residual(self) -> tuple[str, str]:
        """The residual's text and unit."""
        name = self._sequence.residual
        if name in self._constraints:
            return self._compared(self._constraints[name])
        expression = self._expression(name)
        signals = [symbol for symbol in expression.free_symbols if symbol.name in self._model.known]
        slope = sp.diff(expression, signals[0]) if len(signals) == 1 else sp.Integer(0)
        if slope.is_number and not slope.is_zero:
            return self._write(sp.expand(expression / slope)), self._model.known[signals[0].name].unit
        return self._write(expression), f"unit of {name}"

    def _compared(self, constraint: Differential) -> tuple[str, str]:
        """A differential constraint as the residual, with its state and its derivative computed from the rest."""
        state, rate = self._identifiers[constraint.state], self._identifiers[constraint.derivative]
        unit = self._model.unknown[constraint.state].unit
        if self._sequence.form == "derivative":
            found = self._fresh.fresh(f"{constraint.derivative}_found")
            quotient = f"({state} - {self._carry(constraint.state, state)})/{number(self._period)}"
            self._smooth(found, constraint, quotient)
            return f"{found} - {rate}", f"{unit}/s"
        summed = self._fresh.fresh(f"{constraint.state}_integrated")
        text = f"{self._started(constraint.state, summed)} + {number(self._period)}*{rate}"
        self._lines.append(Line(summed, text, f"{constraint.name}: {constraint.derivative} integrated, open loop"))
        return f"{state} - {summed}", unit
