"""What every record has, of whatever schema: enough to hand it on, in order and once.

Source: docs/events.md. Schemas that this faultline does not know are handed on as they are.
"""

import re
from collections.abc import Sequence

import msgspec

from faultline.service.core.events import SCHEMA as EVENT
from faultline.service.core.faults import CLEARED
from faultline.service.core.faults import SCHEMA as FAULT
from faultline.service.core.health import SCHEMA as HEALTH

__all__ = ["CLEARED", "EVENT", "FAULT", "HEALTH", "FaultState", "Record", "RecordError", "read"]

_ID = re.compile(r"(.+?)(?:-[0-9a-f]{8})?-[0-9]+", re.DOTALL)


class RecordError(ValueError):
    """A line that is no record."""


class Record(msgspec.Struct, frozen=True, kw_only=True):
    """One record that the daemon told.

    `line` is its JSON without the end of the line; `epoch` which connection to the daemon brought it, from 1; `lost`
    how many before it, by their numbers, the daemon did not give.
    """

    id: str
    seq: int
    schema: str
    wall: str | None
    line: bytes
    epoch: int = 0
    lost: int = 0

    @property
    def vehicle(self) -> str | None:
        """The name that its id begins with; None where the id has another form."""
        found = _ID.fullmatch(self.id)
        return found.group(1) if found else None


class _Header(msgspec.Struct):
    id: str
    seq: int
    schema: str = ""
    wall: object = None


class FaultState(msgspec.Struct, frozen=True):
    """What a record says of one fault: its number, what has become of it, and all of it as JSON."""

    number: int
    change: str
    content: bytes


class _Numbered(msgspec.Struct):
    number: int


class _Fault(msgspec.Struct):
    change: str
    fault: msgspec.Raw


class _Cleared(msgspec.Struct):
    numbers: list[int]


class _Health(msgspec.Struct):
    conditions: msgspec.Raw


_HEADER = msgspec.json.Decoder(_Header)
_FAULT = msgspec.json.Decoder(_Fault)
_CLEARED = msgspec.json.Decoder(_Cleared)
_HEALTH = msgspec.json.Decoder(_Health)
_NUMBERED = msgspec.json.Decoder(_Numbered)


def read(line: bytes, epoch: int = 0, lost: int = 0) -> Record:
    """The record in one line of JSON.

    Raises:
        RecordError: it is none: no UTF-8, no JSON, without an id or a number.
    """
    line = line.strip()
    try:
        line.decode()  # what is passed on unread must be text all the same
        header = _HEADER.decode(line)
    except (ValueError, RecursionError) as error:
        raise RecordError(str(error)) from error
    if not header.id or not 1 <= header.seq < 2**63:
        raise RecordError("without an id, or with a number that is none")
    wall = header.wall if isinstance(header.wall, str) else None
    return Record(id=header.id, seq=header.seq, schema=header.schema, wall=wall, line=line, epoch=epoch, lost=lost)


def fault_in(record: Record) -> FaultState:
    """What a record of schema `FAULT` says; raises RecordError where it says nothing of the kind."""
    try:
        found = _FAULT.decode(record.line)
        return FaultState(number_of(found.fault), found.change, bytes(found.fault))
    except ValueError as error:
        raise RecordError(str(error)) from error


def number_of(fault: msgspec.Raw) -> int:
    """The number of a fault in JSON; raises ValueError where it has none, or one that is no topic's."""
    number = _NUMBERED.decode(fault).number
    if not 1 <= number < 10**10:
        raise ValueError(f"{number} is no number of a fault")
    return number


def cleared_in(record: Record) -> Sequence[int]:
    """The numbers in a record of schema `CLEARED`; raises as `fault_in`."""
    try:
        return _CLEARED.decode(record.line).numbers
    except ValueError as error:
        raise RecordError(str(error)) from error


def conditions_in(record: Record) -> msgspec.Raw:
    """The conditions in a record of schema `HEALTH`, as JSON; raises as `fault_in`."""
    try:
        return _HEALTH.decode(record.line).conditions
    except ValueError as error:
        raise RecordError(str(error)) from error
