"""Frames of an MF4's bus events (ASAM MDF, bus logging): their columns to batches, and groups in order of time."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.batch import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FD,
    FD_BYTES,
    REMOTE,
    SENT,
    Batch,
    joined,
)

KINDS = {"CAN_DataFrame": 0, "CAN_RemoteFrame": REMOTE, "CAN_ErrorFrame": ERROR}
"""Flags of a group's frames, by the name of its channel."""
RECORDS, FEWEST = 1 << 17, 1 << 12
"""Records that are read at once, of all groups together; and of one group at least."""

_LENGTHS = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64], dtype=np.uint8)  # bytes, by data length code
_TOP = np.uint32(0x7FF)

Columns = Mapping[str, npt.NDArray[Any]]


def frames_of(kind: str, columns: Columns, time: FloatArray) -> Batch:
    """Return the frames of one of `KINDS` at `time` (N,) [s], by the parts of a bus event (N,), its bytes (N, W)."""
    n = len(time)
    identifier = columns.get("ID", np.zeros(n, np.uint32)).astype(np.uint32)
    extended = columns["IDE"] if "IDE" in columns else (identifier >> np.uint32(31)) | (identifier > _TOP)
    identifier &= np.uint32(0x1FFF_FFFF)
    flags = np.full(n, KINDS[kind], np.uint8) | np.where(extended, EXTENDED, 0).astype(np.uint8)
    for name, flag in (("EDL", FD), ("Dir", SENT)):
        if name in columns:
            flags |= np.where(columns[name], flag, 0).astype(np.uint8)
    length = _length(columns, n)
    raw = columns.get("DataBytes", np.zeros((n, 0), np.uint8))
    width = FD_BYTES if (length > CLASSIC_BYTES).any() else CLASSIC_BYTES
    data = np.zeros((n, width), np.uint8)
    kept = min(width, raw.shape[1])
    data[:, :kept] = np.where(np.arange(kept) < length[:, np.newaxis], raw[:, :kept], 0)
    channel = columns.get("BusChannel", np.zeros(n, np.uint8)).astype(np.uint8)
    return Batch(time, channel, identifier, flags, length, data)


def _length(columns: Columns, count: int) -> npt.NDArray[np.uint8]:
    """The bytes of data (N,)."""
    if "DataLength" in columns:
        return np.asarray(np.minimum(columns["DataLength"], FD_BYTES), dtype=np.uint8)
    return np.asarray(_LENGTHS[np.minimum(columns.get("DLC", np.zeros(count, np.uint8)), len(_LENGTHS) - 1)])


def in_order(streams: Sequence[Iterator[Batch]]) -> Iterator[Batch]:
    """Yield the frames of all groups in order of time, of several; of each a batch is in memory."""
    if len(streams) == 1:
        yield from streams[0]
        return
    rising = [_rising(each) for each in streams]
    held = [next(stream, None) for stream in rising]
    while any(each is not None for each in held):
        until = min(float(each.time[-1]) for each in held if each is not None)
        ready = []
        for k, each in enumerate(held):
            if each is not None:
                count = int(np.searchsorted(each.time, until, "right"))
                ready.append(each[:count])
                held[k] = each[count:] if count < len(each) else next(rising[k], None)
        whole = joined(ready)
        yield whole[np.argsort(whole.time, kind="stable")]


def _rising(batches: Iterator[Batch]) -> Iterator[Batch]:
    """Those that are not empty, with times that never go back."""
    last = -np.inf
    for batch in batches:
        if len(batch):
            batch.time[:] = np.maximum.accumulate(np.maximum(batch.time, last))
            last = float(batch.time[-1])
            yield batch
