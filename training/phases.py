"""The messages of a recording as another start of the vehicle would have had them.

Every ECU begins its cycle when it is ready, so that with every start messages lie otherwise to each other: how much
older one signal is at a tick than another is an accident, the same throughout a recording. Networks that have seen one
such accident take it for physics. Here every message but the slowest is moved by parts of its period, as if its ECU
had sampled then: between two messages, a value lies on the straight line.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from faultline.service.core.signals.received import Column, Received, Signals
from faultline.service.core.signals.values import FloatArray, Indices, Qualities, Quality

PHASES, STARTS = 3, 4
"""Parts of a period by which messages are moved, and instants at which the vehicle is switched on then."""

WITHIN_S = 2.0
"""Of a log's beginning: by then every message has come, or is a rare one."""

GAP = 1.5
"""Periods between two messages: with more, one was lost, and nothing is known in between."""

APART = 0.382
"""Of a period, by which messages are moved otherwise than each other: the golden section, as no two fall together."""

_GOOD = int(Quality.GOOD)


class Stream(NamedTuple):
    """K messages of a kind, or rows of a table: log times (K,) [s], and by signal the values and qualities (K,)."""

    time: FloatArray
    signals: Mapping[str, tuple[FloatArray, Qualities]]

    @property
    def period_s(self) -> float:
        """The median time between two of them [s]; infinite where there is one."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else np.inf

    def moved(self, shift_s: float) -> "Stream":
        """Return the messages as they would be, sampled and sent `shift_s` later."""
        if shift_s == 0.0 or not np.isfinite(shift_s):
            return self
        before, after = self.time[:-1], self.time[1:]
        t = (before if shift_s > 0.0 else after) + shift_s
        gap, since = after - before, t - before
        is_there = (since >= 0.0) & (since <= gap) & (gap <= GAP * self.period_s) & (gap > 0.0)
        is_late = since > gap / 2
        signals = {}
        for name, (value, quality) in self.signals.items():
            is_line = is_there & (quality[:-1] == _GOOD) & (quality[1:] == _GOOD)
            with np.errstate(all="ignore"):
                line = value[:-1] + (value[1:] - value[:-1]) * since / gap
            nearest = np.where(is_late, value[1:], value[:-1])
            worth = np.where(is_late, quality[1:], quality[:-1])
            signals[name] = np.where(is_line, line, nearest), worth
        return Stream(t, signals)


class Start(NamedTuple):
    """What the vehicle would see from `begin_s` on [s]; `natural` where no message was moved."""

    streams: Sequence[Stream]
    begin_s: float
    natural: bool

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        """Yield the messages as one piece, whose rows they are: whose they are was judged before."""
        del judged
        kept = [np.flatnonzero(stream.time >= self.begin_s) for stream in self.streams]
        time = np.concatenate([np.zeros(0), *(each.time[rows] for each, rows in zip(self.streams, kept, strict=True))])
        if not len(time):
            return
        order = np.argsort(time, kind="stable")
        place = np.empty(len(order), np.intp)
        place[order] = np.arange(len(order))
        columns: dict[str, Column] = {}
        begin = 0
        for stream, rows in zip(self.streams, kept, strict=True):
            there = place[begin : begin + len(rows)]
            columns |= {name: Column(there, each[0][rows], each[1][rows]) for name, each in stream.signals.items()}
            begin += len(rows)
        time = time[order]
        yield Received(float(time[0]), float(time[-1]), time, np.concatenate([[-np.inf], time[:-1]]), columns)

    def strangers(self) -> list[str]:
        """Return nothing: what the log lacks was said before."""
        return []


def starts(signals: Signals) -> Iterator[Start]:
    """Yield what the vehicle would see, with messages in several phases, switched on at several instants.

    Instants lie evenly in the slowest message's period: as often as not two begin alike, as they would.
    """
    streams = _streams(signals)
    periods = [stream.period_s for stream in streams]
    slowest = int(np.argmax(periods)) if streams else None
    ranks = iter(range(len(streams)))
    rank = [None if k == slowest else next(ranks) for k in range(len(streams))]
    for part in range(PHASES if len(streams) > 1 else 1):
        moved = [
            stream if n is None else stream.moved(period * _share(part, n))
            for stream, n, period in zip(streams, rank, periods, strict=True)
        ]
        first_s = min((float(stream.time[0]) for stream in moved if len(stream.time)), default=0.0)
        within = 0.0 if slowest is None else min(periods[slowest], WITHIN_S)
        for k in range(STARTS):
            yield Start(moved, first_s + within * k / STARTS, natural=part == 0)


def _streams(signals: Signals) -> list[Stream]:
    """Return the messages by kind, in the order in which they came first: signals that came in the same rows."""
    rows: dict[str, list[Indices]] = {}
    parts: dict[str, list[tuple[FloatArray, FloatArray, Qualities]]] = {}
    count = 0
    for piece in signals.pieces(judged=False):
        for name, column in piece.columns.items():
            rows.setdefault(name, []).append(count + column.row)
            parts.setdefault(name, []).append((piece.time[column.row], column.value, column.quality))
        count += len(piece.time)
    together: dict[bytes, dict[str, tuple[FloatArray, FloatArray, Qualities]]] = {}
    order: dict[bytes, int] = {}
    for name, each in rows.items():
        came = np.concatenate(each)
        key = came.tobytes()
        order[key] = int(came[0])
        time, value, quality = (np.concatenate(column) for column in zip(*parts[name], strict=True))
        together.setdefault(key, {})[name] = time, value, quality
    return [
        Stream(next(iter(found.values()))[0], {name: (value, quality) for name, (_, value, quality) in found.items()})
        for found in (together[key] for key in sorted(together, key=lambda key: order[key]))
    ]


def _share(part: int, rank: int) -> float:
    """Of a period: 0, 1/3, -1/3 for the first message that is moved, others otherwise."""
    share = part * (1.0 / PHASES + rank * APART) % 1.0
    return share if share <= 0.5 else share - 1.0
