"""Frames to signals for a whole log: columns of many frames at once, equal to `DecodeTable.decode` frame by frame.

Frames are grouped by message. What depends on the order of frames of several groups stays with the table: messages in
parts, claims of addresses and signals of more than 64 bits are decoded one by one, in their order, with everything of
the same groups.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import nan
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from faultline.service.core.frames import Frames
from faultline.service.core.j1939.identifiers import (
    ADDRESS_CLAIMED,
    FRAME,
    SOURCE_MASK,
    TP_CM,
    TP_DT,
    group_of,
)
from faultline.service.core.signals.bits import WORD, Bits
from faultline.service.core.signals.decode import EXTENDED, STANDARD, DecodeTable
from faultline.service.core.signals.layout import Layout
from faultline.service.core.signals.received import Column, Received, column_of
from faultline.service.core.signals.values import FloatArray, Indices, Quality

ROWS = 1 << 13
"""Frames that count, of as many batches as have them, that are decoded at once."""

_NUMBERS = 1 << 18
"""The count of numbers that a group can have, with data page and destination, in an identifier of 29 bits."""
_IS_EXTENDED = np.uint32(1 << 31)
_NONE, _SINGLY = -1, -2
_DOUBTED = int(Quality.DOUBTED)


class _Selected(NamedTuple):
    """Frames that count: log time and that of the frame before [s], identifier with bit 31 if extended, data."""

    time: FloatArray
    before: FloatArray
    key: npt.NDArray[np.uint32]
    length: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All of them, with the widest of their data."""
        if len(parts) == 1:
            return parts[0]
        width = max(part.data.shape[1] for part in parts)
        return cls(
            np.concatenate([part.time for part in parts]),
            np.concatenate([part.before for part in parts]),
            np.concatenate([part.key for part in parts]),
            np.concatenate([part.length for part in parts]),
            np.concatenate([_widened(part.data, width) for part in parts]),
        )

    def bytes_of(self, row: int) -> bytes:
        return self.data[row, : self.length[row]].tobytes()


class CanSignals:
    """The signals of a log's frames, by a table; `batches` reads them from the beginning, with times in order."""

    def __init__(self, table: DecodeTable, batches: Callable[[], Iterable[Frames]], rows: int = ROWS) -> None:
        """`rows`: a piece has so many frames that count, or a few more."""
        self._table, self._batches, self._rows = table, batches, rows

    def strangers(self) -> list[str]:
        """Return what to decide or mend in the DBC, as far as the log was read."""
        return self._table.strangers()

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        """Yield what the frames mean, in order; a time before an earlier one is taken as that earlier one.

        Where arrivals are not `judged`, nothing is doubted for when it came.
        """
        decoder = _Decoder(self._table, judged=judged)
        parts: list[_Selected] = []
        first = last = -np.inf
        for batch in self._batches():
            if not len(batch):
                continue
            t = np.maximum.accumulate(np.maximum(batch.time, last))
            first = float(t[0]) if not parts else first
            parts.append(decoder.select(batch, t, last))
            last = float(t[-1])
            if sum(len(part.time) for part in parts) >= self._rows:
                yield _received(decoder, parts, first, last)
                parts = []
        if parts:
            yield _received(decoder, parts, first, last)


def _received(decoder: "_Decoder", parts: Sequence[_Selected], first: float, last: float) -> Received:
    frames = _Selected.joined(parts)
    return Received(first, last, frames.time, frames.before, decoder.decode(frames))


class _Decoder:
    """Decodes by a table, whose state it shares: one batch may follow frames that the table decoded itself."""

    def __init__(self, table: DecodeTable, *, judged: bool) -> None:
        self._table, self._judged = table, judged
        self._near = np.zeros(_NUMBERS + STANDARD + 1, np.bool_)
        self._near[list(table.near)] = True
        for layout in table.layouts:
            if layout.mask == STANDARD:
                self._near[_NUMBERS | layout.identifier] = True
            elif layout.mask == EXTENDED:
                self._near[layout.identifier >> 8 & (_NUMBERS - 1)] = True
        self._layouts = {layout.name: k for k, layout in enumerate(table.layouts)}
        singly = [layout for layout in table.layouts if _is_wide(layout) or (layout.j1939 and layout.size > FRAME)]
        self._single = {layout.name for layout in singly}
        self._single_groups = {group_of(layout.identifier) for layout in singly if layout.j1939}
        self._single_groups |= {ADDRESS_CLAIMED} | (set() if table.parts is None else {TP_CM, TP_DT})
        self._from_any = {group_of(layout.identifier) for layout in table.layouts if layout.is_from_any}

    def select(self, frames: Frames, t: FloatArray, last: float) -> _Selected:
        """Return those that the table takes or counts, with their log times `t` (N,), after a frame at `last` [s]."""
        extended, identifier = frames.is_extended, frames.identifier
        number, bit = identifier >> 8 & (_NUMBERS - 1), _IS_EXTENDED
        if not (all_extended := bool(extended.all())):
            number = np.where(extended, number, _NUMBERS | identifier & STANDARD)
        rows = np.flatnonzero(self._near.take(number))
        before = t.take(rows - 1)
        if len(rows) and not rows[0]:
            before[0] = last
        key = identifier.take(rows) | (bit if all_extended else np.where(extended.take(rows), bit, np.uint32(0)))
        return _Selected(t.take(rows), before, key, frames.length.take(rows), frames.data.take(rows, axis=0))

    def decode(self, frames: _Selected) -> dict[str, Column]:
        """Return the columns of all signals that came."""
        keys, inverse = np.unique(frames.key, return_inverse=True)
        kinds = np.array(self._kinds(keys), np.intp)[inverse] if len(keys) else np.zeros(0, np.intp)
        columns = self._one_by_one(frames, np.flatnonzero(kinds == _SINGLY))
        if (others := np.flatnonzero(kinds == _NONE)).size:
            self._table.sources.take_others((frames.key[others] & ~_IS_EXTENDED).astype(np.intp))
        for k in np.unique(kinds[kinds >= 0]):
            columns |= self._message(self._table.layouts[k], frames, np.flatnonzero(kinds == k))
        return columns

    def _kinds(self, keys: npt.NDArray[np.uint32]) -> list[int]:
        """The number of the message that frames of each identifier carry, `_NONE`, or `_SINGLY`."""
        identifiers = [(int(key & ~_IS_EXTENDED), bool(key & _IS_EXTENDED)) for key in keys]
        singly = set(self._single_groups)
        if any(is_extended and group_of(can_id) == ADDRESS_CLAIMED for can_id, is_extended in identifiers):
            singly |= self._from_any  # whose address is claimed depends on who has spoken before
        found = []
        for can_id, is_extended in identifiers:
            layout = self._table.layout_of(can_id, is_extended)
            is_j1939 = is_extended and (layout is None or layout.j1939)
            is_wanted = layout is not None and layout.name in self._single
            if is_wanted or (is_j1939 and group_of(can_id) in singly):
                found.append(_SINGLY)
            else:
                found.append(_NONE if layout is None else self._layouts[layout.name])
        return found

    def _one_by_one(self, frames: _Selected, rows: Indices) -> dict[str, Column]:
        items: dict[str, list[tuple[int, float, int]]] = {}
        for row in rows.tolist():
            key, t = int(frames.key[row]), float(frames.time[row]) if self._judged else None
            identifier = key & EXTENDED, key >> 31 > 0
            for name, value, quality in self._table.decode(*identifier, frames.bytes_of(row), t):
                items.setdefault(name, []).append((row, value, int(quality)))
        return {name: column_of(each) for name, each in items.items()}

    def _message(self, layout: Layout, frames: _Selected, rows: Indices) -> dict[str, Column]:
        """The signals of a message, from its frames in these rows."""
        doubted = np.zeros(0, np.intp)
        if layout.is_from_any:
            addresses = (frames.key[rows] & np.uint32(SOURCE_MASK)).astype(np.intp)
            rows, doubted = np.split(rows, [self._table.sources.count_sole(layout, addresses)])
            _count(self._table.rejected.unclear, layout.name, len(doubted))
        is_short = frames.length.take(rows) < layout.size
        if is_short.any():
            _count(self._table.rejected.short, layout.name, int(np.count_nonzero(is_short)))
            rows = rows[~is_short]
        bits = Bits(frames.data.take(rows, axis=0), layout.size)  # `take` is ten times as fast as an index
        due, early = self._due(layout, frames, rows, bits)
        if len(due) < len(rows):
            bits = Bits(frames.data.take(due, axis=0), layout.size)
        self._table.taken[layout.name] += len(due)
        return _columns(layout, bits, due, np.concatenate([early, doubted]), self._table)

    def _due(self, layout: Layout, frames: _Selected, rows: Indices, bits: Bits) -> tuple[Indices, Indices]:
        """Return the rows of the frames that are due, and of those that came too early to be of the same sender."""
        arrivals = self._table.arrivals.get(layout.name)
        if not self._judged or arrivals is None or not len(rows):
            return rows, rows[:0]
        is_due, is_early = arrivals.judge_all(
            frames.time.take(rows), bits.repeat(), lambda k: frames.bytes_of(rows[k])[: layout.size]
        )
        early = rows[is_early]
        _count(self._table.rejected.early, layout.name, len(early))
        self._table.repeated[layout.name] += int(np.count_nonzero(~(is_due | is_early)))
        return rows if is_due.all() else rows[is_due], early


def _columns(layout: Layout, bits: Bits, rows: Indices, doubted: Indices, table: DecodeTable) -> dict[str, Column]:
    """The columns of a message whose frames `bits` (K,) are in `rows` (K,), and whose signals are doubted in others."""
    found = {plain[0]: Column(rows, *bits.plain_values(plain, layout.j1939)) for plain in layout.plain}
    if len(rows):
        _count(table.rejected.unknown_selector, layout.name, bits.count_unknown(layout))
    for field in layout.others:
        value, quality = bits.values(field, layout.j1939)
        there = bits.are_there(field.only) if field.only else slice(None)
        found[field.name] = Column(rows[there], value[there], quality[there])
    if not len(doubted):
        return found
    no_value, worth = np.full(len(doubted), nan), np.full(len(doubted), _DOUBTED, np.int8)
    return {name: _merged(found[name], Column(doubted, no_value, worth)) for name in layout.signals}


def _merged(column: Column, other: Column) -> Column:
    order = np.argsort(np.concatenate([column.row, other.row]))
    return Column(
        np.concatenate([column.row, other.row])[order],
        np.concatenate([column.value, other.value])[order],
        np.concatenate([column.quality, other.quality])[order],
    )


def _widened(data: npt.NDArray[np.uint8], width: int) -> npt.NDArray[np.uint8]:
    return data if data.shape[1] == width else np.pad(data, ((0, 0), (0, width - data.shape[1])))


def _is_wide(layout: Layout) -> bool:
    """Whether a signal or a selector of the message has more bits than are cut out at once."""
    cuts = [plain[-1].cut for plain in layout.plain] + [field.cut for field in layout.others]
    cuts += [cut for field in layout.others for cut, _ in field.only] + [one.cut for one in layout.selectors]
    return any(cut.length > WORD for cut in cuts)


def _count(counts: dict[str, int], name: str, more: int) -> None:
    if more:
        counts[name] = counts.get(name, 0) + more
