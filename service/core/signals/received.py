"""Signals as a log gives them, by pieces: the form between logs of every kind and what samples them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from faultline.service.core.signals.values import FloatArray, Indices, Qualities


class Column(NamedTuple):
    """What came of one signal: K values with their qualities, and in which `row` of the frames, which increases."""

    row: Indices
    value: FloatArray
    quality: Qualities


def column_of(items: Sequence[tuple[int, float, int]]) -> Column:
    """Return a column of rows, values and qualities."""
    row, value, quality = zip(*items, strict=True)
    return Column(np.array(row, np.intp), np.array(value, np.float64), np.array(quality, np.int8))


class Received(NamedTuple):
    """What came from log time `first_s` to `last_s` [s], the times of the first and the last frame, wanted or not.

    `time` (N,) are the log times [s] of the rows that the columns name, `before` (N,) those of the frame before each.
    """

    first_s: float
    last_s: float
    time: FloatArray
    before: FloatArray
    columns: Mapping[str, Column]


class Signals(Protocol):
    """The signals of a log, which may be read more than once."""

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        """Yield all of the log, in order of time; not `judged`: without doubts about whose a frame is."""

    def strangers(self) -> list[str]:
        """Return what to decide or mend where a signal never came, a sentence each."""
