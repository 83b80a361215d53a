"""Sensors added to a structure and taken from it, by name."""

import dataclasses
from collections.abc import Iterable, Sequence

from analysis.model.errors import ModelError
from analysis.structure.structure import Structure


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
