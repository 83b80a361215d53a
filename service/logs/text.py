"""Lines of a text log to columns: one line is read by its format's grammar, and all that are alike by its example.

A logger writes line after line with its fields in the same places. So the grammar (a regular expression, strict) reads
one line and says where its fields are; every other line of the same length that has the same characters outside of
them, and digits inside, is read with array operations (`logs.example`). A line that is not like any before is read by
the grammar, and becomes an example. The result is what the grammar alone gives, line by line.

Lines that change how those behind them are read, as a header does, divide the text into sections that are read one
after the other.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import isinf
from typing import Protocol

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.values import Indices
from faultline.service.logs.batch import CLASSIC_BYTES, EXTENDED, EXTENDED_TOP, FD_BYTES, TOP, Batch, empty
from faultline.service.logs.channels import Channels
from faultline.service.logs.example import Example, Line, Span
from faultline.service.logs.lines import BEFORE, BEHIND, LONGEST_LINE, WholeLines
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogReport

EXAMPLES = 12
"""Lines of one length that are kept as examples: those that were of use last."""
FEW = 4
"""So few lines of one length are read by the grammar at once."""
TIME_ONLY = 128
"""Flag of a line without a frame whose time counts, where each time is that after the line before."""

Ints = npt.NDArray[np.int64]


class Dialect(Protocol):
    """A text format: how its lines are read. State: what its header lines said so far."""

    @property
    def headers(self) -> tuple[bytes, ...]:
        """How lines begin that change how later ones are read; matched as they are."""

    @property
    def needs_newline(self) -> bool:
        """True if a line does not say how many bytes it has, so that one without its end may be cut off."""

    @property
    def is_relative(self) -> bool:
        """True if each time is that after the line before."""

    def header(self, line: bytes) -> None:
        """Read a line that begins like one of `headers`; raises `ValueError` where it cannot be read."""

    def read(self, line: bytes) -> Line | None:
        """Read any other line: the grammar. None where it holds no frame.

        Raises:
            ValueError: it should hold one and cannot be read.
        """

    def end(self, report: LogReport) -> None:
        """Say in the report what is missing, once all lines were read."""


_MARK = b"\xef\xbb\xbf"  # an editor's byte order mark


def read_text(source: Source, report: LogReport, channels: Channels, dialect: Dialect) -> Iterator[Batch]:
    """The frames of a log, a batch for each piece of the file."""
    reader, lines = TextReader(dialect, report, channels), WholeLines(report)
    for number, piece in enumerate(source.pieces(report)):
        if text := lines.take(piece if number else piece.removeprefix(_MARK)):
            yield from reader.read(text)
        if lines.is_endless:
            report.missing = "no line ends within 64 MiB"
            return
    if report.packing:  # its last line may be cut off anywhere
        report.truncated = bool(lines.rest)
    else:
        yield from reader.last(lines.rest)
    dialect.end(report)


def checked(line: Line) -> Line:
    """The line; raises `ValueError` where its identifier or time cannot be a frame's."""
    top, bits = (EXTENDED_TOP, 29) if line.flags & EXTENDED else (TOP, 11)
    if line.identifier > top:
        raise ValueError(f"identifier {line.identifier:X} has more than {bits} bits")
    if isinf(line.time):
        raise ValueError(f"its time is {line.time}")
    return line


class TextReader:
    """Reads text that ends with a line's end. State: the examples by length, the lines so far, the last time [s]."""

    def __init__(self, dialect: Dialect, report: LogReport, channels: Channels) -> None:
        self._dialect, self._report, self._channels = dialect, report, channels
        self._examples: dict[int, list[Example]] = {}
        self._lines = 0
        self._last_s = 0.0
        self._bad: list[tuple[int, str, int]] = []

    def read(self, text: bytes) -> Iterator[Batch]:
        """The frames of whole lines, of a text between `BEFORE` and `BEHIND`."""
        for header, (begin, end) in sections(text, self._dialect.headers):
            if header:
                self._header(header)
            if begin < end:
                yield from self._given(self._body(text, begin, end))
        self._report_bad()

    def last(self, line: bytes) -> Iterator[Batch]:
        """The frame of a last line that has no end, where it shows that it is whole."""
        if not line:
            return
        if self._dialect.needs_newline or line.isspace():
            self._report.truncated = True
            return
        if line.startswith(self._dialect.headers):
            self._header(line)
            return
        found = _Found(1)
        try:
            self._put(line, 0, found)
        except ValueError:
            self._report.truncated = True
        yield from self._given(found.batch())

    def _header(self, line: bytes) -> None:
        self._lines += 1
        try:
            self._dialect.header(line.strip())
        except ValueError as error:
            self._bad.append((self._lines, str(error), len(line)))
        self._examples.clear()

    def _given(self, batch: Batch) -> Iterator[Batch]:
        """The batch with times summed up where they are relative, without lines of which only the time counts."""
        if self._dialect.is_relative and len(batch):
            times = np.add.accumulate(np.concatenate([[self._last_s], batch.time]))  # one after the other, as a loop
            self._last_s = float(times[-1])
            batch = replace(batch, time=times[1:])[batch.flags & TIME_ONLY == 0]
        if len(batch):
            yield batch

    def _body(self, text: bytes, begin: int, end: int) -> Batch:
        """The frames of lines without headers."""
        ends = np.flatnonzero(np.frombuffer(text, np.uint8, end - begin, begin) == 0x0A) + begin
        starts = np.concatenate([[begin], ends[:-1] + 1])
        lengths = ends - starts
        found, known = _Found(len(ends)), len(self._channels.names)
        if (lengths == lengths[0]).all():
            self._alike(text, starts, np.arange(len(ends)), int(lengths[0]), found)
        else:
            order = np.argsort(lengths, kind="stable")
            cuts = np.flatnonzero(np.diff(lengths[order])) + 1
            for rows in np.split(order, cuts):
                self._alike(text, starts, rows, int(lengths[rows[0]]), found)
        self._lines += len(ends)
        batch = found.batch()
        if len(self._channels.names) > known + 1:  # lines of one length were read before those of others
            batch = replace(batch, channel=self._channels.came_in_order(known, batch.channel))
        return batch

    def _alike(self, text: bytes, starts: Ints, rows: Indices, length: int, found: "_Found") -> None:
        """The lines of one length."""
        examples = self._examples.setdefault(length, [])
        for example in [*examples]:
            if len(rows) < FEW:
                break
            left = example.read(text, starts, rows, found.fill)
            if len(left) < len(rows):
                examples.remove(example)
                examples.insert(0, example)
            rows = left
        misses = 0
        while len(rows):
            first, rows = int(rows[0]), rows[1:]
            line = self._one(text[starts[first] : starts[first] + length], first, found)
            if line is not None and line.fields is not None and len(rows) >= FEW and misses < EXAMPLES:
                example = Example(text[starts[first] : starts[first] + length], line, self._channels)
                left = example.read(text, starts, rows, found.fill)
                misses = misses + 1 if len(left) == len(rows) else 0
                if not misses:
                    examples[EXAMPLES - 1 :] = []
                    examples.insert(0, example)
                rows = left
        if not examples:
            del self._examples[length]

    def _one(self, line: bytes, row: int, found: "_Found") -> Line | None:
        """A line by the grammar."""
        number = self._lines + row + 1
        rest = (line.lstrip(b"\0") or line) if line.startswith(b"\0") else line
        zeros = len(line) - len(rest)
        try:
            read = self._put(rest, row, found)
        except ValueError as error:
            self._reject(number, str(error), len(line))
            return None
        if zeros:  # as a cut of the power leaves them in a file that is appended to afterwards
            self._reject(number, "zeros", zeros)
            return None
        return read

    def _put(self, line: bytes, row: int, found: "_Found") -> Line | None:
        if len(line) > LONGEST_LINE:
            raise ValueError(f"a line of {len(line)} bytes")
        read = self._dialect.read(line)
        if read is not None:
            found.put(row, checked(read), self._channels.index(read.channel))
        return read

    def _reject(self, number: int, reason: str, size: int) -> None:
        self._bad.append((number, reason, size))
        if len(self._bad) > 1000:
            self._report_bad()

    def _report_bad(self) -> None:
        """Lines of one length come together: sort their numbers."""
        for number, reason, size in sorted(self._bad):
            self._report.reject(number, reason, size)
        self._bad.clear()


def sections(text: bytes, headers: tuple[bytes, ...]) -> Iterator[tuple[bytes, Span]]:
    """Each header line, empty before the first one, with where the lines behind it are."""
    first, beyond = len(BEFORE), len(text) - len(BEHIND)
    begins = sorted(at for header in headers for at in _line_starts(text, header))
    yield b"", (first, begins[0] if begins else beyond)
    for begin, end in pairwise([*begins, beyond]):
        body = text.index(b"\n", begin) + 1
        yield text[begin : body - 1], (body, end)


def _line_starts(text: bytes, beginning: bytes) -> Iterator[int]:
    at = text.find(b"\n" + beginning)
    while at >= 0:
        yield at + 1
        at = text.find(b"\n" + beginning, at + 1)


class _Found:
    """The frames of a text by line: those of many lines are columns at once, those of single ones are at the end."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._parts: list[tuple[Indices, Batch]] = []
        self._rows: list[int] = []
        self._lines: list[tuple[Line, int]] = []

    def put(self, row: int, line: Line, channel: int) -> None:
        """The frame of one line."""
        self._rows.append(row)
        self._lines.append((line, channel))

    def fill(self, rows: Indices, part: Batch) -> None:
        """The frames of many lines."""
        self._parts.append((rows, part))

    def batch(self) -> Batch:
        """All of them in the order of the lines."""
        if self._rows:
            order = sorted(range(len(self._rows)), key=self._rows.__getitem__)
            self._parts.append((np.sort(self._rows), _columns([self._lines[k] for k in order])))
        if len(self._parts) == 1:
            return self._parts[0][1]
        width = max((part.data.shape[1] for _, part in self._parts), default=0)
        batch, there = (
            empty(self._count, FD_BYTES if width > CLASSIC_BYTES else CLASSIC_BYTES),
            np.zeros(self._count, dtype=np.bool_),
        )
        for rows, part in self._parts:
            batch.put(rows, part)
            there[rows] = True
        return batch if there.all() else batch[there]


def _columns(lines: list[tuple[Line, int]]) -> Batch:
    width = FD_BYTES if any(len(line.data) > CLASSIC_BYTES for line, _ in lines) else CLASSIC_BYTES
    raw = b"".join([line.data.ljust(width, b"\0") for line, _ in lines])
    return Batch(
        np.array([line.time for line, _ in lines]),
        np.array([channel for _, channel in lines], dtype=np.uint8),
        np.array([line.identifier for line, _ in lines], dtype=np.uint32),
        np.array([line.flags for line, _ in lines], dtype=np.uint8),
        np.array([len(line.data) for line, _ in lines], dtype=np.uint8),
        np.frombuffer(raw, np.uint8).reshape(len(lines), width),
    )
