"""Asks a running service over its control socket (docs/control.md)."""

import socket
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec

from faultline.service.core.errors import InputError

PATIENCE_S = 10.0
"""So long an answer may take: erasing waits for the disk."""


class ControlError(InputError):
    """The service did not answer, or cannot; `code` is one of docs/control.md, `away` where nobody answers."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class Control:
    """A connection to the control socket at `path`.

    Raises:
        ControlError: nobody serves there.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._sock.settimeout(PATIENCE_S)
        try:
            self._sock.connect(str(path))
        except OSError as error:
            self._sock.close()
            raise self._away(error.strerror or str(error)) from error
        self._lines = self._sock.makefile("rb")

    def __enter__(self) -> "Control":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lines.close()
        self._sock.close()

    def ask(self, ask: str, **fields: object) -> dict[str, Any]:
        """The answer to a question; raises `ControlError`."""
        question = {"ask": ask, **{name: value for name, value in fields.items() if value is not None}}
        try:
            self._sock.sendall(msgspec.json.encode(question) + b"\n")
            line = self._lines.readline()
        except OSError as error:
            raise self._away(error.strerror or "it does not answer") from error
        return self._answer(line)

    def live(self, name: str | None) -> Iterator[dict[str, Any]]:
        """The ticks of a system as they come, until the service ends; raises `ControlError`."""
        try:
            self._sock.sendall(msgspec.json.encode({"ask": "live", "name": name} if name else {"ask": "live"}) + b"\n")
            for line in self._lines:
                yield self._answer(line)
        except OSError as error:
            raise self._away(error.strerror or "nothing comes any more") from error

    def _answer(self, line: bytes) -> dict[str, Any]:
        if not line.endswith(b"\n"):
            raise self._away("it broke off")
        try:
            answer: dict[str, Any] = msgspec.json.decode(line, type=dict[str, Any])
        except (msgspec.MsgspecError, ValueError) as error:
            raise ControlError("garbled", f"{self._path}: sent no answer: {line[:80]!r} ({error})") from error
        if "error" in answer:
            raise ControlError(answer["error"]["code"], f"{self._path}: {answer['error']['message']}")
        return answer

    def _away(self, reason: str) -> ControlError:
        return ControlError("away", f"{self._path}: {reason}; is the service running, with a [control] socket there?")
