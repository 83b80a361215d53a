"""Live ticks from the control socket, and the silence between them."""

from collections.abc import Iterator
from pathlib import Path

from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import AwayError, RefusedError
from faultline.service.protocol.live import LiveTick

SILENT_S = 0.5
"""The time without a tick after which silence is reported [s]."""


def live_ticks(path: Path, system: str) -> Iterator[tuple[LiveTick | float, bool]]:
    """Yield each tick of a system, or the seconds [s] without one; and True if more has come already.

    It ends where the service does, or has no place. A connection on which nothing comes for long is made anew: the
    service may be waiting for the bus.

    Raises:
        ProtocolError: the service refuses, or answers what cannot be understood.
    """
    while True:
        try:
            with ControlClient(path) as client:
                yield from ((came, client.is_behind) for came in client.live_or_silent(system, SILENT_S))
        except RefusedError as error:
            if error.code != "busy":
                raise
            return
        except AwayError as error:
            if not isinstance(error.__cause__, TimeoutError):
                return
