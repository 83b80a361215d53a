"""A record as a CloudEvent, structured mode in JSON.

Source: CloudEvents 1.0.2 with its JSON format, MQTT binding 3.2 and `sequence` extension: a string whose order is that
of its characters, hence the zeros.
"""

import datetime
import re

import msgspec

from faultline.service.core.records.context import SCHEMA as CONTEXT
from faultline.service.core.records.event import SCHEMA as EVENT
from faultline.service.core.records.fault import CLEARED
from faultline.service.core.records.fault import SCHEMA as FAULT
from faultline.service.core.records.health import SCHEMA as HEALTH
from faultline.service.protocol.errors import UNREADABLE
from faultline.service.protocol.records import Record

CONTENT_TYPE = "application/cloudevents+json"
DIGITS = 20
"""Of `sequence`: enough for 64 bits."""

_SCHEMA = re.compile(r"faultline\.([a-z][a-z0-9-]*)/([0-9]{1,6})")
_WORD = re.compile(r"[a-z][a-z_]*")


class _CloudEvent(msgspec.Struct, omit_defaults=True):
    specversion: str
    id: str
    source: str
    type: str
    datacontenttype: str
    sequence: str
    data: msgspec.Raw
    subject: str | None = None
    time: str | None = None


def source(vehicle: str) -> str:
    """The vehicle as a URN, which no broker or prefix is part of: it stays what it is wherever the event goes."""
    return f"urn:faultline:{vehicle}"


def structured(record: Record, vehicle: str) -> bytes:
    """The CloudEvent; the same bytes whenever it is made of the same record."""
    fields = _fields(record)
    return msgspec.json.encode(
        _CloudEvent(
            specversion="1.0",
            id=record.id,
            source=source(vehicle),
            type=_type(record, fields),
            datacontenttype="application/json",
            sequence=f"{record.seq:0{DIGITS}d}",
            data=msgspec.Raw(record.line),
            subject=_subject(record, fields),
            time=_time(record.wall),
        )
    )


def _fields(record: Record) -> dict[str, object]:
    """All that the record says; nothing where it is no object of ours, which has no subject."""
    try:
        return msgspec.json.decode(record.line, type=dict[str, object])
    except UNREADABLE:
        return {}


def _type(record: Record, fields: dict[str, object]) -> str:
    """`io.faultline.` and what it is; of an unknown schema with its version, as its meaning is not known here."""
    word = {EVENT: fields.get("transition"), FAULT: fields.get("change")}.get(record.schema)
    stem = {EVENT: "event", FAULT: "fault", HEALTH: "health", CLEARED: "cleared", CONTEXT: "context"}.get(record.schema)
    if stem is not None:
        return f"io.faultline.{stem}" + (f".{word}" if isinstance(word, str) and _WORD.fullmatch(word) else "")
    schema = _SCHEMA.fullmatch(record.schema)
    return f"io.faultline.{schema[1]}.v{schema[2]}" if schema else "io.faultline.record"


def _subject(record: Record, fields: dict[str, object]) -> str | None:
    """The number of the fault; of an event the system, or the bundle that decided; None where it is of all."""
    fault, numbers = fields.get("fault"), fields.get("numbers")
    subject: object = None
    if record.schema == FAULT and isinstance(fault, dict):
        number = fault.get("number")
        subject = str(number) if isinstance(number, int) else None
    elif record.schema == CLEARED and isinstance(numbers, list) and len(numbers) == 1:
        subject = str(numbers[0])
    elif record.schema == EVENT:
        subject = fields.get("system") or fields.get("bundle")
    return subject if isinstance(subject, str) and subject else None


def _time(wall: str | None) -> str | None:
    """The wall clock's time, if it is one (RFC 3339, with its offset)."""
    if wall is None:
        return None
    try:
        time = msgspec.convert(wall, datetime.datetime)
    except ValueError:
        return None
    return wall if time.tzinfo is not None else None
