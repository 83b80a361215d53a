"""What is wrong with a model that loads: units that do not fit, parts that nothing uses, faults that nothing detects.

An *error* makes the model mean something else than it says; a *warning* is a part that has no effect or gives no test.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import sympy as sp

from faultline.analysis.model.check import check_model
from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.file import load_model
from faultline.analysis.model.model import Model
from faultline.analysis.model.units import SECOND, Dimension, Dimensions, MismatchError, parse_unit
from faultline.analysis.structure.decomposition import dulmage_mendelsohn
from faultline.analysis.structure.matching import Matching
from faultline.analysis.structure.matrix import as_model, load_structure
from faultline.analysis.structure.placement import MANY_POSITIONS, place_sensors
from faultline.analysis.structure.structure import Structure, structure_of
from faultline.analysis.structure.supports import Support, Test, find_tests


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong: where, and what with its remedy."""

    severity: Literal["error", "warning"]
    place: str
    message: str


def lint(model: Model, tests: Sequence[Support] | None = None) -> list[Finding]:
    """All findings of a model: its parts, its units, and the structure they make; errors first.

    `tests` are those of the model; whether faults are in none that can be run is left open where none are given. A
    model made in Python may break what a file is checked for when it loads; the first such thing is then the only
    finding.
    """
    undeclared = list(_undeclared(model))
    try:
        check_model(model, [*model.equations], model.name)
    except ModelError as error:
        return [*undeclared, Finding("error", model.name, str(error).removeprefix(f"{model.name}: "))]
    if undeclared:
        return undeclared
    elsewhere = {f"known.{name}" for name in _signals_elsewhere(model)}
    structural = [] if model.residuals else lint_structure(structure_of(model))
    structural = [finding for finding in structural if finding.place not in elsewhere]
    found = [
        *_empty(model),
        *unit_findings(model),
        *_unused_parts(model),
        *_half_changed(model),
        *structural,
        *_not_run(model, find_tests(model) if tests is None else tests),
    ]
    return sorted(found, key=lambda finding: finding.severity)


def sound_model(path: str | Path, *, formulas: bool = True) -> Model:
    """The model in a file, or the shipped one of that name, for commands that compute with it.

    A structural model (.json) is a model without formulas.

    Raises:
        ModelError: there is none, it is not valid, or it has a finding that is an error; it needs `formulas`, and an
            equation has none.
    """
    file = Path(path)
    model = as_model(load_structure(str(path)), file.stem) if file.suffix == ".json" else load_model(path)
    if formulas and model.without_formula:
        raise ModelError(
            f"{path}: equation.{model.without_formula[0]}: has no formula, which this needs; write `expr` "
            "(`structure`, `train`, and with networks `tune` and `export` do without)"
        )
    for finding in lint(model, tests=()):  # which tests there are makes no error
        if finding.severity == "error":
            raise ModelError(f"{path}: {finding.place}: {finding.message}")
    return model


def lint_structure(structure: Structure) -> list[Finding]:
    """The findings that need no formulas: unused variables, constraints without effect, missing redundancy."""
    return [
        Finding("warning", place, message)
        for part in (_unused_variables, _constraints, _under_determined, _without_test)
        for place, message in part(structure)
    ]


def _undeclared(model: Model) -> Iterator[Finding]:
    declared = {*model.known, *model.unknown, *model.parameters}
    for name, equation in model.equations.items():
        strange = sorted({symbol.name for symbol in equation.expression.free_symbols} - declared)
        if strange:
            problem = f"{_some(strange)} declared neither as known, unknown nor parameter"
            yield Finding("error", f"equation.{name}", f"{problem}; declare what is meant, or correct the formula")


def _empty(model: Model) -> Iterator[Finding]:
    """Equations that are about nothing: always true, or never."""
    variables = {*model.known, *model.unknown}
    for name, equation in model.equations.items():
        if not variables & {symbol.name for symbol in equation.expression.free_symbols}:
            problem = f"`{equation.text}` = 0 has neither a known signal nor an unknown in it"
            yield Finding("error", f"equation.{name}", f"{problem}; remove it, or write what it is about")


def _not_run(model: Model, tests: Sequence[Support]) -> Iterator[Finding]:
    """Faults that some test sees, but none of those that can be run."""
    run = {fault for test in tests if isinstance(test, Test) for fault in test.faults}
    if tests and not run:
        problem = f"none can be run; {tests[0].name}: {tests[0].obstacle}"
        yield Finding("warning", "test", f"{problem} (--tests says it of every test)")
        return
    for fault in model.faults:
        seeing = next((test for test in tests if fault in test.faults), None)
        if seeing and fault not in run:
            problem = f"no test that sees it can be run; {seeing.name}: {seeing.obstacle}"
            yield Finding("warning", f"fault.{fault}", problem)


def _half_changed(model: Model) -> Iterator[Finding]:
    """Find faults that change a parameter in one equation, where others have it too."""
    having: dict[str, list[str]] = {name: [] for name in model.parameters}
    for name, equation in model.equations.items():
        for symbol in equation.expression.free_symbols:
            having.get(symbol.name, []).append(name)
    for name, equation in model.equations.items():
        fault = equation.fault
        others = [] if fault is None else [other for other in having.get(fault.enters, []) if other != name]
        if fault is not None and others:
            problem = f"changes {fault.enters} in {name} only, and {_some(others)} has it too"
            remedy = "give what the fault changes an equation and an unknown of its own"
            yield Finding("warning", f"fault.{fault.name}", f"{problem}; {remedy}")


def _unused_parts(model: Model) -> Iterator[Finding]:
    formulas = [model.expression(name, with_fault=True) for name in model.equations]
    formulas += [expression for unknown in model.unknown.values() for expression in unknown.initial]
    used = {symbol.name for formula in formulas for symbol in formula.free_symbols}
    used |= {each.relative_to for each in model.assumable.values() if each.relative_to is not None}
    for name, parameter in model.parameters.items():
        if name not in used:
            yield Finding("warning", f"parameter.{name}", "is in no formula; use it or remove it")
        if not parameter.source.strip():
            yield Finding("warning", f"parameter.{name}.source", "is empty; say where the value comes from")


def _signals_elsewhere(model: Model) -> set[str]:
    """Known signals that something else than an equation uses: initial values, operating modes."""
    initial = [expression for unknown in model.unknown.values() for expression in unknown.initial]
    found = {symbol.name for expression in initial for symbol in expression.free_symbols}
    return found | model.modes.signals


def _unused_variables(structure: Structure) -> Iterator[tuple[str, str]]:
    for kind, names, used in (
        ("unknown", structure.unknowns, structure.unknowns_in(structure.equations)),
        ("known", structure.known, structure.known_in(structure.equations)),
    ):
        for name in names:
            if name not in used:
                yield f"{kind}.{name}", "is in no equation; use it or remove it"


def _constraints(structure: Structure) -> Iterator[tuple[str, str]]:
    """Differential constraints without effect, and names that read like a derivative but have no constraint."""
    elsewhere = set(structure.unknowns_in(name for name in structure.equations if name not in structure.differentials))
    for name, d in structure.differentials.items():
        if d.derivative not in elsewhere:
            problem = f"{d.derivative} is in no other equation, so nothing says how {d.state} changes"
            yield f"differential.{name}", f"{problem}; add the equation for {d.derivative}, or remove the constraint"
        if d.state not in elsewhere:
            yield f"differential.{name}", f"{d.state} is in no other equation, so its value has no effect; remove both"
    joined = {name for d in structure.differentials.values() for name in (d.state, d.derivative)}
    for name in structure.unknowns:
        if name.startswith("d") and name[1:] in structure.unknowns and name not in joined:
            problem = f"no differential constraint makes it the derivative of {name[1:]}"
            yield f"unknown.{name}", f"{problem}; add one, or give it a name that does not read like a derivative"


def _under_determined(structure: Structure) -> Iterator[tuple[str, str]]:
    under = dulmage_mendelsohn(structure).under
    unknowns = [name for name in under.unknowns if name in structure.unknowns_in(structure.equations)]
    if unknowns:
        missing = len(unknowns) - len(under.equations)
        problem = f"{_some(unknowns)} cannot be computed: the equations that have them are {missing} too few"
        yield "unknown", f"{problem}; add equations, or sensors of them"


def _without_test(structure: Structure) -> Iterator[tuple[str, str]]:
    """Faults in no redundant part, and the sensors that would change that."""
    parts = dulmage_mendelsohn(structure)
    if not parts.over.equations:
        # A sensor is redundant where what it measures can be computed already: in M0, as M+ is empty.
        just = {name for component in parts.just for name in component.unknowns}
        helpful = [name for name in structure.unknowns if name in just]
        remedy = f"a sensor of {_some(helpful, 'or')} would give some" if helpful else _several_sensors(structure)
        yield "equation", f"no redundancy, so no test and no detectable fault; {remedy}"
        return
    if not structure.faults:
        yield "fault", "there is none, so no test is sensitive to a fault; let faults enter the equations they change"
    over = set(structure.rows(parts.over.equations))
    hidden = [fault for fault in structure.faults if structure.fault_rows[fault] not in over]
    if not hidden:
        return
    matching, under = Matching(structure.unknown_rows), {*parts.under.unknowns}
    with_sensor = {x: {*matching.over_determined_by(i)} for i, x in enumerate(structure.unknowns) if x not in under}
    for fault in hidden:
        row = structure.fault_rows[fault]
        helpful = [x for x, rows in with_sensor.items() if row in rows]
        remedy = f"a sensor of {_some(helpful, 'or')} would give one" if helpful else "no single sensor would give one"
        yield f"fault.{fault}", f"is not detectable: no test contains {structure.equations[row]}; {remedy}"


def _several_sensors(structure: Structure) -> str:
    """What would make faults detectable where no single sensor gives redundancy."""
    derivatives = {d.derivative for d in structure.differentials.values()}
    positions = [name for name in structure.unknowns if name not in derivatives]
    if not structure.faults or len(positions) > MANY_POSITIONS:
        return "add equations or several sensors"
    sets = place_sensors(structure, positions, "mixed", "detectability")
    return f"sensors of {_some(sets[0].sensors)} together would give some" if sets[0].sensors else "add equations"


def _some(names: Sequence[str], last: str = "and") -> str:
    """A list in words, shortened after eight."""
    shown = [*names] if len(names) <= 8 else [*names[:7], f"{len(names) - 7} more"]
    return f" {last} ".join([", ".join(shown[:-1]), shown[-1]]) if len(shown) > 1 else shown[0]


def unit_findings(model: Model) -> Iterator[Finding]:
    """Units that cannot be read or are not coherent, and formulas whose units do not fit."""
    units = [("known", name, known.unit) for name, known in model.known.items()]
    units += [("unknown", name, unknown.unit) for name, unknown in model.unknown.items()]
    units += [("parameter", name, parameter.unit) for name, parameter in model.parameters.items()]
    dimensions: dict[str, Dimension] = {}
    written: dict[Dimension, str] = {}  # the model's own words for a dimension
    for kind, name, unit in units:
        if not unit:  # of a model without formulas
            continue
        try:
            size, dimensions[name] = parse_unit(unit)
        except ValueError as error:
            yield Finding("warning", f"{kind}.{name}.unit", f"{error}; what has {name} in it is not checked")
            continue
        if size == 1:
            written.setdefault(dimensions[name], unit)
        else:
            problem = f"1 {unit} is {float(size):g} of the SI unit, and formulas convert nothing"
            yield Finding("error", f"{kind}.{name}.unit", f"{problem}; give {name} in SI units")
    for place, left, right in _balances(model):
        try:
            Dimensions(dimensions, written).agree([left, right])
        except MismatchError as error:
            yield Finding("error", place, f"{error}; correct the formula or a unit")


def _balances(model: Model) -> Iterator[tuple[str, sp.Expr, sp.Expr]]:
    """Everything that must have equal units, with its place."""
    for name, equation in model.equations.items():
        if equation.variables:  # what is in it has any unit
            continue
        yield f"equation.{name}", equation.expression, sp.S.Zero
        if equation.fault is not None:
            yield f"equation.{name}.fault.enters", sp.Symbol(equation.fault.enters), equation.fault.replacement
    for name, unknown in model.unknown.items():
        for k, expression in enumerate(unknown.initial):
            yield f"unknown.{name}.initial[{k}]", sp.Symbol(name), expression
    for d in model.differentials:
        yield f"differential.{d.name}", sp.Symbol(d.state), sp.Symbol(d.derivative) * SECOND
