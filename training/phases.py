"""The messages of a recording as another start of the vehicle would have had them.

Every ECU begins its cycle when it is ready, so that with every start messages lie otherwise to each other: how much
older one signal is at a tick than another is an accident, the same throughout a recording. Networks that have seen one
such accident take it for physics. Here every message but the slowest is moved by parts of its period, as if its ECU
had sampled then: between two messages, a value lies on the straight line.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from faultline.service.core.residuals.observer import Decoder
from faultline.service.core.signals.received import Received, column_of
from faultline.service.core.signals.values import Quality
from faultline.service.logs import Frame

PHASES, STARTS = 3, 4
"""Parts of a period by which messages are moved, and instants at which the vehicle is switched on then."""

WITHIN_S = 2.0
"""Of a log's beginning: by then every message has come, or is a rare one."""

GAP = 1.5
"""Periods between two messages: with more, one was lost, and nothing is known in between."""

APART = 0.382
"""Of a period, by which messages are moved otherwise than each other: the golden section, as no two fall together."""

Signals = list[tuple[str, float, Quality]]


class Message(NamedTuple):
    """A frame that carries signals."""

    t_s: float
    key: tuple[int, bool]
    signals: Signals


class Start(NamedTuple):
    """What the vehicle would see; `natural` where no message was moved."""

    messages: list[Message]
    natural: bool

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        """Yield the messages as one piece, whose rows they are: whose they are was judged before."""
        del judged
        if not self.messages:
            return
        time = np.array([message.t_s for message in self.messages])
        items: dict[str, list[tuple[int, float, int]]] = {}
        for row, message in enumerate(self.messages):
            for name, value, quality in message.signals:
                items.setdefault(name, []).append((row, value, int(quality)))
        columns = {name: column_of(each) for name, each in items.items()}
        yield Received(time[0], time[-1], time, np.concatenate([[-np.inf], time[:-1]]), columns)

    def strangers(self) -> list[str]:
        """Return nothing: what the log lacks was said before."""
        return []


def starts(frames: Iterable[Frame], table: Decoder) -> Iterator[Start]:
    """What the vehicle would see, with messages in several phases, switched on at several instants.

    Instants lie evenly in the slowest message's period: as often as not two begin alike, as they would.
    """
    messages = [
        Message(t_s, (can_id, is_extended), signals)
        for t_s, can_id, is_extended, data in frames
        if (signals := [*table.decode(can_id, is_extended, data)])
    ]
    streams: dict[tuple[int, bool], list[Message]] = {}
    for message in messages:
        streams.setdefault(message.key, []).append(message)
    periods = {key: _period(stream) for key, stream in streams.items()}
    slowest = max(periods, key=lambda key: periods[key], default=None)
    rank = {key: n for n, key in enumerate(key for key in streams if key != slowest)}
    for part in range(PHASES if len(streams) > 1 else 1):
        moved = [
            _moved(stream, periods[key] * _share(part, rank[key]) if key in rank else 0.0, periods[key])
            for key, stream in streams.items()
        ]
        together = sorted((message for stream in moved for message in stream), key=lambda message: message.t_s)
        within = min(periods[slowest], WITHIN_S) if slowest else 0.0
        for k in range(STARTS):
            begin = together[0].t_s + within * k / STARTS if together else 0.0
            yield Start([message for message in together if message.t_s >= begin], natural=part == 0)


def _share(part: int, rank: int) -> float:
    """Of a period: 0, 1/3, -1/3 for the first message that is moved, others otherwise."""
    share = part * (1.0 / PHASES + rank * APART) % 1.0
    return share if share <= 0.5 else share - 1.0


def _period(stream: Sequence[Message]) -> float:
    return float(np.median(np.diff([message.t_s for message in stream]))) if len(stream) > 1 else np.inf


def _moved(stream: list[Message], shift_s: float, period_s: float) -> list[Message]:
    """The messages as they would be, sampled and sent `shift_s` later."""
    if shift_s == 0.0 or not np.isfinite(shift_s):
        return stream
    return [
        _between(before, after, (before if shift_s > 0.0 else after).t_s + shift_s, period_s)
        for before, after in pairwise(stream)
    ]


def _between(before: Message, after: Message, t_s: float, period_s: float) -> Message:
    gap = after.t_s - before.t_s
    there = 0.0 <= t_s - before.t_s <= gap <= GAP * period_s and gap > 0.0
    signals: Signals = []
    for (name, first, good), (_, second, also) in zip(before.signals, after.signals, strict=True):
        if there and good is also is Quality.GOOD:
            signals.append((name, first + (second - first) * (t_s - before.t_s) / gap, good))
        else:
            signals.append((name, second, also) if t_s - before.t_s > gap / 2 else (name, first, good))
    return Message(t_s, before.key, signals)
