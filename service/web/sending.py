"""Sending of answers: common headers, counts, and pieces that the client takes one after the other.

What clients have not taken yet is held in memory, so there is a limit to all of that together: who asks for something
long while others take nothing of theirs is sent away.
"""

from starlette.datastructures import MutableHeaders
from starlette.types import Message, Receive, Scope, Send

from faultline.service.web.metrics import Counts
from faultline.service.web.problems import RETRY, RequestError

PIECE = 64 * 1024  # bytes: what a connection holds before it makes wait (asyncio, uvicorn)

METHODS = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))

EVERYWHERE = {
    "x-content-type-options": "nosniff",
    "cache-control": "no-store",
    "content-security-policy": "default-src 'none'; frame-ancestors 'none'",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
}
"""What an answer says that does not say otherwise."""


class Held:
    """Bytes of answers that are being sent, `most` at once."""

    def __init__(self, most: int) -> None:
        self._most, self._now = most, 0

    def has_room(self, size: int) -> bool:
        """Return True if so many more may be held; a short answer always may."""
        return size <= PIECE or self._now + size <= self._most

    def add(self, size: int) -> None:
        """Add so many bytes that are being sent; fewer if negative."""
        self._now += size


class Answer:
    """Sends the answer to one request; called as an ASGI `send`."""

    def __init__(self, scope: Scope, receive: Receive, send: Send, held: Held, counts: Counts) -> None:
        self._scope, self._receive, self._send = scope, receive, send
        self._held, self._counts = held, counts
        self._start: Message | None = None

    async def __call__(self, message: Message) -> None:
        """Take a message of the application's; its first waits for the second, which says how long the body is."""
        if message["type"] == "http.response.start":
            self._start = message
            return
        body = message.get("body", b"")
        if self._start is not None and not self._held.has_room(len(body)):
            await self._refuse()
            return
        self._held.add(len(body))
        try:
            await self._begin()
            await self._pieces(body, more=message.get("more_body", False))
        finally:
            self._held.add(-len(body))

    async def _refuse(self) -> None:
        self._start = None
        failure = RequestError(503, "busy", "too many long answers that nobody takes", RETRY)
        answer = Answer(self._scope, self._receive, self._send, self._held, self._counts)
        await failure.response(self._scope, self._receive, answer)

    async def _begin(self) -> None:
        if self._start is not None:
            start, self._start = self._start, None
            headers = MutableHeaders(scope=start)
            for name, value in EVERYWHERE.items():
                headers.setdefault(name, value)
            method = self._scope["method"]
            self._counts.requests[method if method in METHODS else "other", start["status"]] += 1
            await self._send(start)

    async def _pieces(self, body: bytes, *, more: bool) -> None:
        for begin in range(0, max(len(body), 1), PIECE):
            piece = body[begin : begin + PIECE]
            is_last = begin + PIECE >= len(body)
            await self._send({"type": "http.response.body", "body": piece, "more_body": more or not is_last})
