"""The units in which people read the quantities of a system, as its bundle says them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Protocol, TypeVar

import msgspec
from msgspec import Meta

if TYPE_CHECKING:  # processes that only forward do without numpy
    import numpy as np
    import numpy.typing as npt

Value = TypeVar("Value", float, "npt.NDArray[np.float64]")

SMALL = 0.04
"""In parts of a unit: what stays below is read in a finer one, where there is one."""


class Display(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A unit that people read.

    >>> Display(unit="bar", size=1e5, digits=3).text(1012345.0), Display(unit="1").text(0.5)
    ('10.123 bar', '0.5')
    """

    unit: Annotated[str, Meta(description="its name", pattern=r"\A[^\x00-\x1f\x7f]*\Z", max_length=80)]
    size: Annotated[float, Meta(description="one of it, in the bundle's unit", gt=0)] = 1.0
    zero: Annotated[float, Meta(description="none of it, in the bundle's unit: 273.15 of degC in K")] = 0.0
    digits: Annotated[
        Annotated[int, Meta(ge=0, le=12)] | None, Meta(description="behind the point; null: six in all")
    ] = None

    def scaled(self, value: Value) -> Value:
        """Return a value, or an array, of the bundle's unit in this one."""
        return (value - self.zero) / self.size

    def number(self, value: float | None) -> str:
        """Return a value of the bundle's unit as a number in this one, `-` where there is none."""
        if value is None:
            return "-"
        return f"{self.scaled(value):.6g}" if self.digits is None else f"{self.scaled(value):.{self.digits}f}"

    def text(self, value: float | None) -> str:
        """Return a value of the bundle's unit as a number with this one; a plain number has none."""
        return f"{self.number(value)} {self.after}".rstrip()

    def short(self, value: float) -> str:
        """Return a value of the bundle's unit with three digits and this one."""
        return f"{self.scaled(value):.3g} {self.after}".rstrip()

    def difference(self, value: float) -> str:
        """Return a difference of values with three digits and this one: another zero makes none."""
        return f"{value / self.size:.3g} {self.after}".rstrip()

    @property
    def after(self) -> str:
        """What follows a number: nothing where the unit is 1."""
        return "" if self.unit == "1" else self.unit


class Channel(Protocol):
    """A signal with its name, unit, label and the units that it is read in."""

    @property
    def signal(self) -> str:
        """The name."""

    @property
    def unit(self) -> str:
        """The bundle's unit."""

    @property
    def label(self) -> str:
        """The name for people, empty where there is none."""

    @property
    def display(self) -> Sequence[Display]:
        """The units for people, coarse to fine; none: the bundle's."""


def display_of(channel: Channel, size: float = float("inf")) -> Display:
    """Return the unit in which a signal is read, for values up to `size`."""
    return fitting(channel.display or [Display(unit=channel.unit)], size)


def fitting(displays: Sequence[Display], size: float) -> Display:
    """Return the coarsest of some units in which values up to `size` do not get too small, else the finest."""
    return next((each for each in displays if size >= SMALL * each.size), displays[-1])


def titled(channel: Channel) -> str:
    """Return what a signal is called: its label with its name, or the name alone."""
    return f"{channel.label} ({channel.signal})" if channel.label else channel.signal
