"""What the daemon answers on its control socket (docs/control.md), as far as it is used here.

Fields that are not here are left alone: the daemon may be newer.
"""

from typing import Any

import msgspec

from faultline.service.core.faults import Fault


class _Answer(msgspec.Struct, frozen=True, kw_only=True):
    """Common: by name, and never changed."""


class Condition(_Answer, frozen=True):
    """What keeps the service from telling; `kind` may be one that this version does not know."""

    kind: str
    of: str
    since: str | None = None


class Store(_Answer, frozen=True):
    """Where records are kept (None: nowhere), the number of the last that is, and whether the disk takes none now."""

    path: str | None = None
    kept: int = 0
    failing: bool = False


class Bus(_Answer, frozen=True):
    """A bus and its counts since the service started; `trouble` says in words what is wrong, where something is."""

    name: str
    interface: str = ""
    frames: int = 0
    dropped: int = 0
    errors: int = 0
    trouble: str | bool | list[str] | None = None


class System(_Answer, frozen=True):
    """What a bundle watches, and what its tests say now. `bundle` is the SHA-256 of its manifest."""

    name: str
    bundle: str = ""
    bus: str = ""
    tick: int | None = None
    alarm: list[str] = []
    cannot_tell: list[str] = []
    suspected: bool = False


class State(_Answer, frozen=True):
    """The daemon: its vehicle and version, the operation cycle, and the number of the last record that was told.

    `is_recording`: it is none that listens, but a finished recording.
    """

    source: str
    version: str
    seq: int
    since: str | None = None
    wall: str | None = None
    is_recording: bool = False
    cycle: int = 0
    conditions: list[Condition] = []
    store: Store | None = None
    buses: list[Bus] = []
    systems: list[System] = []


class Memory(_Answer, frozen=True):
    """All that is remembered, and whether something was ever displaced."""

    faults: list[Fault]
    overflow: bool = False


class Frames(_Answer, frozen=True):
    """The freeze frames of a fault, as they are; None where there is none."""

    first: Any = None
    latest: Any = None


class Remembered(_Answer, frozen=True):
    """One fault with its freeze frames."""

    fault: Fault
    frames: Frames = Frames()


class Erased(_Answer, frozen=True):
    """Numbers of the faults that were erased; that is on the disk."""

    cleared: list[int]


class Records(_Answer, frozen=True):
    """What was told, oldest first, as it is."""

    records: list[msgspec.Raw]


class Meaning(_Answer, frozen=True):
    """What a fault's name means."""

    name: str
    component: str = ""
    description: str = ""


class Names(_Answer, frozen=True):
    """The part of a system's description that explains its faults."""

    faults: list[Meaning] = []
