"""The bitmask engine: maximum matchings and the over-determined part of a bipartite structure.

A structure is a list of rows (equations); row i is an integer whose bit x is set where unknown x occurs in it. Sets of
rows are integers as well. Names stay outside.

Sources: augmenting paths after Berge (1957); the over-determined part M+ after Dulmage and Mendelsohn (1958): what
alternating paths from unmatched rows reach.
"""

import functools
import operator
from collections.abc import Iterable, Iterator, Sequence


def bits(mask: int) -> Iterator[int]:
    """The positions of the bits set, lowest first."""
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low


def mask_of(positions: Sequence[int]) -> int:
    """The integer with these bits set."""
    mask = 0
    for position in positions:
        mask |= 1 << position
    return mask


class Matching:
    """A maximum matching of `rows`: `owner` maps a matched unknown to its row, `free` are the unmatched rows."""

    def __init__(self, rows: Sequence[int]) -> None:
        self._rows = rows
        self._mate: dict[int, int] = {}  # row -> unknown
        self.owner: dict[int, int] = {}  # unknown -> row
        self._owned = 0  # the matched unknowns, a bit each
        self.free = [row for row in range(len(rows)) if not self._augment(row)]

    @property
    def rank(self) -> int:
        """The structural rank: the number of matched rows."""
        return len(self._mate)

    def pairs(self) -> dict[int, int]:
        """The matching, row to unknown."""
        return dict(self._mate)

    def owners_without(self, row: int) -> dict[int, int]:
        """A maximum matching, unknown to row, that leaves out this row of M+."""
        if row not in self._mate:
            return dict(self.owner)
        return self.owner | self._path_to(row)[1]

    def over_determined(self) -> list[int]:
        """The rows of M+, in order."""
        return self._reached(self.free)

    def over_determined_without(self, row: int) -> list[int]:
        """The rows of M+ after `row`, itself in M+, is removed."""
        free = list(self.free)
        if row in self._mate:
            start, path = self._path_to(row)
            free.remove(start)
            return self._reached(free, path)
        free.remove(row)
        return self._reached(free)

    def over_determined_by(self, x: int) -> list[int]:
        """The rows that a sensor of an unknown which they determine would add to M+, or that are in it already."""
        return self._reached([self.owner[x]])

    def _reached(self, free: Sequence[int], flipped: dict[int, int] | None = None) -> list[int]:
        """What alternating paths from `free` reach; `flipped` are unknowns with another owner than in this matching."""
        queue, seen = list(free), 0
        for row in queue:  # grows
            new = self._rows[row] & ~seen
            seen |= new
            queue.extend(self.owner[x] if flipped is None else flipped.get(x, self.owner[x]) for x in bits(new))
        return sorted(queue)

    def _path_to(self, goal: int) -> tuple[int, dict[int, int]]:
        """An alternating path from a free row to the matched row `goal`: where it starts, and the owners it changes."""
        came: dict[int, int] = {}  # unknown -> the row it was reached from
        queue, seen = list(self.free), 0
        for row in queue:  # grows
            new = self._rows[row] & ~seen
            seen |= new
            for x in bits(new):
                came[x] = row
                queue.append(self.owner[x])
            if self._mate[goal] in came:
                break
        owners: dict[int, int] = {}
        row = goal
        while row in self._mate:
            x = self._mate[row]
            row = owners[x] = came[x]
        return row, owners

    def _augment(self, start: int) -> bool:
        """Matches the row, moving others along an alternating path if need be; False if there is no such path."""
        came: dict[int, int] = {}
        queue, seen = [start], 0
        for row in queue:  # grows
            new = self._rows[row] & ~seen
            ready = new & ~self._owned
            if ready:
                low = ready & -ready
                self._owned |= low
                came[low.bit_length() - 1] = row
                self._flip(low.bit_length() - 1, came)
                return True
            seen |= new
            for x in bits(new):
                came[x] = row
                queue.append(self.owner[x])
        return False

    def _flip(self, x: int, came: dict[int, int]) -> None:
        """Gives every unknown on the path that ends in `x` to the row it was reached from."""
        following: int | None = x
        while following is not None:
            x, row = following, came[following]
            following = self._mate.get(row)
            self.owner[x], self._mate[row] = row, x


def equivalence_classes(rows: Sequence[int]) -> list[tuple[list[int], int]]:
    """The classes of equivalent rows of M+, each with its private unknowns (a bit each), those in no other class.

    Removing a row of a class takes its other rows out of M+ too (Krysander, Aslund and Nyberg 2008).
    """
    over = Matching(rows).over_determined()
    part = [rows[row] for row in over]
    matching = Matching(part)
    left, found = dict.fromkeys(range(len(part))), []
    while left:
        remaining = set(matching.over_determined_without(next(iter(left))))
        members = [i for i in left if i not in remaining]
        for i in members:
            del left[i]
        inside, outside = (union(part[i] for i in chosen) for chosen in (members, remaining))
        found.append(([over[i] for i in members], inside & ~outside))
    return found


def union(masks: Iterable[int]) -> int:
    """The bits that are set in any of the masks."""
    return functools.reduce(operator.or_, masks, 0)


def transposed(rows: Sequence[int], chosen: int, unknowns: int) -> list[int]:
    """For every unknown the chosen rows that contain it."""
    columns = [0] * unknowns
    for row in bits(chosen):
        for x in bits(rows[row]):
            columns[x] |= 1 << row
    return columns
