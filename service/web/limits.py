"""Limits of a request, checked before anything else: ASGI middleware.

Source: DNS rebinding is refused by the Host header, and a page elsewhere by Fetch Metadata (W3C).
"""

import asyncio
import re
from collections.abc import Iterable
from typing import NamedTuple

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from faultline.service.web.metrics import Counts
from faultline.service.web.problems import RequestError
from faultline.service.web.sending import Answer, Held
from faultline.service.web.tokens import Tokens, bearer

CLOSE = {"connection": "close"}

LOOPBACK = frozenset(("localhost", "127.0.0.1", "[::1]"))
"""Names under which a server that only listens on this machine is asked."""


class Limits(NamedTuple):
    """Sizes and times [s]; those of connections are checked by `service.web.connections`."""

    body: int = 64 * 1024  # bytes
    body_s: float = 10.0
    lingering: int = 1024 * 1024  # bytes of a body that is too long are read before it is refused
    target: int = 8 * 1024  # bytes of a path with its query
    headers: int = 64
    header_bytes: int = 16 * 1024
    header_s: float = 10.0  # for a whole request, since the connection or the last answer
    keep_alive_s: int = 5  # without a byte
    connections: int = 128
    streams: int = 32
    held: int = 32 * 1024 * 1024  # bytes of all answers that are being sent
    stalled_s: float = 30.0  # a client that takes nothing
    alive_s: float = 15.0  # a comment in a stream where nothing else comes
    answer_s: float = 5.0  # the daemon's: a turn of its loop
    clear_s: float = 15.0  # the same, where it waits for the disk


class Gate:
    """Passes requests that are within limits.

    `hosts` are the names under which this server may be asked, None for any; `tokens` those that every request needs
    one of, None where it needs none.
    """

    def __init__(
        self, app: ASGIApp, limits: Limits, counts: Counts, hosts: frozenset[str] | None, tokens: Tokens | None
    ) -> None:
        self._app, self._limits, self._counts = app, limits, counts
        self._hosts, self._tokens = hosts, tokens
        self._held = Held(limits.held)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer what may not pass; pass on what may, without its body: nothing here takes one."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answer = Answer(scope, receive, send, self._held, self._counts)
        headers = Headers(scope=scope)
        try:
            self._look(scope, headers)
            if await self._drained(headers, receive):
                await self._app(scope, receive, answer)
        except RequestError as failure:
            await failure.response(scope, receive, answer)

    def _look(self, scope: Scope, headers: Headers) -> None:
        limits = self._limits
        if len(scope["raw_path"]) + len(scope["query_string"]) > limits.target:
            raise RequestError(414, "too-long-target", f"more than {limits.target} bytes of path and query", CLOSE)
        size = sum(len(name) + len(value) for name, value in headers.raw)  # h11 limits those only that come in pieces
        if len(headers.raw) > limits.headers or size > limits.header_bytes:
            most = f"{limits.headers} headers or {limits.header_bytes} bytes of them"
            raise RequestError(431, "too-many-headers", f"more than {most}", CLOSE)
        if self._hosts is not None and host_of(headers.get("host", "")) not in self._hosts:
            raise RequestError(421, "host", "this server is asked as localhost, 127.0.0.1 or [::1] only", CLOSE)
        if headers.get("sec-fetch-site") in ("cross-site", "same-site") and headers.get("sec-fetch-mode") != "navigate":
            raise RequestError(403, "cross-site", "pages of other sites may not ask here", CLOSE)
        if self._tokens is not None:
            require(self._tokens, headers)

    async def _drained(self, headers: Headers, receive: Receive) -> bool:
        """Read the body; False if the client went away meanwhile."""
        declared = int(headers.get("content-length", "0"))
        if declared == 0 and "transfer-encoding" not in headers:
            return True
        too_long = RequestError(413, "too-long", f"a body of more than {self._limits.body // 1024} KiB", CLOSE)
        if declared > self._limits.body and "expect" in headers:
            raise too_long  # it waits for our answer
        most = self._limits.lingering if declared > self._limits.body else self._limits.body
        try:
            async with asyncio.timeout(self._limits.body_s):
                read = await _read(receive, most)
        except TimeoutError as error:
            raise RequestError(408, "slow", "the body did not come in time", CLOSE) from error
        if read is not None and max(read, declared) > self._limits.body:
            raise too_long
        return read is not None


async def _read(receive: Receive, most: int) -> int | None:
    """Return the bytes of body, up to the first above `most`; None if the client went away."""
    read, more = 0, True
    while more and read <= most:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None
        read += len(message.get("body", b""))
        more = message.get("more_body", False)
    return read


def require(tokens: Tokens, headers: Headers) -> None:
    """Raise RequestError unless the request carries one of the tokens."""
    token = bearer(headers.get("authorization", ""))
    if token is None:
        challenge = {"www-authenticate": 'Bearer realm="faultline"'}
        raise RequestError(401, "no-token", "give a token: Authorization: Bearer ...", challenge)
    if not tokens.known(token):
        raise RequestError(403, "wrong-token", "this token is not taken here")


def host_of(header: str) -> str:
    """Return the name in a Host header, without its port."""
    match = re.fullmatch(r"(\[[0-9A-Fa-f:.]+\]|[^:\[\]]*)(:[0-9]{1,5})?", header.strip())
    return match[1].lower() if match else ""


def hosts_of(addresses: Iterable[str]) -> frozenset[str]:
    """Return the names of a server that listens on these addresses of this machine."""
    return LOOPBACK | {f"[{each}]" if ":" in each else each for each in addresses}
