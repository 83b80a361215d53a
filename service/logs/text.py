"""Lines of a text log to columns: one line is read by its format's grammar, and all that are alike by its example.

A logger writes line after line with its fields in the same places. So the grammar (a regular expression, strict) reads
one line and says where its fields are; every other line of the same length that has the same characters outside of them,
and digits inside, is read with array operations. A line that is not like any before is read by the grammar again, and
its example is kept. What comes out is what the grammar alone gives, line by line.
"""

from collections.abc import Callable
from math import isfinite
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.decode import EXTENDED as EXTENDED_TOP
from faultline.service.core.signals.decode import STANDARD as STANDARD_TOP
from faultline.service.core.signals.values import FloatArray, Indices
from faultline.service.logs.batch import CLASSIC_BYTES, ERROR, EXTENDED, FD_BYTES, REMOTE, Batch, Bytes, empty
from faultline.service.logs.channels import Channels
from faultline.service.logs.digits import WIDTH, Words, decimal, hexadecimal
from faultline.service.logs.report import LogReport

LONGEST_LINE = 4096
"""A line of more bytes is no frame's, and is rejected unread."""
EXAMPLES = 12
"""Lines of one length that are kept as examples; what is like none of them is read by the grammar."""
FEW = 4
"""So few lines of one length are read by the grammar at once."""

Span = tuple[int, int]
Ints = npt.NDArray[np.int64]
Lines = npt.NDArray[np.void]
"""The characters of N lines, behind `WIDTH` more (N,)."""


class Fields(NamedTuple):
    """Where the fields of a line are: first character and the one beyond the last.

    `time` are digits with one point; `identifier` hexadecimal digits; `data` hexadecimal digits, two for a byte, and
    `stride` characters from one byte to the next. `number` are digits, `free` any characters, which are not used.
    """

    time: Span
    identifier: Span
    data: Span
    stride: int = 2
    number: Span = (0, 0)
    free: Span = (0, 0)


class Line(NamedTuple):
    """What a line holds: its channel's name, time [s], identifier, flags (`logs.batch`) and data.

    `fields` are where they stand, where other lines may be read like this one.
    """

    channel: bytes
    time: float
    identifier: int
    flags: int
    data: bytes
    fields: Fields | None = None


Grammar = Callable[[bytes], Line | None]
"""Reads a line; None where it holds no frame; raises `ValueError` where it should and cannot be read."""


def checked(line: Line) -> Line:
    """The line; raises `ValueError` where its identifier or time cannot be a frame's."""
    top, bits = (EXTENDED_TOP, 29) if line.flags & EXTENDED else (STANDARD_TOP, 11)
    if line.identifier > top:
        raise ValueError(f"identifier {line.identifier:X} has more than {bits} bits")
    if not isfinite(line.time):
        raise ValueError(f"its time is {line.time}")
    return line


class TextReader:
    """Reads pieces of whole lines. State: the examples by length, and how many lines there were."""

    def __init__(self, grammar: Grammar, report: LogReport, channels: Channels) -> None:
        self._grammar, self._report, self._channels = grammar, report, channels
        self._examples: dict[int, list[_Example]] = {}
        self._lines = 0

    def read(self, text: bytes) -> Batch:
        """The frames of a piece that ends with a line's end."""
        text = b"".join((bytes(WIDTH), text, bytes(LONGEST_LINE)))
        content = np.frombuffer(text, np.uint8)
        ends = np.flatnonzero(content == 0x0A)
        starts = np.concatenate([[WIDTH], ends[:-1] + 1]) if len(ends) else ends
        lengths = ends - starts
        found = _Found(len(ends))
        for length in np.flatnonzero(np.bincount(lengths)).tolist() if len(lengths) else []:
            same = len(lengths) * length == int(lengths.sum()) and bool((lengths == length).all())
            rows = np.arange(len(ends)) if same else np.flatnonzero(lengths == length)
            self._alike(text, starts, rows, length, found)
        self._lines += len(ends)
        return found.batch()

    def last(self, line: bytes) -> Batch:
        """The frame of a last line that has no end; raises `ValueError` where it cannot be read."""
        self._lines += 1
        found = _Found(1)
        if (read := self._grammar(line.strip())) is not None:
            found.put(0, checked(read), self._channels.index(read.channel), self._report)
        return found.batch()

    def _alike(self, text: bytes, starts: Ints, rows: Indices, length: int, found: "_Found") -> None:
        """The lines of one length."""
        examples = self._examples.setdefault(length, [])
        for example in examples:
            if len(rows) == 0:
                return
            rows = example.read(text, starts, rows, found)
        while len(rows):
            first, rows = int(rows[0]), rows[1:]
            example = self._one(text[starts[first] : starts[first] + length], first, found)
            if example is not None and len(rows) >= FEW and len(examples) < EXAMPLES:
                examples.append(example)
                rows = example.read(text, starts, rows, found)

    def _one(self, line: bytes, row: int, found: "_Found") -> "_Example | None":
        """A line by the grammar, and what it is an example of."""
        number = self._lines + row + 1
        if len(line) > LONGEST_LINE:
            self._report.reject(number, f"a line of {len(line)} bytes")
            return None
        try:
            read = self._grammar(line)
            if read is None:
                return None
            channel = self._channels.index(checked(read).channel)
        except ValueError as error:
            self._report.reject(number, str(error))
            return None
        found.put(row, read, channel, self._report)
        return None if read.fields is None else _Example(line, read, read.fields, channel)


class _Found:
    """The frames of a piece by line."""

    def __init__(self, count: int) -> None:
        self._batch, self._there = empty(count), np.zeros(count, dtype=np.bool_)
        self._whole: Batch | None = None

    def put(self, row: int, line: Line, channel: int, report: LogReport) -> None:
        """The frame of one line."""
        report.remote += bool(line.flags & REMOTE)
        report.errors += bool(line.flags & ERROR)
        self._wide(len(line.data))
        batch = self._batch
        batch.time[row], batch.channel[row], batch.identifier[row] = line.time, channel, line.identifier
        batch.flags[row], batch.length[row] = line.flags, len(line.data)
        batch.data[row, : len(line.data)] = np.frombuffer(line.data, np.uint8)
        self._there[row] = True

    def fill(
        self, rows: Indices, example: "_Example", time: FloatArray, identifier: npt.NDArray[np.uint32], data: Bytes
    ) -> None:
        """The frames of many lines."""
        length = data.shape[1]
        self._wide(length)
        batch = self._batch
        at: Indices | slice = slice(None) if len(rows) == len(batch) else rows
        batch.time[at], batch.channel[at], batch.identifier[at] = time, example.channel, identifier
        batch.flags[at], batch.length[at] = example.flags, length
        batch.data[at, :length] = data
        self._there[at] = True

    def batch(self) -> Batch:
        """All of them."""
        return self._batch if self._there.all() else self._batch[self._there]

    def _wide(self, length: int) -> None:
        if length > self._batch.data.shape[1]:
            before = self._batch
            wide = empty(len(before), FD_BYTES)
            wide.data[:, :CLASSIC_BYTES] = before.data
            self._batch = Batch(
                before.time, before.channel, before.identifier, before.flags, before.length, wide.data
            )


class _Example:
    """A line by which others are read."""

    def __init__(self, line: bytes, read: Line, fields: Fields, channel: int) -> None:
        self.channel, self.flags = channel, read.flags
        self._fields, self._bytes = fields, len(read.data)
        self._width = -(-len(line) // WIDTH) * WIDTH
        begin, end = fields.time
        point = line.index(b".", begin, end)
        self._seconds, self._parts = (begin, point), (point + 1, end)
        pairs = [(at, at + 2) for at in range(*fields.data, fields.stride)]
        varying = [self._seconds, self._parts, fields.identifier, fields.number, fields.free, *pairs]
        keep = bytearray(b"\xff" * len(line))
        for first, beyond in varying:
            keep[first:beyond] = bytes(beyond - first)
        self._keep, self._fixed = (
            np.frombuffer(bytes(each).ljust(self._width, b"\0"), np.uint64) for each in (keep, line)
        )
        self._fixed = self._fixed & self._keep
        self._top = EXTENDED_TOP if read.flags & EXTENDED else STANDARD_TOP

    def read(self, text: bytes, starts: Ints, rows: Indices, found: _Found) -> Indices:
        """Puts the frames of the lines that are like this one; returns the others.

        `text` has `WIDTH` bytes before the first line and behind the last.
        """
        before = WIDTH + self._width
        lines = np.ndarray((len(text) - before + 1,), f"V{before}", text, strides=(1,))[starts[rows] - WIDTH]
        bad = self._others(lines)
        time, wrong = self._time(lines)
        bad |= wrong
        identifier, wrong = hexadecimal(_words(lines, self._fields.identifier), _size(self._fields.identifier))
        identifier = identifier.byteswap()
        bad |= wrong
        bad |= (identifier > self._top).astype(np.uint64)
        data = self._data(lines, bad)
        if self._fields.number[1]:
            bad |= _decimal(lines, self._fields.number)[1]
        if not bad.any():
            found.fill(rows, self, time, identifier, data)
            return rows[:0]
        good = bad == 0
        found.fill(rows[good], self, time[good], identifier[good], data[good])
        return rows[~good]

    def _others(self, lines: Lines) -> Words:
        """Not zero where another character is than the example's outside of its fields (N,)."""
        words = lines.view(np.uint64).reshape(len(lines), -1)
        bad = np.zeros(len(lines), dtype=np.uint64)
        for k in np.flatnonzero(self._keep).tolist():
            bad |= (words[:, k + 1] & self._keep[k]) ^ self._fixed[k]
        return bad

    def _time(self, lines: Lines) -> tuple[FloatArray, Words]:
        """As `float` reads it: a whole number divided by a power of ten is rounded once."""
        seconds, bad = _decimal(lines, self._seconds)
        parts, worse = _decimal(lines, self._parts)
        power = 10 ** _size(self._parts)
        if int(seconds.max(initial=np.uint64(0))) * power < 2**53:
            return (seconds * np.uint64(power) + parts).astype(np.float64) / float(power), bad | worse
        return seconds.astype(np.float64) + parts.astype(np.float64) / float(power), bad | worse

    def _data(self, lines: Lines, bad: Words) -> Bytes:
        """The bytes (N, length); sets bits of `bad` where they are none."""
        begin, _ = self._fields.data
        data = np.zeros((len(lines), -(-self._bytes // 4)), dtype="<u4")
        if self._fields.stride != 2:
            lines, begin = _closed_up(lines, self._fields.data, self._fields.stride), 0
        for k in range(data.shape[1]):
            first, last = begin + WIDTH * k, begin + min(WIDTH * (k + 1), 2 * self._bytes)
            four, wrong = hexadecimal(_words(lines, (first, last)), last - first)
            data[:, k] = four >> np.uint32(4 * (WIDTH - (last - first)))
            bad |= wrong
        return data.view(np.uint8)[:, : self._bytes]


def _size(span: Span) -> int:
    return span[1] - span[0]


def _words(lines: Lines, span: Span) -> Words:
    """The eight characters (N,) that end with a field of at most eight."""
    kind = np.dtype({"names": ["word"], "formats": ["<u8"], "offsets": [span[1]], "itemsize": lines.dtype.itemsize})
    return np.asarray(lines.view(kind)["word"].copy())


def _decimal(lines: Lines, span: Span) -> tuple[Words, Words]:
    """The numbers of a field of decimal digits, and what is not zero where it holds others."""
    begin, end = span
    number, bad = decimal(_words(lines, (max(begin, end - WIDTH), end)), min(WIDTH, end - begin))
    if end - begin > WIDTH:
        more, worse = _decimal(lines, (begin, end - WIDTH))
        return more * np.uint64(10**WIDTH) + number, bad | worse
    return number, bad


def _closed_up(lines: Lines, span: Span, stride: int) -> Lines:
    """The digits of data alone, without what stands between its bytes, behind `WIDTH` bytes as in `lines`."""
    count = -(-_size(span) // stride)
    closed = np.zeros((len(lines), WIDTH + -(-2 * count // WIDTH) * WIDTH), dtype=np.uint8)
    raw = lines.view(np.uint8).reshape(len(lines), -1)
    for k in range(count):
        at = WIDTH + span[0] + stride * k
        closed[:, WIDTH + 2 * k : WIDTH + 2 * k + 2] = raw[:, at : at + 2]
    return closed.view(f"V{closed.shape[1]}").reshape(len(lines))
