"""Which equations' unknown inputs no data tell apart, and which sensor would: by the model's structure alone.

Every equation gets a fault of its own; what is not isolable then is not localisable either, whatever the effect does.
"""

import dataclasses
from collections.abc import Collection, Sequence

from faultline.analysis.model import Model
from faultline.analysis.structure import Structure, add_sensors, isolability_of, structure_of


def inseparable(model: Model, equation: str) -> tuple[str, ...]:
    """The other equations whose unknown inputs can do all that this one's can, and it all that theirs can."""
    return _alike(_with_faults(model), equation, tuple(model.equations))


def splitting_sensors(model: Model, equation: str, others: Collection[str]) -> tuple[str, ...]:
    """The unknowns of which an added sensor would tell the equation from most of the `others`; none if none does.

    Of these, those that the equation contains are first: they are nearest to what is to be told.
    """
    structure = _with_faults(model)
    now = len(_alike(structure, equation, others))
    own = {symbol.name for symbol in model.equations[equation].expression.free_symbols}
    derivatives = {d.derivative for d in model.differentials}
    found = {}
    for unknown in model.unknown:
        if unknown not in derivatives:
            found[unknown] = now - len(_alike(add_sensors(structure, [unknown]), equation, others))
    most = max(found.values(), default=0)
    if most == 0:
        return ()
    best = [unknown for unknown, count in found.items() if count == most]
    return tuple(sorted(best, key=lambda unknown: unknown not in own))


def _alike(structure: Structure, equation: str, others: Collection[str]) -> tuple[str, ...]:
    isolable = isolability_of(structure, "mixed")
    return tuple(
        other for other in others if other != equation and other in isolable[equation] and equation in isolable[other]
    )


def _with_faults(model: Model) -> Structure:
    structure = structure_of(model)
    rows: dict[str, int] = {name: structure.equations.index(name) for name in model.equations}
    faults: Sequence[str] = tuple(rows)
    return dataclasses.replace(structure, faults=tuple(faults), fault_rows=rows)
