"""Detectability and isolability of a structure, for three causal interpretations of its differential constraints.

*mixed*: a differential constraint is used in either direction; *integral*: it gives the state from its derivative;
*derivative*: it gives the derivative from the state. A fault is detectable if its equation is in the over-determined
part under that interpretation, and isolable from another fault if that is so without the other's equation. These parts
are the unions of the minimal over-determined sets that can be run so, but no such set is enumerated here.

Source: Frisk, Bregon, Aslund, Krysander, Pulido and Biswas, Diagnosability analysis considering causal interpretations
for differential constraints (IEEE Transactions on Systems, Man and Cybernetics A, 2012).
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, get_args

from faultline.analysis.model.errors import ModelError
from faultline.analysis.structure.matching import bits, mask_of, transposed
from faultline.analysis.structure.structure import Constraint, Structure

Interpretation = Literal["mixed", "integral", "derivative"]


def detectability(structure: Structure, causality: Interpretation) -> tuple[str, ...]:
    """The faults that some test of this causality is sensitive to, in the model's order.

    Raises:
        ModelError: there is no such causality.
    """
    part = OverDeterminedPart(structure, causality).without()
    return tuple(fault for fault in structure.faults if part >> structure.fault_rows[fault] & 1)


def isolability_of(structure: Structure, causality: Interpretation) -> dict[str, tuple[str, ...]]:
    """For every fault the others that it is not isolable from, in order; a fault that is not detectable has them all.

    Raises:
        ModelError: there is no such causality.
    """
    parts = OverDeterminedPart(structure, causality)
    whole = parts.without()
    # Removing an equation that is in no test takes no test away.
    rest = {row: parts.without(1 << row) for row in {*structure.fault_rows.values()} if whole >> row & 1}
    without = {fault: rest.get(row, whole) for fault, row in structure.fault_rows.items()}
    return {
        fault: tuple(
            other
            for other in structure.faults
            if other != fault and not without[other] >> structure.fault_rows[fault] & 1
        )
        for fault in structure.faults
    }


class OverDeterminedPart:
    """The over-determined part under one interpretation: of all rows, or of those left when some are removed.

    Algebraic rows are matched with unknowns once; what a question removes updates a copy of that matching.
    """

    def __init__(self, structure: Structure, causality: Interpretation) -> None:
        """Raises ModelError if there is no such causality."""
        if causality not in get_args(Interpretation):
            raise ModelError(f"{causality}: no causality; those are {', '.join(get_args(Interpretation))}")
        self._causality = causality
        self._rows = structure.unknown_rows
        number = len(structure.unknowns)
        self._constraints = [*structure.constraints.values()] if causality != "mixed" else []
        everything = (1 << len(self._rows)) - 1
        self._algebraic = everything & ~mask_of([c.row for c in self._constraints])
        # With integral causality the states are given as long as their derivatives can be computed.
        given = {c.state for c in self._constraints} if causality == "integral" else set()
        self._matching = _Matching(self._rows, transposed(self._rows, self._algebraic, number), self._algebraic)
        self._matching.add(x for x in range(number) if x not in given)

    def without(self, removed: int = 0) -> int:
        """The rows (a bit each) of the over-determined part when the `removed` rows (a bit each) are not there."""
        matching = self._matching.copy()
        matching.remove(removed & self._algebraic)
        left = [c for c in self._constraints if not removed >> c.row & 1]
        if self._causality == "integral":
            return self._integral(matching, left)
        return self._derivative(matching, left)

    def _integral(self, matching: "_Matching", used: list[Constraint]) -> int:
        """A constraint whose derivative cannot be computed gives no state, which then is an unknown like others."""
        matching.add({c.state for c in self._constraints} - {c.state for c in used})
        while True:
            undetermined = matching.undetermined()
            lost = [c for c in used if undetermined >> c.derivative & 1]
            if not lost:
                return self._reached(matching.free, matching.row_of | {c.state: c.row for c in used})
            used = [c for c in used if not undetermined >> c.derivative & 1]
            matching.add(c.state for c in lost)

    def _derivative(self, matching: "_Matching", left: list[Constraint]) -> int:
        """A state that can be computed gives its derivative; that may make others computable.

        A constraint whose derivative is computable without it is redundant. With mixed causality there is none here.
        """
        given: dict[int, int] = {}  # derivative -> row of its constraint
        while True:
            undetermined = matching.undetermined()
            now = {
                c.derivative: c.row
                for c in left
                if undetermined >> c.derivative & 1 and not undetermined >> c.state & 1
            }
            if not now:
                break
            given |= now
            matching.drop(now)
        redundant = mask_of(
            [
                c.row
                for c in left
                if given.get(c.derivative) != c.row and not undetermined & (1 << c.state | 1 << c.derivative)
            ]
        )
        return self._reached(matching.free | redundant, matching.row_of | given)

    def _reached(self, free: int, row_of: Mapping[int, int]) -> int:
        """The rows that alternating paths from the `free` rows reach when unknowns belong to `row_of`."""
        queue, seen, found = list(bits(free)), 0, free
        for row in queue:  # grows
            new = self._rows[row] & ~seen
            seen |= new
            while new:
                low = new & -new
                new ^= low
                owner = row_of[low.bit_length() - 1]
                found |= 1 << owner
                queue.append(owner)
        return found


class _Matching:
    """A maximum matching of unknowns with rows, kept while rows go and unknowns come and go.

    `row_of` maps a matched unknown to its row; `free` has a bit for every unmatched row.
    """

    def __init__(self, equations: Sequence[int], columns: Sequence[int], rows: int) -> None:
        self._equations = equations
        self._columns = columns
        self._rows = rows
        self._unmatched: set[int] = set()
        self._unknown_of: dict[int, int] = {}
        self.row_of: dict[int, int] = {}
        self.free = rows

    def copy(self) -> "_Matching":
        other = _Matching(self._equations, self._columns, self._rows)
        other._unmatched = set(self._unmatched)
        other._unknown_of = dict(self._unknown_of)
        other.row_of = dict(self.row_of)
        other.free = self.free
        return other

    def add(self, unknowns: Iterable[int]) -> None:
        """More unknowns."""
        for x in unknowns:
            if not self._augment(x):
                self._unmatched.add(x)

    def drop(self, unknowns: Iterable[int]) -> None:
        """Fewer unknowns: their rows are free for others."""
        for x in unknowns:
            self._unmatched.discard(x)
            if x in self.row_of:
                row = self.row_of.pop(x)
                del self._unknown_of[row]
                self.free |= 1 << row
                self._use(row)

    def remove(self, rows: int) -> None:
        """Fewer rows."""
        self._rows &= ~rows
        self.free &= ~rows
        for row in bits(rows):
            if row in self._unknown_of:
                x = self._unknown_of.pop(row)
                del self.row_of[x]
                self.add([x])

    def undetermined(self) -> int:
        """The unknowns (a bit each) that the rows do not determine: the under-determined part."""
        queue, seen, found = list(self._unmatched), 0, mask_of([*self._unmatched])
        for x in queue:  # grows
            new = self._columns[x] & self._rows & ~seen
            seen |= new
            for row in bits(new):
                found |= 1 << self._unknown_of[row]
                queue.append(self._unknown_of[row])
        return found

    def _augment(self, start: int) -> bool:
        """Matches the unknown, moving others along an alternating path if need be; False if there is no such path."""
        came: dict[int, int] = {}  # row -> the unknown it was reached from
        queue, seen = [start], 0
        for x in queue:  # grows
            new = self._columns[x] & self._rows & ~seen
            if new & self.free:
                row = (new & self.free).bit_length() - 1
                self.free ^= 1 << row
                came[row] = x
                self._flip(row, came)
                return True
            seen |= new
            for row in bits(new):
                came[row] = x
                queue.append(self._unknown_of[row])
        return False

    def _use(self, start: int) -> None:
        """Matches a row that has become free with an unmatched unknown, moving others, if there is such a path."""
        came: dict[int, int] = {}  # unknown -> the row it was reached from
        queue, there = [start], mask_of([*self._unmatched, *self.row_of])
        for row in queue:  # grows
            new = self._equations[row] & there
            there &= ~new
            for x in bits(new):
                came[x] = row
                if x not in self.row_of:
                    self._unmatched.discard(x)
                    self.free ^= 1 << start
                    while row != start:
                        before = self._unknown_of[row]
                        self.row_of[x], self._unknown_of[row] = row, x
                        x, row = before, came[before]
                    self.row_of[x], self._unknown_of[row] = row, x
                    return
                queue.append(self.row_of[x])

    def _flip(self, row: int, came: Mapping[int, int]) -> None:
        following: int | None = row
        while following is not None:
            row, x = following, came[following]
            following = self.row_of.get(x)
            self.row_of[x], self._unknown_of[row] = row, x
