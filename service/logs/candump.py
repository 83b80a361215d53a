"""Reads candump's text logs and salvages: a bad line costs that line, never what follows it.

A line is `(1767225600.123456) can0 18FF103D#0011223344556677`; 3 digits of identifier are an 11-bit frame, 8 are a
29-bit one; `##F` with flags F before the data is CAN FD. Source of the format: can-utils, `candump -L`, lib.c.
"""

import re
from binascii import unhexlify
from dataclasses import dataclass, field
from typing import NamedTuple

from service.core.errors import InputError

EXAMPLE = "(1767225600.123456) can0 18FF103D#0011223344556677"

STEP_BACK_S = 1.0
"""Frames of two interfaces may be written this far out of order [s]; more is a clock that was set back."""

STEP_AHEAD_S = 3600.0
"""No pause within a drive is longer [s]; more is a clock that was set, as where there is none at start-up."""

_CLASSIC = re.compile(
    rb"\((\d+\.\d+)\) +\S+ +([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#([0-9A-Fa-f]{0,16})(?:_[0-9A-Fa-f])?(?: [RT])?\s*"
)
_FD = re.compile(rb"\((\d+\.\d+)\) +\S+ +([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})##[0-9A-Fa-f]([0-9A-Fa-f]{0,128})(?: [RT])?\s*")
_REMOTE = re.compile(rb"\(\d+\.\d+\) +\S+ +(?:[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#R[0-9A-Fa-f]*(?: [RT])?\s*")
_STAMP = re.compile(rb"\(\d+\.\d+\) +\S+ +")

_FD_SIZES = frozenset([*range(9), 12, 16, 20, 24, 32, 48, 64])  # bytes, ISO 11898-1
_ERROR_FLAG = 0x2000_0000
_EXTENDED_TOP = 0x1FFF_FFFF
_TOLD = 3  # bad lines whose number and reason are kept


class LogError(InputError):
    """A file that is not a log, or a recording that is not whole."""


class Frame(NamedTuple):
    """A data frame: time `t` [s], identifier without flags, whether it has 29 bits, and up to 64 bytes."""

    t: float
    can_id: int
    is_extended: bool
    data: bytes


@dataclass
class LogReport:
    """What was read and what was not.

    `told` are the first few bad lines as (number, reason); `truncated`: the last line has no end and was not used, as a
    frame cut short may look whole; `remote` and `errors`: frames without data, which are skipped; `clock_steps`: times
    of the log that the reader moved, because the clock was set while it was recorded.
    """

    frames: int = 0
    bad: int = 0
    told: list[tuple[int, str]] = field(default_factory=list)
    truncated: bool = False
    remote: int = 0
    errors: int = 0
    clock_steps: int = 0

    @property
    def lost(self) -> bool:
        """Whether anything of the log could not be used as it stands."""
        return bool(self.bad or self.truncated or self.clock_steps)

    def summary(self) -> str:
        """One sentence for the user."""
        parts = [f"{self.frames} frames read"]
        if self.bad:
            places = "; ".join(f"line {number}: {reason}" for number, reason in self.told)
            parts.append(f"{self.bad} lines could not be read ({places}{'; ...' if self.bad > len(self.told) else ''})")
        if self.truncated:
            parts.append("the last line is cut off and was not used")
        if self.clock_steps:
            parts.append(f"the clock was set {self.clock_steps} times, later times were moved")
        if self.remote or self.errors:
            parts.append(f"{self.remote} remote and {self.errors} error frames skipped")
        return ", ".join(parts)

    def reject(self, number: int, reason: str) -> None:
        """Counts a line that cannot be read."""
        self.bad += 1
        if len(self.told) < _TOLD:
            self.told.append((number, reason))


def parse_candump(content: bytes, where: str) -> tuple[list[Frame], LogReport]:
    """The data frames of a log in time order, and what was lost; `where` names it in errors.

    Raises:
        LogError: it holds no frame.
    """
    report = LogReport()
    lines = content.split(b"\n")
    report.truncated = bool(lines.pop())
    frames: list[Frame] = []
    for number, line in enumerate(lines, start=1):
        match = _CLASSIC.fullmatch(line)
        if match is None or len(match[3]) % 2:  # half a byte is no data
            frame = _other(number, line, report)
            if frame is None:
                continue
        else:
            stamp, identifier, data = match.groups()
            frame = Frame(float(stamp), int(identifier, 16), len(identifier) == 8, unhexlify(data))
            if frame.can_id > _EXTENDED_TOP:
                _flagged(number, frame, report)
                continue
        frames.append(frame)
    if not frames:
        raise LogError(_no_log(content, where, report))
    report.frames = len(frames)
    return in_order(frames, report), report


def _other(number: int, line: bytes, report: LogReport) -> Frame | None:
    """A line that is no classic data frame: CAN FD, or counted for what it is."""
    match = _FD.fullmatch(line)
    if match is not None:
        stamp, identifier, data = match.groups()
        if len(data) / 2 in _FD_SIZES and int(identifier, 16) <= _EXTENDED_TOP:
            return Frame(float(stamp), int(identifier, 16), len(identifier) == 8, unhexlify(data))
        report.reject(number, f"no CAN FD frame has {len(data) / 2:g} bytes under identifier {identifier.decode()}")
    elif _REMOTE.fullmatch(line):
        report.remote += 1
    elif line.strip():
        report.reject(number, _reason(line))
    return None


def _flagged(number: int, frame: Frame, report: LogReport) -> None:
    if frame.can_id & _ERROR_FLAG:
        report.errors += 1
    else:
        report.reject(number, f"identifier {frame.can_id:08X} has more than 29 bits")


def _reason(line: bytes) -> str:
    shown = repr(line[:40].decode("ascii", "replace"))
    return f"no frame after the time in {shown}" if _STAMP.match(line) else f"no candump line: {shown}"


def _no_log(content: bytes, where: str, report: LogReport) -> str:
    remedy = f"a candump line looks like `{EXAMPLE}`"
    if not content.strip():
        return f"{where}: is empty; {remedy}"
    if report.told:
        number, reason = report.told[0]
        return f"{where}: line {number}: not a CAN log, {reason}; {remedy}"
    if report.truncated and not (report.remote or report.errors):
        return f"{where}: line 1: its only line is cut off; {remedy}"
    return f"{where}: holds no data frame; {remedy}"


def in_order(frames: list[Frame], report: LogReport) -> list[Frame]:
    """The frames with times that never go back and never leap: detectors live on differences of time."""
    ordered: list[Frame] = []
    shift = 0.0
    last = frames[0].t
    for frame in frames:
        t = frame.t + shift
        if not -STEP_BACK_S <= t - last <= STEP_AHEAD_S:
            report.clock_steps += 1
            shift += last - t
            t = last
        last = max(t, last)
        ordered.append(frame if last == frame.t else frame._replace(t=last))
    return ordered
