"""Errors for the caller: problem documents (RFC 9457)."""

from collections.abc import Mapping
from http import HTTPStatus

import msgspec
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from faultline.service.protocol.errors import AwayError, GarbledError, RefusedError
from faultline.service.web.shapes import Problem

MEDIA_TYPE = "application/problem+json"
RETRY = {"retry-after": "1"}  # seconds

OF_DAEMON = {"unknown": 404, "not-allowed": 403, "not-kept": 500, "busy": 503}
"""Statuses for what the daemon refuses (docs/control.md)."""


class RequestError(Exception):
    """A request that cannot be answered as asked; `code` names the reason for programs."""

    def __init__(self, status: int, code: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.status, self.code, self.detail, self.headers = status, code, detail, dict(headers or {})

    @property
    def body(self) -> bytes:
        """Return the problem document."""
        return msgspec.json.encode(
            Problem(
                type=f"urn:faultline:problem:{self.code}",
                title=HTTPStatus(self.status).phrase,
                status=self.status,
                detail=self.detail,
                code=self.code,
            )
        )

    @property
    def response(self) -> Response:
        """Return the answer with the problem document."""
        return Response(self.body, self.status, {**self.headers, "content-type": MEDIA_TYPE})


def error_of(error: Exception) -> RequestError:
    """Return the RequestError for an error of the daemon, of the routes or of this server."""
    if isinstance(error, RequestError):
        return error
    if isinstance(error, AwayError):
        return RequestError(503, "away", f"the daemon does not answer: {error}", RETRY)
    if isinstance(error, GarbledError):
        return RequestError(502, "garbled", f"the daemon's answer cannot be read: {error}")
    if isinstance(error, RefusedError):
        status = OF_DAEMON.get(error.code, 502)
        return RequestError(status, error.code, error.message, RETRY if status == 503 else None)
    if isinstance(error, HTTPException):
        code = {404: "no-route", 405: "method"}.get(error.status_code, "http")
        detail = {404: "nothing is here; /v1/openapi.json says what is"}.get(error.status_code, error.detail)
        return RequestError(error.status_code, code, detail, error.headers)
    return RequestError(500, "broken", "this server has failed; its log says why")


async def told(_: Request, error: Exception) -> Response:
    """Return the answer to a request that raised."""
    return error_of(error).response
