"""Frames of a log as columns: what every reader gives, and everything behind it takes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.values import FloatArray, Indices, Mask
from faultline.service.logs.report import Frame

EXTENDED, FD, REMOTE, ERROR, SENT = 1, 2, 4, 8, 16
"""Flags: an identifier of 29 bits, CAN FD, a remote frame, an error frame, sent by the logger itself."""
NO_DATA = REMOTE | ERROR

CLASSIC_BYTES, FD_BYTES = 8, 64
"""Widths of the data column."""
FD_SIZES = frozenset([*range(9), 12, 16, 20, 24, 32, 48, 64])
"""Bytes that a CAN FD frame may have (ISO 11898-1)."""
TOP, EXTENDED_TOP = 0x7FF, 0x1FFF_FFFF
"""The highest identifiers of 11 and of 29 bits."""

Bytes = npt.NDArray[np.uint8]
Numbers = npt.NDArray[np.uint32]


@dataclass(frozen=True, slots=True)
class Batch:
    """N frames of a log, in the file's order.

    `time` (N,) [s], float64, and NaN where the log has none; `channel` (N,), uint8: index of the channel in the order
    in which the log's channels came first; `identifier` (N,), uint32, without flags; `flags` (N,), uint8; `length`
    (N,), uint8: bytes of data, of a remote frame those it asks for; `data` (N, W), uint8, zero beyond the length, W =
    8, or 64 where a frame of the batch is longer.
    """

    time: FloatArray
    channel: Bytes
    identifier: Numbers
    flags: Bytes
    length: Bytes
    data: Bytes

    def __len__(self) -> int:
        """The number of frames."""
        return len(self.time)

    def __getitem__(self, rows: slice | Mask | Indices) -> Self:
        """The frames of some rows."""
        return type(self)(*(getattr(self, each.name)[rows] for each in fields(self)))

    def put(self, rows: Indices, part: "Batch") -> None:
        """Set some rows to the frames of another batch whose data column is no wider."""
        for each in ("time", "channel", "identifier", "flags", "length"):
            getattr(self, each)[rows] = getattr(part, each)
        self.data[rows, : part.data.shape[1]] = part.data

    @property
    def is_extended(self) -> Mask:
        """Which have an identifier of 29 bits (N,)."""
        return np.asarray(self.flags & EXTENDED != 0)

    @property
    def has_data(self) -> Mask:
        """Which are data frames (N,): neither remote nor error frames."""
        return np.asarray(self.flags & NO_DATA == 0)

    @property
    def with_data(self) -> "Batch":
        """The data frames alone; the batch itself where all are."""
        has_data = self.has_data
        return self if has_data.all() else self[has_data]

    def frames(self) -> Iterator[Frame]:
        """Each of the frames, whatever its flags."""
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
    return batch if now >= width else replace(batch, data=np.pad(batch.data, ((0, 0), (0, width - now))))


def joined(batches: Sequence[Batch]) -> Batch:
    """All of the batches as one."""
    if len(batches) == 1:
        return batches[0]
    width = max((each.data.shape[1] for each in batches), default=CLASSIC_BYTES)
    same = [widened(each, width) for each in batches] or [empty(0)]
    return Batch(*(np.concatenate([getattr(each, column.name) for each in same]) for column in fields(Batch)))


def impossible(batch: Batch) -> Mask:
    """Which frames no bus carries (N,): an identifier of too many bits, or a time that is no number."""
    top = np.where(batch.is_extended, np.uint32(EXTENDED_TOP), np.uint32(TOP))
    return np.asarray((batch.identifier > top) | ~np.isfinite(batch.time))


def batch_of(frames: Iterable[Frame]) -> Batch:
    """A batch of frames, all of the first channel."""
    rows = list(frames)
    width = FD_BYTES if any(len(each.data) > CLASSIC_BYTES for each in rows) else CLASSIC_BYTES
    raw = b"".join(each.data.ljust(width, b"\0") for each in rows)
    is_fd = FD if width == FD_BYTES else 0
    flags = [(EXTENDED if each.is_extended else 0) | (is_fd if len(each.data) > CLASSIC_BYTES else 0) for each in rows]
    return Batch(
        np.array([each.t for each in rows], dtype=np.float64),
        np.zeros(len(rows), np.uint8),
        np.array([each.can_id for each in rows], dtype=np.uint32),
        np.array(flags, dtype=np.uint8),
        np.array([len(each.data) for each in rows], dtype=np.uint8),
        np.frombuffer(raw, np.uint8).reshape(len(rows), width),
    )
