"""Live ticks from the control socket, and the silence between them."""

from collections.abc import Iterator
from pathlib import Path

from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import AwayError, RefusedError
from faultline.service.protocol.live import LiveTick

SILENT_S = 0.5
"""So long nothing has to come until that is said."""


class Listening:
    """The ticks of a system, as they come.

    A connection on which nothing comes for long is made anew: the service may be waiting for the bus.
    """

    def __init__(self, path: Path, system: str) -> None:
        self._path, self._system = path, system
        self._client: ControlClient | None = None

    def ticks(self) -> Iterator[LiveTick | float]:
        """Ticks, and between them seconds [s] in which none came; ends where the service does, or has no place.

        Raises:
            ProtocolError: the service refuses, or answers what cannot be understood.
        """
        while True:
            try:
                with ControlClient(self._path) as self._client:
                    yield from self._client.live_or_silent(self._system, SILENT_S)
            except RefusedError as error:
                if error.code != "busy":
                    raise
                return
            except AwayError as error:
                if not isinstance(error.__cause__, TimeoutError):
                    return

    @property
    def is_behind(self) -> bool:
        """True if more has come than was taken."""
        return self._client is not None and self._client.is_behind
