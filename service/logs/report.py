"""A log's frames and what was lost of it, in every format."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from faultline.service.core.errors import InputError

_PLACES = 3  # bad places whose number and reason are kept


class LogError(InputError):
    """A file that is not a log, or a recording that is not whole."""


class Frame(NamedTuple):
    """A data frame: time `t` [s], identifier without flags, whether it has 29 bits, and up to 64 bytes."""

    t: float
    can_id: int
    is_extended: bool
    data: bytes


Wanted = Callable[[int, bool], bool]
"""True of identifiers (and whether they have 29 bits) that matter."""


def anything(_can_id: int, _is_extended: bool) -> bool:
    """All identifiers."""
    return True


@dataclass
class LogReport:
    """What was read and what was not.

    `bad` are places that could not be read, of `lost_bytes` bytes together where that is known, `places` the first few
    of them as (number, reason), numbered by `unit`: line, byte or row. `truncated`: the last line has no end and was
    not used, as a frame cut short may look whole. `missing` says how the file itself shows that its end is missing,
    `packing` how its compression is damaged; empty where they are not. `frames` have data; `remote`, `errors` are
    frames without, and `others` objects that are no frames. `clock_steps`: times of the log that the reader moved,
    because the clock was set while it was recorded; `outliers` are times far from those around them, which were
    replaced. `length_s` [s] was read, of `said_s` [s] by the file's own header
    if that says so. `channels` are the (identifier, has 29 bits) of data frames that came on each channel of the file.
    Of a table, `frames` are its rows; `beside` is the report of a table that belongs to the log.
    """

    frames: int = 0
    what: str = "frames"
    bad: int = 0
    lost_bytes: int = 0
    places: list[tuple[int, str]] = field(default_factory=list)
    unit: str = "line"
    truncated: bool = False
    missing: str = ""
    packing: str = ""
    remote: int = 0
    errors: int = 0
    others: int = 0
    clock_steps: int = 0
    outliers: int = 0
    length_s: float = 0.0
    said_s: float | None = None
    channels: dict[str, set[tuple[int, bool]]] = field(default_factory=dict)
    beside: "LogReport | None" = None

    @property
    def damaged(self) -> bool:
        """True if something inside the log could not be read, or its end is known to be missing."""
        return bool(self.bad or self.missing or self.packing or (self.beside and self.beside.damaged))

    @property
    def lost(self) -> bool:
        """True if anything of the log could not be used as it stands."""
        moved = self.clock_steps or self.outliers
        return bool(self.damaged or self.truncated or moved or (self.beside and self.beside.lost))

    @property
    def span(self) -> str:
        """The part of the log that was read, in log time."""
        said = f" of {self.said_s:.1f} s" if self.said_s is not None and self.said_s > self.length_s + 0.1 else ""
        return f"0.0 to {self.length_s:.1f} s{said}"

    def summary(self) -> str:
        """One sentence for the user."""
        return ", ".join([f"{self.frames} {self.what} read, from {self.span}", *self.losses(), *self.skipped()])

    def losses(self) -> list[str]:
        """What could not be used as it stands, each with where."""
        parts = [f"{self.lost_bytes} bytes are lost"] if self.lost_bytes else []
        if self.bad:
            places = "; ".join(f"{self.unit} {number}: {reason}" for number, reason in self.places)
            more = "; ..." if self.bad > len(self.places) else ""
            what = "places" if self.unit == "byte" else f"{self.unit}s"
            parts.append(f"{self.bad} {what} could not be read ({places}{more})")
        if self.packing:
            parts.append(f"the compression is damaged: {self.packing}")
        if self.missing:
            parts.append(f"the end is missing: {self.missing}")
        if self.truncated:
            parts.append("the last line is cut off and was not used")
        if self.outliers:
            parts.append(f"{self.outliers} times are far from those around them and were replaced")
        if self.clock_steps:
            parts.append(f"the clock was set {self.clock_steps} times, later times were moved")
        if self.beside and self.beside.lost:
            parts.append(f"of the table beside it {', '.join(self.beside.losses())}")
        return parts

    def skipped(self) -> list[str]:
        """What is of no use for signals."""
        parts = []
        if self.remote or self.errors:
            parts.append(f"{self.remote} remote and {self.errors} error frames skipped")
        if self.others:
            parts.append(f"{self.others} objects that are no frames skipped")
        return parts

    def on_two_channels(self, wanted: Wanted = anything) -> list[str]:
        """Return the channels of the first `wanted` identifier that comes on more than one; empty where none does."""
        of: dict[tuple[int, bool], list[str]] = {}
        for channel, identifiers in self.channels.items():
            for each in identifiers:
                of.setdefault(each, []).append(channel)
        both = (channels for each, channels in sorted(of.items()) if len(channels) > 1 and wanted(*each))
        return next(both, [])

    def reject(self, number: int, reason: str, size: int = 0) -> None:
        """Count a place that cannot be read, of `size` bytes."""
        self.bad += 1
        self.lost_bytes += size
        if len(self.places) < _PLACES:
            self.places.append((number, reason))

    def reject_first(self, number: int, reason: str, count: int = 1) -> None:
        """Count `count` of them, with one reason that is shown before those of others."""
        self.bad += count
        self.places = [(number, reason), *self.places][:_PLACES]


def shown(line: bytes) -> str:
    """The beginning of a line, for an error."""
    return repr(line[:40].decode("ascii", "replace"))
