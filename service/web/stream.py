"""Server-Sent Events: an answer without an end, until the client is gone, reads nothing, or this server ends.

Source: the HTML standard, section Server-sent events.
"""

import asyncio
from collections.abc import AsyncGenerator, Coroutine
from contextlib import aclosing
from typing import Any, NamedTuple

from starlette.types import Receive, Scope, Send

from faultline.service.web.connections import STALLED
from faultline.service.web.limits import Limits
from faultline.service.web.metrics import Counts
from faultline.service.web.problems import RequestError
from faultline.service.web.waiting import Shutdown

HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"x-accel-buffering", b"no"),  # a proxy must hand on what comes
]
LAST_S = 0.5  # for the last words, where this server ends


class Streams(NamedTuple):
    """Limits, counts and shutdown that all streams share."""

    limits: Limits
    counts: Counts
    shutdown: Shutdown

    def seat(self) -> None:
        """Raise RequestError if as many streams are open as may be."""
        if self.counts.streams.total() >= self.limits.streams:
            headers = {"retry-after": "5"}
            raise RequestError(503, "too-many-streams", f"{self.limits.streams} streams are open; try later", headers)


class Stream:
    """An ASGI answer of what `parts` yields; counted as `kind`."""

    def __init__(self, kind: str, parts: AsyncGenerator[bytes, None], streams: Streams) -> None:
        streams.seat()
        self._kind, self._parts, self._streams = kind, parts, streams

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""
        counts = self._streams.counts
        counts.streams[self._kind] += 1
        try:
            await send({"type": "http.response.start", "status": 200, "headers": [*HEADERS]})
            await _first_of(self._write(scope, send), _gone(receive), self._streams.shutdown.wait())
        finally:
            counts.streams[self._kind] -= 1
        try:
            async with asyncio.timeout(LAST_S):
                await send({"type": "http.response.body", "body": b""})
        except TimeoutError:
            scope["state"]["abort"](STALLED)

    async def _write(self, scope: Scope, send: Send) -> None:
        async with aclosing(self._parts) as parts:
            async for part in parts:
                try:
                    async with asyncio.timeout(self._streams.limits.stalled_s):
                        await send({"type": "http.response.body", "body": part, "more_body": True})
                        await asyncio.sleep(0)  # others first, and the news that this client is gone
                except TimeoutError:
                    scope["state"]["abort"](STALLED)
                    return


async def _first_of(*ways: Coroutine[Any, Any, object]) -> None:
    """Wait until one of them has ended, and cancel the others; raises what it raised."""
    tasks = [asyncio.create_task(way) for way in ways]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        task.result()


async def _gone(receive: Receive) -> None:
    """Wait until the client is gone."""
    while (await receive())["type"] != "http.disconnect":
        pass
