"""What is known of a running service, and all that a screen shows: read strictly from what docs/control.md says."""

from collections.abc import Sequence
from typing import Literal, TypeVar

import msgspec

from faultline.service.core.events import Diagnosis
from faultline.service.core.separating import Separation

T = TypeVar("T")


class Signal(msgspec.Struct, frozen=True):
    """A column of `z`, in its unit."""

    signal: str
    unit: str


class Generator(msgspec.Struct, frozen=True):
    """A residual generator: its test, the signal that it predicts, and its row of the fault signature matrix."""

    test: str
    predicts: str
    faults: list[str]


class Fault(msgspec.Struct, frozen=True):
    """What a fault's name means."""

    name: str
    component: str
    description: str


class Equation(msgspec.Struct, frozen=True):
    """What an equation's name means."""

    name: str
    description: str


class System(msgspec.Struct, frozen=True):
    """What the names of a bundle mean; `period_s` between its ticks."""

    name: str
    period_s: float
    inputs: list[Signal]
    generators: list[Generator]
    faults: list[Fault]
    equations: list[Equation] = []
    bundle: str = ""


class Tick(msgspec.Struct, frozen=True):
    """A live tick at `t_s` [s]: by signal `z` and `quality`, by generator `y_hat`, `usable` and `sums`."""

    t_s: float
    mode: str
    z: list[float | None]
    quality: list[str]
    y_hat: list[float | None]
    usable: list[bool]
    sums: list[float | None]
    alarm: list[str]
    cannot_tell: list[str]
    suspected: bool
    diagnoses: list[Diagnosis]
    separating: list[Separation] = []
    bundle: str = ""


class Condition(msgspec.Struct, frozen=True):
    """What stands; a kind that this version does not know is shown as it is."""

    kind: str
    of: str
    since: str | None = None


class Here(msgspec.Struct, frozen=True):
    """A system that is watched."""

    name: str


class State(msgspec.Struct, frozen=True):
    """What the service says of itself."""

    source: str
    seq: int
    systems: list[Here]
    conditions: list[Condition]


class Seen(msgspec.Struct, frozen=True, kw_only=True):
    """All that a screen shows.

    `connection` is *live* where `tick` is of now, *waiting* where the service is there and gives none, *away* where it
    is not; `why` says so in words. There is no tick but with *live*: what was is not shown as what is.
    """

    connection: Literal["live", "waiting", "away"]
    why: str = ""
    state: State | None = None
    system: System | None = None
    tick: Tick | None = None
    events: tuple[str, ...] = ()


def at(values: Sequence[T], k: int) -> T | None:
    """The value there; None where the service sent fewer."""
    return values[k] if k < len(values) else None
