"""The structure of a model: which equation contains which variables. Names at the edge, bitmasks within."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from faultline.analysis.model import Differential, Model, ModelError
from faultline.analysis.structure.matching import Matching, bits, equivalence_classes


class Constraint(NamedTuple):
    """A differential constraint: its row, and the unknowns that are its state and its derivative, all by number."""

    row: int
    state: int
    derivative: int


@dataclass(frozen=True)
class Structure:
    """Equations (differential constraints among them) against unknowns, known signals and faults.

    `unknown_rows[i]` and `known_rows[i]` have a bit for every unknown and known signal in equation i; `fault_rows` says
    which equation a fault enters; `differentials` maps the name of a differential constraint to it.
    """

    equations: tuple[str, ...]
    unknowns: tuple[str, ...]
    known: tuple[str, ...]
    faults: tuple[str, ...]
    unknown_rows: tuple[int, ...]
    known_rows: tuple[int, ...]
    fault_rows: Mapping[str, int]
    differentials: Mapping[str, Differential]

    @cached_property
    def row(self) -> Mapping[str, int]:
        """The row of every equation."""
        return {name: row for row, name in enumerate(self.equations)}

    @cached_property
    def constraints(self) -> Mapping[int, Constraint]:
        """The differential constraints by their rows, in order."""
        number = {name: x for x, name in enumerate(self.unknowns)}
        return {
            row: Constraint(row, number[self.differentials[name].state], number[self.differentials[name].derivative])
            for row, name in enumerate(self.equations)
            if name in self.differentials
        }

    @cached_property
    def classes(self) -> list[tuple[list[int], int]]:
        """The equivalence classes of the over-determined part: rows, and private unknowns (a bit each)."""
        return equivalence_classes(self.unknown_rows)

    def names(self, rows: int) -> tuple[str, ...]:
        """The equations in a set of rows."""
        return tuple(self.equations[row] for row in bits(rows))

    def rows(self, equations: Iterable[str]) -> tuple[int, ...]:
        """The rows of the named equations, in order."""
        return tuple(sorted({self.row[name] for name in equations if name in self.row}))

    def unknowns_in(self, equations: Iterable[str]) -> tuple[str, ...]:
        """The unknowns that occur in the equations, in the model's order."""
        return _named(self.unknowns, [self.unknown_rows[row] for row in self.rows(equations)])

    def known_in(self, equations: Iterable[str]) -> tuple[str, ...]:
        """The known signals that occur in the equations, in the model's order."""
        return _named(self.known, [self.known_rows[row] for row in self.rows(equations)])

    def faults_in(self, equations: Iterable[str]) -> tuple[str, ...]:
        """The faults that enter the equations, in the model's order."""
        rows = set(self.rows(equations))
        return tuple(fault for fault in self.faults if self.fault_rows[fault] in rows)

    def states_in(self, equations: Iterable[str]) -> tuple[str, ...]:
        """The states whose differential constraints are among the equations, in the model's order of unknowns."""
        states = {self.differentials[name].state for name in equations if name in self.differentials}
        return tuple(name for name in self.unknowns if name in states)


def structure_of(model: Model | Structure) -> Structure:
    """The structure of a model, which may be given as one already.

    Equations are sorted by name (e2 before e10), because the numbers of the tests follow from this order: a model file
    whose parts are rearranged keeps its numbers.

    Raises:
        ModelError: the model has residuals instead of equations.
    """
    if isinstance(model, Structure):
        return model
    if model.residuals:
        raise ModelError(
            f"{model.name}: is given by residuals of another tool: it has no equations that could be analysed or run"
        )
    contents = {name: {s.name for s in e.expression.free_symbols} for name, e in model.equations.items()}
    contents |= {d.name: {d.state, d.derivative} for d in model.differentials}
    equations = tuple(sorted(contents, key=_natural))
    unknowns, known = tuple(model.unknown), tuple(model.known)
    return Structure(
        equations=equations,
        unknowns=unknowns,
        known=known,
        faults=tuple(model.faults),
        unknown_rows=tuple(_mask(contents[name], unknowns) for name in equations),
        known_rows=tuple(_mask(contents[name], known) for name in equations),
        fault_rows={e.fault.name: equations.index(name) for name, e in model.equations.items() if e.fault is not None},
        differentials={d.name: d for d in model.differentials},
    )


def over_determined(structure: Structure) -> tuple[str, ...]:
    """The equations of the over-determined part M+ (Dulmage and Mendelsohn 1958)."""
    return tuple(structure.equations[row] for row in Matching(structure.unknown_rows).over_determined())


def redundancy(structure: Structure, equations: Sequence[str]) -> int:
    """Equations minus their unknowns: the redundancy of an over-determined set (Krysander, Aslund and Nyberg 2008)."""
    return len(equations) - len(structure.unknowns_in(equations))


def _mask(names: set[str], order: Sequence[str]) -> int:
    return sum(1 << position for position, name in enumerate(order) if name in names)


def _named(order: Sequence[str], masks: Iterable[int]) -> tuple[str, ...]:
    together = 0
    for mask in masks:
        together |= mask
    return tuple(order[position] for position in bits(together))


def _natural(name: str) -> list[tuple[int, str]]:
    """A key by which digits in names count as numbers."""
    parts: list[tuple[int, str]] = []
    for digits, other in re.findall(r"(\d+)|(\D+)", name):
        parts.append((int(digits), "") if digits else (-1, other))
    return parts
