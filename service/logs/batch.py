"""Frames of a log as columns: what every reader gives, and everything behind it takes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Self

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.values import FloatArray, Mask
from faultline.service.logs.report import Frame

if TYPE_CHECKING:
    from collections.abc import Sequence

EXTENDED, FD, REMOTE, ERROR, SENT = 1, 2, 4, 8, 16
"""Flags: an identifier of 29 bits, CAN FD, a remote frame, an error frame, sent by the logger itself."""
NO_DATA = REMOTE | ERROR

CLASSIC_BYTES, FD_BYTES = 8, 64
"""Widths of the data column."""

Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Batch:
    """N frames of a log, in the file's order.

    `time` (N,) [s], float64, and NaN where the log has none; `channel` (N,), uint8: index of the channel in the order in
    which the log's channels came first; `identifier` (N,), uint32, without flags; `flags` (N,), uint8; `length` (N,),
    uint8: bytes of data; `data` (N, W), uint8, zero beyond the length, W = 8, or 64 where a frame of the batch is longer.
    """

    time: FloatArray
    channel: Bytes
    identifier: npt.NDArray[np.uint32]
    flags: Bytes
    length: Bytes
    data: Bytes

    def __len__(self) -> int:
        """The number of frames."""
        return len(self.time)

    def __getitem__(self, rows: "slice | Mask | npt.NDArray[np.intp]") -> Self:
        """The frames of some rows."""
        return type(self)(*(getattr(self, each.name)[rows] for each in fields(self)))

    @property
    def is_extended(self) -> Mask:
        """Which have an identifier of 29 bits (N,)."""
        return np.asarray(self.flags & EXTENDED != 0)

    @property
    def has_data(self) -> Mask:
        """Which are data frames (N,): neither remote nor error frames."""
        return np.asarray(self.flags & NO_DATA == 0)

    def frames(self) -> Iterator[Frame]:
        """Each of the frames."""
        width = self.data.shape[1]
        raw = self.data.tobytes()
        columns = zip(
            self.time.tolist(), self.identifier.tolist(), self.is_extended.tolist(), self.length.tolist(), strict=True
        )
        for k, (t, identifier, is_extended, length) in enumerate(columns):
            yield Frame(t, identifier, is_extended, raw[width * k : width * k + length])


def empty(count: int, width: int = CLASSIC_BYTES) -> Batch:
    """A batch of `count` frames of zeros, to be filled."""
    return Batch(
        np.zeros(count),
        np.zeros(count, np.uint8),
        np.zeros(count, np.uint32),
        np.zeros(count, np.uint8),
        np.zeros(count, np.uint8),
        np.zeros((count, width), np.uint8),
    )


def widened(batch: Batch, width: int) -> Batch:
    """The batch with a data column of at least `width` bytes."""
    now = batch.data.shape[1]
    if now >= width:
        return batch
    data = np.pad(batch.data, ((0, 0), (0, width - now)))
    return Batch(batch.time, batch.channel, batch.identifier, batch.flags, batch.length, data)


def joined(batches: "Sequence[Batch]") -> Batch:
    """All of the batches as one."""
    if len(batches) == 1:
        return batches[0]
    width = max((each.data.shape[1] for each in batches), default=CLASSIC_BYTES)
    same = [widened(each, width) for each in batches] or [empty(0)]
    return Batch(*(np.concatenate([getattr(each, column.name) for each in same]) for column in fields(Batch)))


def batch_of(frames: Iterable[Frame]) -> Batch:
    """A batch of frames, all of the first channel."""
    rows = list(frames)
    width = FD_BYTES if any(len(each.data) > CLASSIC_BYTES for each in rows) else CLASSIC_BYTES
    raw = b"".join(each.data.ljust(width, b"\0") for each in rows)
    return Batch(
        np.array([each.t for each in rows], dtype=np.float64),
        np.zeros(len(rows), np.uint8),
        np.array([each.can_id for each in rows], dtype=np.uint32),
        np.array([EXTENDED if each.is_extended else 0 for each in rows], dtype=np.uint8),
        np.array([len(each.data) for each in rows], dtype=np.uint8),
        np.frombuffer(raw, np.uint8).reshape(len(rows), width),
    )
