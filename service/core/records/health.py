"""Conditions that impair the diagnosis, apart from faults of the system: the bus, its frames, its sensors.

A condition is told once it has lasted, and again once it has been gone for a while, so that a loose plug is no storm of
messages. What is told is always everything that stands, not what has changed: whoever comes late knows as much.
"""

from collections.abc import Iterable, Sequence
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

SCHEMA = "faultline.health/1"

BusKind = Literal["bus-down", "bus-removed", "bus-off", "error-passive", "frames-lost"]
MessageKind = Literal["no-traffic", "second-sender", "address-claim", "short-frames", "unknown-selector", "incomplete"]
SignalKind = Literal["missing", "not-available", "error", "out-of-range", "frozen", "jump"]
ServiceKind = Literal["bundle-failed", "bundle-refused", "clients-refused", "memory-failed", "relearning"]
StoreKind = Literal["store-failed", "store-reset", "store-removed", "rows-set-aside"]
Kind = Literal[BusKind, MessageKind, SignalKind, ServiceKind, StoreKind]

MEANINGS: dict[str, str] = {
    "bus-down": "the interface is down",
    "bus-removed": "the interface is not there",
    "bus-off": "the controller has left the bus after too many errors",
    "error-passive": "the controller sees many errors: wiring, termination or bit rate",
    "frames-lost": "frames came faster than they were taken",
    "no-traffic": "not one of the frames that are expected: wrong bus, bit rate or DBC, or the ignition is off",
    "missing": "does not come any more",
    "not-available": "its sender says that it has no value",
    "error": "its sender says that its sensor is at fault, or it is no number",
    "out-of-range": "is outside the range that the DBC gives",
    "frozen": "has not changed for longer than a sensor can",
    "jump": "jumps further than a sensor can",
    "second-sender": "is sent by more than one",
    "address-claim": "has a sender whose address another device has claimed",
    "short-frames": "is shorter than in the DBC",
    "unknown-selector": "is multiplexed by a value that the DBC does not have",
    "incomplete": "comes in parts, and some of them are missing",
    "bundle-failed": "could not be computed, and has begun anew",
    "bundle-refused": "(so this bundle does not run; it is tried again)",
    "store-failed": "cannot be opened or written: what is told is not kept",
    "store-reset": "was damaged; it has been put aside and a new one was begun",
    "clients-refused": "refuses clients: too many are connected, or the process has too few file descriptors",
    "store-removed": "was removed or replaced while it was in use, and has been written anew",
    "rows-set-aside": "has rows that make no sense: they are set aside in it as unreadable/..., the others are used",
    "relearning": "learns its baseline anew and finds no fault until each operating mode has been seen often enough",
    "memory-failed": "failed and goes on with what the store has: a fault may be missing there, not in the events",
}
"""What a condition is, for a person, of the bus, message or signal that it is of."""

OF_FRAMES: frozenset[Kind] = frozenset((*get_args(MessageKind), *get_args(SignalKind)))
"""What only frames, or their absence for a while, can show."""

KINDS: dict[str, Kind] = {kind: kind for kind in get_args(Kind)}

assert set(MEANINGS) == set(KINDS)


def meaning(kind: str) -> str:
    """Return what a condition is, for a person; its name where this version does not know it."""
    return MEANINGS.get(kind, kind)


RAISED_S = 2.0
"""A condition is told once it has lasted so long."""
AT_ONCE: frozenset[Kind] = frozenset(("second-sender",))
"""These are told at once: no loose plug brings them, and what has been diagnosed meanwhile may be forged."""
CLEARED_S = 10.0
"""It is gone once it was away for so long."""
REFUTED: frozenset[Kind] = frozenset(("no-traffic",))
"""Gone as soon as it is away: one frame shows that it does not hold, and it is raised after seconds of silence only."""


class Condition(msgspec.Struct, frozen=True, order=True):
    """Condition of `of`: a bus, a message, a signal, a bundle or the store."""

    kind: Kind
    of: str


class Standing(msgspec.Struct, frozen=True, kw_only=True):
    """Standing condition."""

    kind: Annotated[str, Meta(description="as below; leave no kind out that you do not know")]  # a newer one's, too
    of: Annotated[str, Meta(description="the bus, message, signal, bundle or file that it is of")]
    since: Annotated[str | None, Meta(description="the wall clock since when it has been told (RFC 3339)")] = None


class Health(msgspec.Struct, frozen=True, kw_only=True):
    """Record of all conditions that stand."""

    schema: Annotated[str, Meta(description="`faultline.health/1`")]
    id: Annotated[str, Meta(description="as of an event")]
    seq: Annotated[int, Meta(description="as of an event")]
    wall: Annotated[str | None, Meta(description="as of an event")]
    conditions: Annotated[list[Standing], Meta(description="all that stand; empty where all is well")]


class Conditions:
    """Debounced conditions. State: those that are, or were lately.

    `told` are those that stood when an earlier run ended, at time `t` [s] of this one: if they are gone, that is news.
    """

    def __init__(self, told: Iterable[Condition] = (), t: float = 0.0) -> None:
        self._begun: dict[Condition, float] = {}  # seen, not told yet: since when
        self._seen = dict.fromkeys(told, t)  # told: when it was last seen

    @property
    def standing(self) -> Sequence[Condition]:
        """Return the standing conditions."""
        return sorted(self._seen)

    def update(self, t: float, present: Iterable[Condition]) -> bool:
        """Take the present conditions at time `t` [s]; return True if the standing ones have changed."""
        now, before = set(present), set(self._seen)
        for condition in now & before:
            self._seen[condition] = t
        self._begun = {condition: self._begun.get(condition, t) for condition in now - before}
        for condition, begun in list(self._begun.items()):
            if t - begun >= RAISED_S or condition.kind in AT_ONCE:
                del self._begun[condition]
                self._seen[condition] = t
        self._seen = {
            condition: seen
            for condition, seen in self._seen.items()
            if condition in now or (t - seen < CLEARED_S and condition.kind not in REFUTED)
        }
        return set(self._seen) != before
