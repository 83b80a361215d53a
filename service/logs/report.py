"""Frames of a log, and the report of what was lost, in every format."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import isfinite
from typing import NamedTuple

from faultline.service.core.errors import InputError
from faultline.service.core.signals.decode import EXTENDED, STANDARD

STEP_BACK_S = 1.0
"""Frames of two interfaces may be written this far out of order [s]; more is a clock that was set back."""

STEP_AHEAD_S = 3600.0
"""No pause within a drive is longer [s]; more is a clock that was set, as where there is none at start-up."""

_TOLD = 3  # bad places whose number and reason are kept


class LogError(InputError):
    """File that is not a log, or recording that is not complete."""


class Frame(NamedTuple):
    """A data frame: time `t` [s], identifier without flags, whether it has 29 bits, and up to 64 bytes."""

    t: float
    can_id: int
    is_extended: bool
    data: bytes


OnChannel = tuple[bytes, Frame]
"""A frame and the name of its channel, as the file has it; empty where the format names none."""


Wanted = Callable[[int, bool], bool]
"""True of identifiers (and whether they have 29 bits) that matter."""


def anything(_can_id: int, _is_extended: bool) -> bool:
    """Return True: all identifiers are wanted."""
    return True


@dataclass
class LogReport:
    """Report of what was read and what was not.

    `bad` are places that could not be read, `told` the first few of them as (number, reason), numbered by `unit`: line,
    byte or row. `truncated`: the last line has no end and was not used, as a frame cut short may look whole. `missing`
    says how the file itself shows that its end is missing; empty where it does not. Skipped are frames without data
    (`remote`, `errors`) and `others`, objects that are no frames. `clock_steps`: times of the log that the reader
    moved, because the clock was set while it was recorded. `length_s` [s] was read, of `said_s` [s] by the file's own
    header if that says so. `channels` are the (identifier, has 29 bits) that came on each channel of the file.
    """

    frames: int = 0
    bad: int = 0
    told: list[tuple[int, str]] = field(default_factory=list)
    unit: str = "line"
    truncated: bool = False
    missing: str = ""
    remote: int = 0
    errors: int = 0
    others: int = 0
    clock_steps: int = 0
    length_s: float = 0.0
    said_s: float | None = None
    channels: dict[str, set[tuple[int, bool]]] = field(default_factory=dict)

    @property
    def damaged(self) -> bool:
        """True if something inside the log could not be read, or its end is known to be missing."""
        return bool(self.bad or self.missing)

    @property
    def lost(self) -> bool:
        """True if anything of the log could not be used as it stands."""
        return bool(self.damaged or self.truncated or self.clock_steps)

    @property
    def span(self) -> str:
        """Return the part of the log that was read, in log time."""
        said = f" of {self.said_s:.1f} s" if self.said_s is not None and self.said_s > self.length_s + 0.1 else ""
        return f"0.0 to {self.length_s:.1f} s{said}"

    def summary(self) -> str:
        """Return one sentence for the user."""
        parts = [f"{self.frames} frames read, from {self.span}"]
        if self.bad:
            places = "; ".join(f"{self.unit} {number}: {reason}" for number, reason in self.told)
            more = "; ..." if self.bad > len(self.told) else ""
            what = "places" if self.unit == "byte" else f"{self.unit}s"
            parts.append(f"{self.bad} {what} could not be read ({places}{more})")
        if self.missing:
            parts.append(f"the end is missing: {self.missing}")
        if self.truncated:
            parts.append("the last line is cut off and was not used")
        if self.clock_steps:
            parts.append(f"the clock was set {self.clock_steps} times, later times were moved")
        if self.remote or self.errors:
            parts.append(f"{self.remote} remote and {self.errors} error frames skipped")
        if self.others:
            parts.append(f"{self.others} objects that are no frames skipped")
        return ", ".join(parts)

    def on_two_channels(self, wanted: Wanted = anything) -> list[str]:
        """Return the channels of the first `wanted` identifier that comes on more than one; empty where none does."""
        of: dict[tuple[int, bool], list[str]] = {}
        for channel, identifiers in self.channels.items():
            for each in identifiers:
                of.setdefault(each, []).append(channel)
        both = (channels for each, channels in sorted(of.items()) if len(channels) > 1 and wanted(*each))
        return next(both, [])

    def reject(self, number: int, reason: str) -> None:
        """Count a place that cannot be read."""
        self.bad += 1
        if len(self.told) < _TOLD:
            self.told.append((number, reason))


def read_lines(content: bytes, report: LogReport, take: Callable[[bytes], OnChannel | None]) -> Iterator[OnChannel]:
    """Yield the frames of a text whose lines say how many bytes they hold, so that the last needs no newline.

    `take` gives the frame of a line, None where it has none, and raises `ValueError` where it cannot be read.
    """
    lines = content.split(b"\n")
    report.truncated = lines[-1].isspace()  # what it would begin with is gone
    for number, line in enumerate(lines, start=1):
        try:
            found = take(line.strip())
            if found is not None:
                _check(found[1])
        except ValueError as error:
            if number == len(lines):
                report.truncated = True
            else:
                report.reject(number, str(error))
        else:
            if found is not None:
                yield found


def _check(frame: Frame) -> None:
    if frame.can_id > (EXTENDED if frame.is_extended else STANDARD):
        raise ValueError(f"identifier {frame.can_id:X} has more than {29 if frame.is_extended else 11} bits")
    if not isfinite(frame.t):
        raise ValueError(f"its time is {frame.t}")


def shown(line: bytes) -> str:
    """Return the beginning of a line, for an error."""
    return repr(line[:40].decode("ascii", "replace"))


def in_order(frames: list[Frame], report: LogReport) -> list[Frame]:
    """Return the frames with times that never go back and never leap: detectors live on differences of time."""
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
