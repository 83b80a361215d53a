"""HTTP server: uvicorn's, with systemd's notifications and connection limits; a signal ends it within 3 s."""

import asyncio
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import uvicorn

from faultline.service.systemd import Notifier
from faultline.service.web import connections
from faultline.service.web.app import application
from faultline.service.web.limits import Limits
from faultline.service.web.listen import WAITING, url
from faultline.service.web.metrics import Counts
from faultline.service.web.settings import Settings
from faultline.service.web.tokens import Tokens
from faultline.service.web.waiting import Shutdown

TICKS = 5  # of uvicorn's, which are 0.1 s: how often connections are looked at
TAKEN = 16  # connections taken in one turn: those of three turns must find room, or their first bytes are not read
GRACE_S = 1  # for answers under way, at the end


class Server(uvicorn.Server):
    """Serves until SIGTERM, SIGINT or a failure; `shutdown` requests the end."""

    def __init__(self, config: uvicorn.Config, notifier: Notifier, shutdown: Shutdown) -> None:
        super().__init__(config)
        self._notifier, self._shutdown = notifier, shutdown

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to serve, and notify systemd."""
        await super().startup(sockets)
        for sock in sockets or []:
            sock.listen(WAITING)  # asyncio has set it to the number that it takes in one turn
        self._notifier.tell(READY=1, STATUS="serving")

    async def on_tick(self, counter: int) -> bool:
        """Check connections and feed the watchdog; return True if the server is to end."""
        if counter % TICKS == 0:
            connections.look(self.server_state, time.monotonic())
            if self._notifier.watchdog_s is not None:
                self._notifier.tell(WATCHDOG=1)
        return await super().on_tick(counter) or self._shutdown.requested

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End streams, then other answers once they are out."""
        self._notifier.tell(STOPPING=1)
        await super().shutdown(sockets)

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals to `_serve`, which handles them before the server starts, and raises none again afterwards."""
        yield


def serve(
    settings: Settings,
    tokens: Tokens,
    sock: socket.socket,
    say: Callable[[str], None],
    limits: Limits | None = None,
    notifier: Notifier | None = None,
) -> None:
    """Serve on a listening socket until the end is requested; raises what made it end otherwise."""
    shutdown = Shutdown()
    with asyncio.Runner() as runner:
        for number in (signal.SIGTERM, signal.SIGINT):  # before `run`, whose own handler of SIGINT cancels the task
            runner.get_loop().add_signal_handler(number, shutdown.request)
        runner.run(_serve(settings, tokens, sock, say, limits or Limits(), notifier or Notifier(), shutdown))


async def _serve(
    settings: Settings,
    tokens: Tokens,
    sock: socket.socket,
    say: Callable[[str], None],
    limits: Limits,
    notifier: Notifier,
    shutdown: Shutdown,
) -> None:
    counts = Counts()
    config = uvicorn.Config(
        application(settings, tokens, limits, counts, shutdown, say),
        loop="asyncio",
        http=connections.protocol(limits, counts),
        ws="none",
        lifespan="on",
        interface="asgi3",
        log_config=None,
        log_level="error",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        backlog=TAKEN,
        timeout_keep_alive=limits.keep_alive_s,
        timeout_graceful_shutdown=GRACE_S,
        h11_max_incomplete_event_size=limits.header_bytes,
    )
    server = Server(config, notifier, shutdown)
    say(f"listening on {url(sock)}, control {settings.control}, events {settings.events}")
    await server.serve(sockets=[sock])
    if shutdown.failure is not None:
        raise shutdown.failure
