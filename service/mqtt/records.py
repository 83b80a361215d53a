"""What records say of faults and health, as JSON that is handed on as it came; schemas that are not known are, too."""

from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from faultline.service.protocol.errors import UNREADABLE
from faultline.service.protocol.records import Record, RecordError, part_of


class FaultState(NamedTuple):
    """What a record says of one fault: its number, what has become of it, and all of it as JSON."""

    number: int
    change: str
    content: bytes


def fault_in(record: Record) -> FaultState:
    """Return what a record of a fault says; raises RecordError where it says nothing of the kind."""
    fault = part_of(record.parts, "fault", msgspec.Raw)
    return FaultState(number_of(fault), part_of(record.parts, "change", str), bytes(fault))


def number_of(fault: msgspec.Raw) -> int:
    """Return the number of a fault in JSON; raises RecordError where it has none, or one that is no topic's."""
    try:
        number = part_of(msgspec.json.decode(fault, type=dict[str, msgspec.Raw]), "number", int)
    except UNREADABLE as error:
        raise RecordError(f"a fault without a number: {error}") from error
    if not 1 <= number < 10**10:
        raise RecordError(f"a fault without a number: {number} is none")
    return number


def cleared_in(record: Record) -> Sequence[int]:
    """Return the numbers in a record of erased faults; raises as `fault_in`."""
    return part_of(record.parts, "numbers", list[int])


def conditions_in(record: Record) -> msgspec.Raw:
    """Return the conditions in a record of health, as JSON; raises as `fault_in`."""
    return part_of(record.parts, "conditions", msgspec.Raw)
