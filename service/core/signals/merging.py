"""Signals of several sources as those of one log: a bus and a table, or channels that were sampled at their own rates.

What comes at the same time keeps the order of the sources.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from faultline.service.core.signals.received import Column, Received, Signals


class MergedPart(NamedTuple):
    """A source, and the signals of it that are not taken, as another source has them."""

    signals: Signals
    without: Collection[str] = ()


class MergedSignals:
    """The signals of all parts, in order of time; a piece ends where the first of the parts' pieces does."""

    def __init__(self, parts: Sequence[MergedPart]) -> None:
        self._parts = parts

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        """Yield all of the log: see `Signals`."""
        streams = [_of(part, judged) for part in self._parts]
        held = [next(stream, None) for stream in streams]
        last = -np.inf
        while there := [each for each in held if each is not None]:
            until = min(each.last_s for each in there)
            ready = []
            for k, each in enumerate(held):
                if each is None or each.first_s > until:
                    continue
                head, rest = _cut(each, until)
                ready.append(head)
                held[k] = next(streams[k], None) if rest is None else rest
            piece = _joined(ready, last)
            last = piece.last_s
            yield piece

    def strangers(self) -> list[str]:
        """Return what to decide or mend in any of them."""
        return [sentence for part in self._parts for sentence in part.signals.strangers()]


def _of(part: MergedPart, judged: bool) -> Iterator[Received]:
    for piece in part.signals.pieces(judged=judged):
        yield piece._replace(columns={name: each for name, each in piece.columns.items() if name not in part.without})


def _cut(piece: Received, until: float) -> tuple[Received, Received | None]:
    """Return what came up to this time [s], and what came later; None where the piece ends by then."""
    if piece.last_s <= until:
        return piece, None
    count = int(np.searchsorted(piece.time, until, "right"))
    head, rest = {}, {}
    for name, column in piece.columns.items():
        at = int(np.searchsorted(column.row, count))
        head[name] = Column(column.row[:at], column.value[:at], column.quality[:at])
        rest[name] = Column(column.row[at:] - count, column.value[at:], column.quality[at:])
    first = float(piece.time[count]) if count < len(piece.time) else piece.last_s
    return (
        Received(piece.first_s, until, piece.time[:count], piece.before[:count], head),
        Received(first, piece.last_s, piece.time[count:], piece.before[count:], rest),
    )


def _joined(pieces: Sequence[Received], last: float) -> Received:
    """Return the pieces as one, behind a row at `last` [s]."""
    time = np.concatenate([piece.time for piece in pieces])
    order = np.argsort(time, kind="stable")
    time = time[order]
    before = np.concatenate([piece.before for piece in pieces])[order]
    np.maximum(before, np.concatenate([[last], time[:-1]]), out=before)
    place = np.empty(len(order), np.intp)
    place[order] = np.arange(len(order))
    columns, begin = {}, 0
    for piece in pieces:
        for name, column in piece.columns.items():
            if len(column.row):
                columns[name] = column._replace(row=place[begin + column.row])
        begin += len(piece.time)
    return Received(
        min(piece.first_s for piece in pieces), max(piece.last_s for piece in pieces), time, before, columns
    )
