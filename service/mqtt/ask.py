"""Questions to the daemon over its control socket; source: docs/control.md."""

import socket
import time
from pathlib import Path
from typing import TypeVar

import msgspec

from faultline.service.mqtt.records import number_of

TIMEOUT_S = 1.0
"""For the whole answer: our own loop stands still meanwhile."""
LARGEST = 4 << 20
"""Bytes of an answer."""


class AskError(Exception):
    """There is no answer, or none that makes sense: why, in one line."""


class State(msgspec.Struct, frozen=True):
    """Of the daemon's state what concerns us: its name, what stands, and the number of the last record."""

    source: str
    seq: int
    conditions: msgspec.Raw


class Remembered(msgspec.Struct, frozen=True):
    """The fault memory: each fault as JSON by its number, and the number of the last record that was told."""

    faults: dict[int, bytes]
    seq: int


class _Faults(msgspec.Struct):
    faults: list[msgspec.Raw]
    seq: int


class _Refusal(msgspec.Struct):
    message: str = ""


class _Refused(msgspec.Struct):
    error: _Refusal | None = None


_T = TypeVar("_T")


def ask_state(path: Path) -> State:
    """What the daemon says of itself; raises AskError."""
    return _ask(path, "state", State)


def ask_faults(path: Path) -> Remembered:
    """What the daemon remembers; raises AskError."""
    answer = _ask(path, "faults", _Faults)
    try:
        return Remembered({number_of(fault): bytes(fault) for fault in answer.faults}, answer.seq)
    except ValueError as error:
        raise AskError(f"{path}: a fault without a number: {error}") from error


def _ask(path: Path, question: str, kind: type[_T]) -> _T:
    try:
        line = _line(path, question)
    except OSError as error:
        raise AskError(f"{path}: {error.strerror or error}") from error
    try:
        refused = msgspec.json.decode(line, type=_Refused).error
        if refused is not None:
            raise AskError(f"{path}: {question!r} is refused: {refused.message}")
        return msgspec.json.decode(line, type=kind)
    except (ValueError, RecursionError) as error:
        raise AskError(f"{path}: {question!r} is answered by what makes no sense: {error}") from error


def _line(path: Path, question: str) -> bytes:
    """The answer; raises OSError where none comes in time or at all."""
    end = time.monotonic() + TIMEOUT_S
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
        sock.settimeout(TIMEOUT_S)
        sock.connect(str(path))
        sock.sendall(msgspec.json.encode({"ask": question}) + b"\n")
        content = bytearray()
        while not content.endswith(b"\n"):
            left = end - time.monotonic()
            if left <= 0:
                raise TimeoutError(f"no answer within {TIMEOUT_S:.0f} s")
            sock.settimeout(left)
            part = sock.recv(1 << 16)
            if not part or len(content) > LARGEST:
                raise ConnectionError("no whole answer came")
            content += part
    return bytes(content)
