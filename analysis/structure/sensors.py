"""Sensors added to a model or its structure and taken from it, by name."""

import dataclasses
import math
from collections.abc import Collection, Iterable, Sequence

import sympy as sp

from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.model import ONE_MODE, Equation, Fault, Known, Model, OperatingModes, Unknown
from faultline.analysis.structure.structure import Structure, structure_of


def with_other_sensors(model: Model, dropped: Iterable[str], measured: Sequence[str]) -> Model:
    """The model without the sensors of some known signals, and with a sensor of every named unknown, which may fail.

    The sensor of p is `y_p - p` with the fault `p -> p + fy_p`; names as in `add_sensors`. Nothing is known yet of its
    range and noise, so the result is to analyse, not to run.

    Raises:
        ModelError: a signal has no sensor, or a name is not an unknown of the model.
    """
    left = drop_sensors(structure_of(model), dropped)
    complete = add_sensors(left, measured, faulty=True)
    names = complete.equations[len(left.equations) :]
    faults = complete.faults[len(left.faults) :]
    sensors = {
        name: Equation(
            name=name,
            description=f"sensor of {unknown}",
            text=f"{name} - {unknown}",
            expression=sp.Symbol(name) - sp.Symbol(unknown),
            fault=Fault(
                name=fault,
                component=f"sensor of {unknown}",
                description="",
                enters=unknown,
                replacement=sp.Symbol(unknown) + sp.Symbol(fault),
                enters_text=f"{unknown} -> {unknown} + {fault}",
                sizes=(),
                relative_to=None,
            ),
        )
        for name, fault, unknown in zip(names, faults, measured, strict=True)
    }
    new = {
        name: Known(unit=model.unknown[unknown].unit, description="", min=-math.inf, max=math.inf, noise=math.nan)
        for name, unknown in zip(names, measured, strict=True)
    }
    return dataclasses.replace(
        model,
        known={name: known for name, known in model.known.items() if name in left.known} | new,
        equations={name: _known_by(e, left.known) for name, e in model.equations.items() if name in left.equations}
        | sensors,
        unknown={name: _started(unknown, left.known, model) for name, unknown in model.unknown.items()},
        modes=_modes(model.modes, left.known),
        bench=None,
    )


def _known_by(equation: Equation, known: Collection[str]) -> Equation:
    """Without the consequence of its fault where that shows at signals that are not known."""
    fault = equation.fault
    if fault is None or fault.consequence is None or fault.consequence.where.keys() <= set(known):
        return equation
    return dataclasses.replace(equation, fault=dataclasses.replace(fault, consequence=None))


def _started(unknown: Unknown, known: Sequence[str], model: Model) -> Unknown:
    """The unknown without initial values that need signals which are gone; a state without any left starts at zero."""
    gone = {sp.Symbol(name) for name in model.known if name not in known}
    kept = [k for k, expression in enumerate(unknown.initial) if not expression.free_symbols & gone]
    if len(kept) == len(unknown.initial):
        return unknown
    initial, text = tuple(unknown.initial[k] for k in kept), tuple(unknown.initial_text[k] for k in kept)
    return dataclasses.replace(unknown, initial=initial or (sp.S.Zero,), initial_text=text or ("0",))


def _modes(modes: OperatingModes, known: Sequence[str]) -> OperatingModes:
    if not {*modes.bounded} <= {*known}:
        return ONE_MODE
    return dataclasses.replace(modes, edges={name: size for name, size in modes.edges.items() if name in known})


def add_sensors(structure: Structure, measured: Sequence[str], faulty: bool = False) -> Structure:
    """The structure with a sensor of every named unknown; a name that comes twice gets two.

    The sensor of p is the equation `y_p` with the known signal `y_p` and, if `faulty`, the fault `fy_p`; where one of
    these names is taken already, both end in the first of _2, _3 ... that is not.

    Raises:
        ModelError: a name is not an unknown of the structure.
    """
    check_unknowns(structure, measured)
    taken = {*structure.equations, *structure.unknowns, *structure.known, *structure.faults}
    names: list[str] = []
    for unknown in measured:
        name, number = f"y_{unknown}", 1
        while name in taken or f"f{name}" in taken:
            number += 1
            name = f"y_{unknown}_{number}"
        taken |= {name, f"f{name}"}
        names.append(name)
    position = {name: x for x, name in enumerate(structure.unknowns)}
    rows = range(len(structure.equations), len(structure.equations) + len(names))
    faults = {f"f{name}": row for name, row in zip(names, rows, strict=True)} if faulty else {}
    return dataclasses.replace(
        structure,
        equations=(*structure.equations, *names),
        known=(*structure.known, *names),
        faults=(*structure.faults, *faults),
        unknown_rows=(*structure.unknown_rows, *(1 << position[unknown] for unknown in measured)),
        known_rows=(*structure.known_rows, *(1 << len(structure.known) + k for k in range(len(names)))),
        fault_rows={**structure.fault_rows, **faults},
    )


def drop_sensors(structure: Structure, signals: Iterable[str]) -> Structure:
    """The structure without the sensors of these known signals: without their equations and the faults of these.

    A sensor equation contains one unknown and one known signal. The signal goes too unless other equations contain it.

    Raises:
        ModelError: a signal has no sensor equation.
    """
    wanted = list(dict.fromkeys(signals))
    sensors = sensor_equations(structure)
    for signal in wanted:
        if signal not in sensors.values():
            there = ", ".join(dict.fromkeys(sensors.values())) or "none"
            raise ModelError(f"{signal}: no known signal with a sensor equation; those are {there}")
    dropped = {equation for equation, signal in sensors.items() if signal in wanted}
    rows = [row for row, name in enumerate(structure.equations) if name not in dropped]
    used = 0
    for row in rows:
        used |= structure.known_rows[row]
    known = [z for z, name in enumerate(structure.known) if name not in wanted or used >> z & 1]
    left = [structure.equations[row] for row in rows]
    place = {name: row for row, name in enumerate(left)}
    fault_rows = {fault: structure.equations[row] for fault, row in structure.fault_rows.items()}
    return dataclasses.replace(
        structure,
        equations=tuple(left),
        known=tuple(structure.known[z] for z in known),
        faults=tuple(fault for fault in structure.faults if fault_rows[fault] in place),
        unknown_rows=tuple(structure.unknown_rows[row] for row in rows),
        known_rows=tuple(
            sum(1 << new for new, z in enumerate(known) if structure.known_rows[row] >> z & 1) for row in rows
        ),
        fault_rows={fault: place[name] for fault, name in fault_rows.items() if name in place},
    )


def sensor_equations(structure: Structure) -> dict[str, str]:
    """The equations that contain one unknown and one known signal, each with its signal."""
    return {
        name: structure.known_in([name])[0]
        for row, name in enumerate(structure.equations)
        if structure.unknown_rows[row].bit_count() == 1 and structure.known_rows[row].bit_count() == 1
    }


def check_unknowns(structure: Structure, names: Iterable[str]) -> None:
    """Raises ModelError if a name is not an unknown of the structure."""
    for name in names:
        if name not in structure.unknowns:
            raise ModelError(
                f"{name}: no unknown, so no sensor can measure it; those are {', '.join(structure.unknowns)}"
            )
