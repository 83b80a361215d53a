"""Messages of the event socket: the subscription, and the records of five schemas that answer it.

A record is an `Event`, a `Health`, a `FaultRecord`, a `Cleared` or a `Context`; `Record` is the header that all of them
have, with the line as it came, so that a client can hand on what it does not know.
"""

import re
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta

from faultline.service.core.records.context import Context
from faultline.service.core.records.event import Event
from faultline.service.core.records.fault import Cleared, FaultRecord
from faultline.service.core.records.health import Health
from faultline.service.protocol.errors import UNREADABLE

RECORDS = (Event, FaultRecord, Cleared, Health, Context)
"""The records of this version, by the schemas of docs/events.md."""

T = TypeVar("T")
_ID = re.compile(r"(.+?)(?:-[0-9a-f]{8})?-[0-9]+", re.DOTALL)


class Subscription(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The one line that a client of the event socket sends."""

    after: Annotated[
        int | str | None,
        Meta(description="number or id of the record after which the stream begins; left out: from now on"),
    ] = None


def number_in(identifier: str) -> int | None:
    """Return the number that an id of a record ends with; None where it has another form."""
    tail = identifier.rpartition("-")[2]
    return int(tail) if tail.isascii() and tail.isdecimal() and len(tail) < 16 else None


class RecordError(ValueError):
    """A line that is no record."""


class Header(msgspec.Struct, frozen=True):
    """The fields that every record begins with."""

    id: str
    seq: int
    schema: str = ""
    wall: object = None


class Record(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """One record as a client received it.

    `line` is its JSON without the end of the line; `epoch` the number of the connection that brought it, from 1;
    `lost` how many records before it, by their numbers, the service did not give.
    """

    id: str
    seq: int
    schema: str
    wall: str | None
    line: bytes
    epoch: int = 0
    lost: int = 0

    @property
    def kind(self) -> str:
        """The schema's name without its version: event, fault, cleared, health, context."""
        return self.schema.removeprefix("faultline.").partition("/")[0]

    @property
    def vehicle(self) -> str | None:
        """The name that the id begins with; None where the id has another form."""
        found = _ID.fullmatch(self.id)
        return found.group(1) if found else None

    @cached_property
    def parts(self) -> dict[str, msgspec.Raw]:
        """The JSON of each field, as it came."""
        return _PARTS.decode(self.line)


def part_of(parts: Mapping[str, msgspec.Raw], name: str, kind: type[T]) -> T:
    """Return a field of what came as JSON, by field; raises RecordError where it is missing or of another type."""
    if name not in parts:
        raise RecordError(f"has no field `{name}`")
    try:
        return msgspec.json.decode(parts[name], type=kind)
    except UNREADABLE as error:
        raise RecordError(f"`{name}`: {error}") from error


_HEADER = msgspec.json.Decoder(Header)
_PARTS = msgspec.json.Decoder(dict[str, msgspec.Raw])


def read(line: bytes, epoch: int = 0) -> Record:
    """Return the record in one line of JSON, which connection number `epoch` brought.

    Raises:
        RecordError: it is none: no UTF-8, no JSON, without an id or a number.
    """
    line = line.strip()
    try:
        line.decode()  # what is passed on unread must be text all the same
        header = _HEADER.decode(line)
    except UNREADABLE as error:
        raise RecordError(str(error)) from error
    if not header.id or not 1 <= header.seq < 2**63:
        raise RecordError("without an id, or with a number that is none")
    wall = header.wall if isinstance(header.wall, str) else None
    return Record(id=header.id, seq=header.seq, schema=header.schema, wall=wall, line=line, epoch=epoch)
