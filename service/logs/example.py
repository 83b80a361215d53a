"""A line of a text log whose fields are known, and by which all lines that are alike are read with array operations."""

from collections.abc import Callable
from math import nan
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.values import FloatArray, Indices
from faultline.service.logs.batch import CLASSIC_BYTES, EXTENDED, EXTENDED_TOP, FD_BYTES, TOP, Batch, Bytes
from faultline.service.logs.channels import Channels
from faultline.service.logs.digits import WIDTH, Words, base64, decimal, hexadecimal

Span = tuple[int, int]
"""The first character of a field, and the one beyond its last."""
NOWHERE: Span = (0, 0)
BASE64 = 0
"""Stride of data that are base64, with their padding."""
Lines = npt.NDArray[np.void]
"""The characters of N lines, behind `WIDTH` more (N,)."""

MOST_SECONDS, MOST_DECIMALS = 10, 9
"""Digits of a time that is read as `float` reads it."""
_EXACT = 2**53


class Fields(NamedTuple):
    """Where the fields of a line are.

    `time` are decimal digits with at most one point, nowhere where the line has none: its time is `start` [s] and the
    number over `divisor`. `identifier` are at most eight hexadecimal digits, `data` as well, two for a byte, and
    `stride` characters from one byte to the next, or base64 where `stride` is `BASE64`. `number` are decimal digits and
    `free` any characters; neither is used.
    """

    time: Span
    identifier: Span
    data: Span
    stride: int = 2
    free: tuple[Span, ...] = ()
    number: Span = NOWHERE
    start: float = 0.0
    divisor: float = 1.0


class Line(NamedTuple):
    """What a line holds: its channel's name, time [s] (NaN for none), identifier, flags (`logs.batch`) and data.

    `fields` are where they stand, where other lines may be read like this one.
    """

    channel: bytes
    time: float
    identifier: int
    flags: int
    data: bytes
    fields: Fields | None = None


def exact(seconds: Span, decimals: Span) -> bool:
    """True if a number with these digits before and behind its point is read as `float` reads it."""
    return seconds[1] - seconds[0] <= MOST_SECONDS and decimals[1] - decimals[0] <= MOST_DECIMALS


class Example:
    """A line by which others are read."""

    def __init__(self, line: bytes, read: Line, channels: Channels) -> None:
        assert read.fields is not None
        self._fields, self._read, self._channels = read.fields, read, channels
        self._width = -(-len(line) // WIDTH) * WIDTH
        begin, end = self._fields.time
        point = line.find(b".", begin, end)
        self._seconds = (begin, end if point < 0 else point)
        self._decimals = NOWHERE if point < 0 else (point + 1, end)
        begin, end = self._fields.data
        pairs = [(begin, end - line.count(b"=", begin, end))]
        if self._fields.stride != BASE64:
            pairs = [(at, at + 2) for at in range(begin, end, self._fields.stride)]
        varying = (
            self._seconds,
            self._decimals,
            self._fields.identifier,
            self._fields.number,
            *self._fields.free,
            *pairs,
        )
        keep = bytearray(b"\xff" * len(line))
        for first, beyond in varying:
            keep[first:beyond] = bytes(beyond - first)
        self._keep, fixed = (np.frombuffer(bytes(each).ljust(self._width, b"\0"), np.uint64) for each in (keep, line))
        self._fixed = fixed & self._keep
        self._top = EXTENDED_TOP if read.flags & EXTENDED else TOP

    def read(
        self, text: bytes, starts: npt.NDArray[np.int64], rows: Indices, give: Callable[[Indices, Batch], None]
    ) -> Indices:
        """Give the rows of the lines that are like this one with their frames; return the other rows.

        `text` has `WIDTH` bytes before the first line and at least a line's length behind the last. `rows` are in
        order.
        """
        before = WIDTH + self._width
        lines = np.ndarray((len(text) - before + 1,), f"V{before}", text, strides=(1,))
        lines = lines[(starts if len(rows) == len(starts) else starts[rows]) - WIDTH]
        alike = self._others(lines) == 0
        if not alike.any():
            return rows
        if not alike.all():
            lines = lines[alike]
        bad = np.zeros(len(lines), dtype=np.uint64)
        time = self._time(lines, bad)
        identifier = self._identifier(lines, bad)
        data = self._data(lines, bad)
        if self._fields.number != NOWHERE:
            _decimal(lines, self._fields.number, bad)
        batch = self._batch(time, identifier, data)
        if bad.any():
            good = bad == 0
            batch = batch[good]
            alike[alike] = good
        if len(batch):
            give(rows if len(batch) == len(rows) else rows[alike], batch)
        return np.asarray(rows[~alike])

    def _batch(self, time: FloatArray, identifier: npt.NDArray[np.uint32], data: Bytes) -> Batch:
        index = self._channels.index(self._read.channel)
        same = (np.full(len(time), each, np.uint8) for each in (index, self._read.flags, len(self._read.data)))
        channel, flags, length = same
        return Batch(time, channel, identifier, flags, length, data)

    def _others(self, lines: Lines) -> Words:
        """Not zero where another character is than the example's outside of its fields (N,)."""
        words = lines.view(np.uint64).reshape(len(lines), -1)
        bad = np.zeros(len(lines), dtype=np.uint64)
        for k in np.flatnonzero(self._keep).tolist():
            bad |= (words[:, k + 1] & self._keep[k]) ^ self._fixed[k]
        return bad

    def _time(self, lines: Lines, bad: Words) -> FloatArray:
        """As `float` reads it, of at most `MOST_SECONDS` and `MOST_DECIMALS` digits.

        A whole number below 2^53 over a power of ten is rounded once. Beyond, seconds and decimals are added: with nine
        decimals their sum is never near enough to the middle between two numbers that the decimals' own rounding
        counts.
        """
        if self._fields.time == NOWHERE:
            return np.full(len(lines), nan)
        seconds, decimals = _decimal(lines, self._seconds, bad), _decimal(lines, self._decimals, bad)
        power = 10 ** (self._decimals[1] - self._decimals[0])
        is_large = seconds >= _EXACT // power
        large = seconds.astype(np.float64) + decimals.astype(np.float64) / float(power)
        if is_large.all():
            number = large
        else:
            small = (seconds * np.uint64(power) + decimals).astype(np.float64) / float(power)
            number = np.where(is_large, large, small) if is_large.any() else small
        if (self._fields.start, self._fields.divisor) == (0.0, 1.0):
            return number
        return np.asarray(self._fields.start + number / self._fields.divisor)

    def _identifier(self, lines: Lines, bad: Words) -> npt.NDArray[np.uint32]:
        begin, end = self._fields.identifier
        number, wrong = hexadecimal(_words(lines, (begin, end)), end - begin)
        number = number.byteswap()
        bad |= wrong
        bad |= number > self._top
        return number

    def _data(self, lines: Lines, bad: Words) -> Bytes:
        """The bytes (N, 8 or 64), zero beyond the length; sets bits of `bad` where they are none."""
        count = len(self._read.data)
        data = np.zeros((len(lines), 2 if count <= CLASSIC_BYTES else FD_BYTES // 4), dtype="<u4")
        if self._fields.stride == BASE64:
            self._base64(lines, bad, data.view(np.uint8)[:, :count])
            return data.view(np.uint8)
        begin, _ = self._fields.data
        if self._fields.stride != 2:
            lines, begin = _closed_up(lines, self._fields.data, self._fields.stride), 0
        for k in range(-(-count // 4)):
            first, last = begin + WIDTH * k, begin + min(WIDTH * (k + 1), 2 * count)
            four, wrong = hexadecimal(_words(lines, (first, last)), last - first)
            data[:, k] = four >> np.uint32(4 * (WIDTH - (last - first)))
            bad |= wrong
        return data.view(np.uint8)

    def _base64(self, lines: Lines, bad: Words, data: Bytes) -> None:
        """Set the bytes (N, length) to what the characters are."""
        begin, end = self._fields.data
        if begin < end:
            raw = lines.view(np.uint8).reshape(len(lines), -1)
            whole, wrong = base64(raw[:, WIDTH + begin : WIDTH + end])
            data[:] = whole[:, : data.shape[1]]
            bad |= wrong


def _words(lines: Lines, span: Span) -> Words:
    """The eight characters (N,) that end with a field of at most eight."""
    kind = np.dtype({"names": ["word"], "formats": ["<u8"], "offsets": [span[1]], "itemsize": lines.dtype.itemsize})
    return np.asarray(lines.view(kind)["word"].copy())


def _decimal(lines: Lines, span: Span, bad: Words) -> Words:
    """The numbers of a field of decimal digits (N,); sets bits of `bad` where it holds others."""
    begin, end = span
    if begin == end:
        return np.zeros(len(lines), dtype=np.uint64)
    number, wrong = decimal(_words(lines, (max(begin, end - WIDTH), end)), min(WIDTH, end - begin))
    bad |= wrong
    if end - begin > WIDTH:
        return _decimal(lines, (begin, end - WIDTH), bad) * np.uint64(10**WIDTH) + number
    return number


def _closed_up(lines: Lines, span: Span, stride: int) -> Lines:
    """The digits of data alone, without what stands between its bytes, behind `WIDTH` bytes as in `lines`."""
    count = -(-(span[1] - span[0]) // stride)
    closed = np.zeros((len(lines), WIDTH + -(-2 * count // WIDTH) * WIDTH), dtype=np.uint8)
    raw = lines.view(np.uint8).reshape(len(lines), -1)
    for k in range(count):
        at = WIDTH + span[0] + stride * k
        closed[:, WIDTH + 2 * k : WIDTH + 2 * k + 2] = raw[:, at : at + 2]
    return closed.view(f"V{closed.shape[1]}").reshape(len(lines))
