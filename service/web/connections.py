"""Connections that are slow, silent or too many: a protocol of uvicorn's that can end them.

uvicorn has no time limit for headers, for a client that has sent nothing yet, nor for one that takes nothing of its
answer; and beyond `limit_concurrency` it turns away who comes last, which is who does no harm. Here one that waits
without a request makes room, first those that have never had an answer, the oldest of them; and a look once a second
ends those that are overdue.
"""

import asyncio
import sys
import time
from typing import Any, Self, cast

import h11
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from faultline.service.web.limits import Limits
from faultline.service.web.metrics import Counts
from faultline.service.web.problems import MEDIA_TYPE, RequestError
from faultline.service.web.sending import EVERYWHERE

LATE, STALLED, ROOM, FULL, NO_HTTP = "late request", "takes nothing", "made room", "no room", "no HTTP"
"""Why a connection was ended."""


class Connection(H11Protocol):
    """One connection.

    State: `silent_since` [s, monotonic], while no request is being answered, and `stalled_since`, while it takes
    nothing of an answer; None else. `answered`: it has had a whole answer.
    """

    limits: Limits
    counts: Counts

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.silent_since: float | None = time.monotonic()
        self.stalled_since: float | None = None
        self.answered = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept it, if need be in the place of another."""
        super().connection_made(transport)
        self.app_state = {**self.app_state, "abort": self.abort}
        if len(self.connections) > self.limits.connections:
            others = [each for each in self._all() if each is not self and each.silent_since is not None]
            least = min(others, key=lambda each: (each.answered, each.silent_since), default=self)
            least.abort(FULL if least is self else ROOM)
        self.counts.connections = len(self.connections)

    def connection_lost(self, exc: Exception | None) -> None:
        """Count the connections that are left."""
        super().connection_lost(exc)
        self.counts.connections = len(self.connections)

    def data_received(self, data: bytes) -> None:
        """Receive bytes; a whole request ends the silence."""
        super().data_received(data)
        self._note()

    def on_response_complete(self) -> None:
        """Note that an answer is complete: it is silent again, unless the next request is there."""
        self.answered = True
        super().on_response_complete()
        self._note()

    def pause_writing(self) -> None:
        """Note that the client reads nothing."""
        super().pause_writing()
        self.stalled_since = time.monotonic()

    def resume_writing(self) -> None:
        """Note that the client reads again."""
        super().resume_writing()
        self.stalled_since = None

    def send_400_response(self, msg: str) -> None:
        """Answer invalid HTTP, called where h11 has raised; nothing where another answer is under way."""
        if self.conn.our_state is not h11.IDLE:
            self.abort(NO_HTTP)
            return
        error = sys.exception()
        status = error.error_status_hint if isinstance(error, h11.RemoteProtocolError) else 400
        failure = RequestError(status, "no-http", f"{msg} {error}")
        headers = {**EVERYWHERE, "content-type": MEDIA_TYPE, "content-length": str(len(failure.body))}
        response = h11.Response(status_code=status, headers=[*headers.items(), ("connection", "close")])
        for event in (response, h11.Data(data=failure.body), h11.EndOfMessage()):
            self.transport.write(self.conn.send(event) or b"")
        self.counts.requests["other", status] += 1
        self.transport.close()
        self.stalled_since = time.monotonic()

    def look(self, now: float) -> None:
        """End the connection if it is overdue at `now` [s, monotonic]."""
        if self.transport.is_closing() and self.stalled_since is None:
            self.stalled_since = now
        if self.silent_since is not None and now - self.silent_since > self.limits.header_s:
            self.abort(LATE)
        elif self.stalled_since is not None and now - self.stalled_since > self.limits.stalled_s:
            self.abort(STALLED)

    def abort(self, reason: str) -> None:
        """End it at once, whatever is still to be sent."""
        if self in self.connections:
            self.counts.turned_away[reason] += 1
        self.connections.discard(self)  # its place is free now, and `connection_lost` comes later
        self.counts.connections = len(self.connections)
        self.transport.abort()

    def _note(self) -> None:
        is_answering = self.cycle is not None and not self.cycle.response_complete
        if is_answering:
            self.silent_since = None
        elif self.silent_since is None:
            self.silent_since = time.monotonic()

    def _all(self) -> list[Self]:
        return [cast("Self", each) for each in self.connections]


def look(state: ServerState, now: float) -> None:
    """End the overdue connections of a server."""
    for each in list(state.connections):
        if isinstance(each, Connection):
            each.look(now)


def protocol(limits: Limits, counts: Counts) -> type[Connection]:
    """Return the protocol class with these limits."""
    return type("LimitedConnection", (Connection,), {"limits": limits, "counts": counts})
