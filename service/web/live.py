"""Live ticks: one connection to the daemon for all clients of a system, and to each the latest tick only."""

import asyncio
from collections.abc import AsyncGenerator, Callable

from faultline.service.core.records.line import encode
from faultline.service.protocol.aio import connected, line_of
from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.client import decode
from faultline.service.protocol.errors import ProtocolError
from faultline.service.protocol.questions import Question
from faultline.service.web.asking import SharedControl
from faultline.service.web.events import RETRY_MS, RETRY_S
from faultline.service.web.waiting import ChangeNotifier, Shutdown


class _Feed:
    """Ticks of one system. State: the `latest` line, their count, and whether the daemon is `there`."""

    def __init__(self) -> None:
        self.changes = ChangeNotifier()
        self.latest, self.count = b"", 0
        self.there = True
        self.watchers = 0
        self.task: asyncio.Task[None] | None = None

    async def run(self, control: SharedControl, system: str, say: Callable[[str], None]) -> None:
        """Receive ticks for ever; connect again if the daemon went away."""
        question = encode(Question(ask="live", name=system))
        retry = Backoff(*RETRY_S)
        while True:
            before = self.count
            try:
                async with connected(control.path, question) as reader:
                    while True:
                        self.take(await line_of(reader))
            except ProtocolError as error:
                if self.there:
                    say(f"live {system}: {error}; trying again")
                if self.count > before:
                    retry.well()
            self.there = False
            self.changes.notify()
            await asyncio.sleep(retry.wait())

    def take(self, line: bytes) -> None:
        """Take a tick; raises RefusedError or GarbledError if it is none."""
        decode(line, dict)
        self.latest, self.count, self.there = line.rstrip(b"\r\n"), self.count + 1, True
        self.changes.notify()


class Live:
    """Systems with clients; this server ends if the connection of one fails."""

    def __init__(self, control: SharedControl, shutdown: Shutdown, say: Callable[[str], None]) -> None:
        self._control, self._shutdown, self._say = control, shutdown, say
        self._feeds: dict[str, _Feed] = {}

    async def stream(self, system: str, alive_s: float) -> AsyncGenerator[bytes, None]:
        """Yield the latest tick whenever the client can take one; a comment if none comes."""
        feed = self._enter(system)
        try:
            yield b"retry: %d\n\n" % RETRY_MS
            count, there = feed.count, True
            while True:
                if feed.count != count:
                    count = feed.count
                    yield b"event: live\ndata: %b\n\n" % feed.latest
                elif feed.there != there:
                    there = feed.there
                    yield b": daemon back\n\n" if there else b": daemon away\n\n"
                elif not await feed.changes.wait(alive_s):
                    yield b": alive\n\n" if there else b": daemon away\n\n"
        finally:
            self._leave(system, feed)

    def _enter(self, system: str) -> _Feed:
        feed = self._feeds.setdefault(system, _Feed())
        feed.watchers += 1
        if feed.task is None:
            feed.task = asyncio.create_task(feed.run(self._control, system, self._say))
            self._shutdown.watch(feed.task)
        return feed

    def _leave(self, system: str, feed: _Feed) -> None:
        feed.watchers -= 1
        if feed.watchers == 0 and feed.task is not None:
            feed.task.cancel()
            del self._feeds[system]
