"""The objects of a BLF log's containers, found and read as arrays. Source of the layout: python-can, io/blf.py."""

import struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.values import FloatArray, Indices, Mask
from faultline.service.logs.batch import (
    CLASSIC_BYTES,
    ERROR,
    EXTENDED,
    FD,
    FD_BYTES,
    REMOTE,
    SENT,
    Batch,
    empty,
    impossible,
)

SIGNATURE = b"LOBJ"
BASE = struct.Struct("<4sHHLL")  # signature, header's size, its version, object's size, kind
CONTAINER = 10
PADDING = 7  # bytes between two objects at most

_CLASSIC, _FD_KIND, _FD64 = (1, 86), 100, 101
_ERRORS, _ERROR_FD64 = (2, 73, 104), 104
_OF_CAN = frozenset((*_CLASSIC, _FD_KIND, _FD64, *_ERRORS))
_IS_CAN = np.array([kind in _OF_CAN for kind in range(max(_OF_CAN) + 2)])
_TIMED_HEADER = 32  # bytes of the header of an object with a time
_LARGEST_CAN, _LARGEST = 512, 1 << 20  # bytes of an object: what says more is damaged
_TEN_MICROSECONDS = 1  # flags of a time; else nanoseconds
_IDENTIFIER = 0x1FFF_FFFF
_LONGEST_CODE = 15

_TIME = {"unit": ("<u4", 16), "ticks": ("<u8", 24)}
_BODIES: dict[int, dict[str, tuple[str, int]]] = {
    **{
        kind: {"channel": ("<u2", 0), "flags": ("u1", 2), "code": ("u1", 3), "identifier": ("<u4", 4)}
        for kind in _CLASSIC
    },
    _FD_KIND: {
        "channel": ("<u2", 0),
        "flags": ("u1", 2),
        "identifier": ("<u4", 4),
        "fd": ("u1", 13),
        "code": ("u1", 14),
    },
    _FD64: {
        "channel": ("u1", 0),
        "code": ("u1", 2),
        "identifier": ("<u4", 4),
        "flags": ("<u4", 12),
        "sent": ("u1", 34),
        "behind": ("u1", 35),
    },
    2: {"channel": ("<u2", 0)},
    73: {"channel": ("<u2", 0)},
    _ERROR_FD64: {"channel": ("u1", 0)},
}
"""Type and place of each field behind the header, by kind. `code` is the length, `behind` where the data end."""
_BODY_BYTES = {1: 16, 86: 16, _FD_KIND: 20, _FD64: 40, 2: 2, 73: 2, _ERROR_FD64: 2}
_REMOTE, _REMOTE_FD64 = 0x80, 0x10
_IS_FD, _IS_FD64 = 1, 0x1000

Ints = npt.NDArray[np.int64]


class Objects(NamedTuple):
    """Objects of a block of bytes: where each begins, its kind, and the bytes of its header and of all of it (N,)."""

    begin: Ints
    kind: Ints
    header: Ints
    size: Ints


def is_object(kind: int, header: int, size: int) -> bool:
    """True if an object may say so of itself."""
    least, largest = (_TIMED_HEADER, _LARGEST_CAN) if kind in _OF_CAN else (BASE.size, _LARGEST)
    return least <= header <= size and (size <= largest or kind == CONTAINER)


def chain(data: bytes) -> Objects:
    """The objects from the beginning on, as far as each begins where the one before ends, at a multiple of 4 bytes."""
    words = np.frombuffer(data, "<u4", len(data) // 4)
    at = np.flatnonzero(words == int.from_bytes(SIGNATURE, "little"))
    at = at[at <= len(words) - BASE.size // 4].astype(np.int64)
    header, size, kind = (words[at + 1] & 0xFFFF).astype(np.int64), words[at + 2].astype(np.int64), words[at + 3]
    is_can = _of_can(kind)
    good = (header >= np.where(is_can, _TIMED_HEADER, BASE.size)) & (header <= size)
    good &= (size <= np.where(is_can, _LARGEST_CAN, _LARGEST)) & (kind != CONTAINER)
    begin = 4 * at
    end = begin + size
    good &= end <= len(data)
    gap = np.append(begin[1:], begin[-1:] + size[-1:]) - end
    good &= (gap >= 0) & (gap <= PADDING)
    content = np.frombuffer(data, np.uint8)
    for k in range(int(gap[good].max(initial=0))):
        wide = good & (gap > k)
        good[wide] = content[end[wide] + k] == 0
    count = 0 if len(begin) == 0 or begin[0] else int(np.argmin(np.append(good, False)))
    return Objects(*(np.asarray(each[:count], dtype=np.int64) for each in (begin, kind, header, size)))


def _of_can(kind: npt.NDArray[np.integer]) -> Mask:
    return np.asarray(_IS_CAN[np.minimum(kind, len(_IS_CAN) - 1)])


class Decoded(NamedTuple):
    """Frames of objects with raw channel numbers (N,); how many are of another kind, and which cannot be read."""

    frames: Batch
    channels: npt.NDArray[np.uint16]
    others: int
    bad: Indices


def decode(data: bytes, objects: Objects, start_s: float) -> Decoded:
    """The frames of objects in their order; times are `start_s` [s] and theirs."""
    count = len(objects.begin)
    is_can = _of_can(objects.kind)
    batch, channels, good = empty(count, _width(objects)), np.zeros(count, np.uint16), np.zeros(count, np.bool_)
    shape = np.where(is_can, (objects.kind << 40) | (objects.header << 16) | objects.size, -1)
    kinds = shape[is_can]
    for same in kinds[:1].tolist() if (kinds == kinds[:1]).all() else np.unique(kinds).tolist():
        rows = np.flatnonzero(shape == same)
        kind, header, size = (int(each[rows[0]]) for each in objects[1:])
        if size >= header + _BODY_BYTES[kind]:
            begin = objects.begin[rows]
            raw = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))[begin]
            good[rows] = _group(raw, kind, header, start_s, rows, batch, channels)
    good &= ~impossible(batch)
    return Decoded(batch[good], channels[good], int(count - is_can.sum()), np.flatnonzero(is_can & ~good))


def _width(objects: Objects) -> int:
    return FD_BYTES if np.isin(objects.kind, (_FD_KIND, _FD64)).any() else CLASSIC_BYTES


def _group(
    raw: npt.NDArray[np.void],
    kind: int,
    header: int,
    start_s: float,
    rows: Indices,
    batch: Batch,
    channels: npt.NDArray[np.uint16],
) -> Mask:
    """Put objects of one kind and size into rows of the batch; which of them are frames (N,)."""
    places = {**_TIME, **{name: (form, header + at) for name, (form, at) in _BODIES[kind].items()}}
    columns = raw.view(
        {
            "names": [*places],
            "formats": [form for form, _ in places.values()],
            "offsets": [at for _, at in places.values()],
            "itemsize": raw.dtype.itemsize,
        }
    )
    batch.time[rows] = start_s + _seconds(columns["ticks"], columns["unit"])
    channels[rows] = columns["channel"]
    if kind in _ERRORS:
        batch.flags[rows] = ERROR
        return np.ones(len(rows), dtype=np.bool_)
    identifier = columns["identifier"]
    batch.identifier[rows] = identifier & np.uint32(_IDENTIFIER)
    flags = np.where(identifier >> np.uint32(31), EXTENDED, 0)
    bits = columns["flags"]
    is_remote = bits & (_REMOTE_FD64 if kind == _FD64 else _REMOTE) != 0
    sent = columns["sent"] if kind == _FD64 else bits & 1
    flags |= np.where(is_remote, REMOTE, 0) | np.where(sent, SENT, 0)
    length = columns["code"]
    good = length <= (_LONGEST_CODE if kind in _CLASSIC else FD_BYTES)
    if kind in _CLASSIC:
        length = np.minimum(length, CLASSIC_BYTES)
    else:
        is_fd = columns["fd"] & _IS_FD != 0 if kind == _FD_KIND else bits & _IS_FD64 != 0
        flags |= np.where(is_fd | (length > CLASSIC_BYTES), FD, 0)
    stored = _data(raw, kind, header, columns)
    good &= (stored[1] >= length) | is_remote | (kind == _FD64)
    kept = np.where(is_remote, 0, np.minimum(length, stored[1]))
    data = np.where(np.arange(stored[0].shape[1]) < kept[:, np.newaxis], stored[0], 0)
    batch.data[rows, : data.shape[1]] = data
    batch.flags[rows], batch.length[rows] = flags, length
    return np.asarray(good)


def _data(
    raw: npt.NDArray[np.void], kind: int, header: int, columns: npt.NDArray[np.void]
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """The bytes behind the fields (N, W), and how many of them may be data (N,): CANoe stores no zeros at the end."""
    begin = header + (8 if kind in _CLASSIC else _BODY_BYTES[kind])
    size = raw.dtype.itemsize
    end = min(size, begin + (CLASSIC_BYTES if kind in _CLASSIC else FD_BYTES))
    stored = raw.view(np.uint8).reshape(len(raw), size)[:, begin:end]
    there = np.full(len(raw), end - begin)
    if kind == _FD64:
        behind = columns["behind"].astype(np.int64) - _TIMED_HEADER - _BODY_BYTES[_FD64]
        there = np.where(columns["behind"] != 0, np.clip(behind, 0, end - begin), there)
    return stored, there


def _seconds(ticks: npt.NDArray[np.uint64], unit: npt.NDArray[np.uint32]) -> FloatArray:
    return np.asarray(ticks / np.where(unit == _TEN_MICROSECONDS, 1e5, 1e9))
