"""Errors of the protocol, and their messages on the wire.

`InputError`
  +-- `ProtocolError`
        +-- `AwayError`      nobody serves there, the connection broke off, or no answer came in time
        +-- `GarbledError`   what came is not what the protocol says
        +-- `RefusedError`   the service answers that it cannot, with a code
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from faultline.service.core.errors import InputError

UNREADABLE = (msgspec.MsgspecError, ValueError, RecursionError)
"""Raised by decoding what is no message: of another type, no UTF-8, no JSON, nested without end."""

Code = Literal["bad-request", "unknown", "not-allowed", "not-kept", "busy"]
"""Why a question is refused (docs/control.md)."""


class Refusal(msgspec.Struct, frozen=True, kw_only=True):
    """Reason why a question is refused."""

    code: Annotated[str, Meta(description="one of the codes below; clients take others for a refusal too")] = "unknown"
    message: Annotated[str, Meta(description="the reason, for a person")] = "it did not say why"


class ErrorAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """Sent on the control socket instead of an answer."""

    error: Annotated[Refusal | None, Meta(description="the refusal")] = None


class Rejection(msgspec.Struct, frozen=True, kw_only=True):
    """The last line on the event socket, to a client that is sent away."""

    error: Annotated[str, Meta(description="the reason, for a person")]


class ProtocolError(InputError):
    """Error without an answer; `code` is one of `Code`, *away* or *garbled*, `message` the reason without the path."""

    def __init__(self, code: str, message: str, where: object = "") -> None:
        super().__init__(f"{where}: {message}" if where else message)
        self.code, self.message = code, message


class AwayError(ProtocolError):
    """Error that nobody serves there, the connection broke off, or no answer came in time."""

    def __init__(self, message: str, where: object = "") -> None:
        super().__init__("away", message, where)


class GarbledError(ProtocolError):
    """Error that a message is not as the protocol says."""

    def __init__(self, message: str, where: object = "") -> None:
        super().__init__("garbled", message, where)


class RefusedError(ProtocolError):
    """The service answers that it cannot; `code` is one of `Code`, or one of a newer service."""
