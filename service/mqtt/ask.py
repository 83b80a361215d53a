"""Questions to the daemon, whose answers are forwarded unchanged, with the fields of a newer daemon too."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import msgspec

from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import UNREADABLE, GarbledError
from faultline.service.protocol.questions import Ask, Question
from faultline.service.protocol.records import RecordError, part_of

TIMEOUT_S = 1.0
"""For the whole answer: our own loop stands still meanwhile."""
LARGEST = 4 << 20
"""Bytes of an answer."""


class State(NamedTuple):
    """The daemon's state: its name, the number of the last record, and the standing conditions as JSON."""

    source: str
    seq: int
    conditions: msgspec.Raw


class Remembered(NamedTuple):
    """The fault memory: each fault as JSON by its number, and the number of the last record."""

    faults: dict[int, bytes]
    seq: int


def ask_state(path: Path) -> State:
    """Return the daemon's state; raises ProtocolError."""
    with _asked(path, "state") as parts:
        conditions = part_of(parts, "conditions", msgspec.Raw)
        return State(part_of(parts, "source", str), part_of(parts, "seq", int), conditions)


def ask_faults(path: Path) -> Remembered:
    """Return the daemon's fault memory; raises ProtocolError."""
    with _asked(path, "faults") as parts:
        faults = part_of(parts, "faults", list[msgspec.Raw])
        return Remembered({number_of(fault): bytes(fault) for fault in faults}, part_of(parts, "seq", int))


def number_of(fault: msgspec.Raw) -> int:
    """Return the number of a fault in JSON; raises RecordError where it has none, or one that is no topic's."""
    try:
        number = part_of(msgspec.json.decode(fault, type=dict[str, msgspec.Raw]), "number", int)
    except UNREADABLE as error:
        raise RecordError(f"a fault without a number: {error}") from error
    if not 1 <= number < 10**10:
        raise RecordError(f"a fault without a number: {number} is none")
    return number


@contextmanager
def _asked(path: Path, ask: Ask) -> Iterator[dict[str, msgspec.Raw]]:
    """Yield the answer's JSON by field; raises GarbledError if it lacks one that is read of it."""
    with ControlClient(path, TIMEOUT_S, LARGEST) as control:
        parts = control.ask(Question(ask=ask), dict[str, msgspec.Raw])
    try:
        yield parts
    except UNREADABLE as error:
        raise GarbledError(f"sent no {ask}: {error}", path) from error
