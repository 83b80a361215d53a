"""View model: all that a screen shows of a running service."""

from collections.abc import Sequence
from typing import Literal, TypeVar

import msgspec

from faultline.service.protocol.answers import ServiceState
from faultline.service.protocol.live import LiveTick, SystemDescription

T = TypeVar("T")


class ViewModel(msgspec.Struct, frozen=True, kw_only=True):
    """Content of a screen.

    `connection` is *live* where `tick` is of now, *waiting* where the service is there and gives none, *away* where it
    is not; `why` says so in words. There is no tick but with *live*: what was is not shown as what is.
    """

    connection: Literal["live", "waiting", "away"]
    why: str = ""
    state: ServiceState | None = None
    system: SystemDescription | None = None
    tick: LiveTick | None = None
    events: tuple[str, ...] = ()


def at(values: Sequence[T], k: int) -> T | None:
    """Return the value there; None if the service sent fewer."""
    return values[k] if k < len(values) else None
