"""Remembered fault, and the record of its changes, schema `faultline.fault/1`.

Source: the status byte of ISO 14229-1 as a view (bits as in AUTOSAR SWS Diagnostics R22-11); SPN and FMI of SAE
J1939-73.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from faultline.service.core.records.event import Diagnosis

SCHEMA = "faultline.fault/1"

Change = Literal[
    "pending", "confirmed", "failed", "refined", "withdrawn", "revoked", "passed", "settled", "aged", "displaced"
]
"""pending: failed, in fewer operation cycles than confirm it. confirmed: failed in as many. failed: one that was
confirmed before, and had passed, is there again. refined: its candidates changed. withdrawn: what looked like it again
was something else, or rested on samples that came to be doubted. revoked: the same of one that was not remembered
before; it is erased. passed: it is not there any more. settled: a cycle without it ended, and its status changed. aged:
so many cycles without it that it is erased. displaced: erased for want of room. Erased by a person: `Cleared`."""

ERASED: frozenset[str] = frozenset(("revoked", "aged", "displaced"))
"""Changes after which the fault is not remembered any more."""


Number = Annotated[int, Meta(ge=1, lt=2**53)]
Count = Annotated[int, Meta(ge=0, lt=2**53)]


class Dtc(msgspec.Struct, frozen=True, kw_only=True, order=True):
    """A diagnostic trouble code of SAE J1939-73: suspect parameter (19 bits) and failure mode (5 bits)."""

    spn: Annotated[int, Meta(ge=0, lt=2**19, description="suspect parameter number")]
    fmi: Annotated[int, Meta(ge=0, lt=2**5, description="failure mode identifier")]


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """The bits of ISO 14229-1's status byte, the lowest first."""

    test_failed: Annotated[bool, Meta(description="it is there now")]
    test_failed_this_cycle: Annotated[bool, Meta(description="it was, in this operation cycle")]
    pending: Annotated[bool, Meta(description="it failed in this cycle or the last")]
    confirmed: Annotated[bool, Meta(description="it failed in as many cycles as confirm it")]
    not_completed_since_clear: Annotated[bool, Meta(description="nobody could tell since all were erased")]
    failed_since_clear: Annotated[bool, Meta(description="it failed since all were erased")]
    not_completed_this_cycle: Annotated[bool, Meta(description="nobody could tell in this cycle")]
    warning: Annotated[bool, Meta(description="it is warned of")]

    @property
    def words(self) -> str:
        """Return the status for a person."""
        kind = "confirmed" if self.confirmed else "pending" if self.pending else "was pending"
        return f"{'is there' if self.test_failed else 'is not there any more'}, {kind}"

    @property
    def mask(self) -> int:
        """Return the byte."""
        return sum(bit << k for k, bit in enumerate(msgspec.structs.astuple(self)))


class Seen(msgspec.Struct, frozen=True, kw_only=True):
    """Time of an occurrence: the event, the wall clock (RFC 3339), and the operation cycle."""

    id: Annotated[str, Meta(description="of the event")]
    wall: Annotated[str | None, Meta(description="wall clock (RFC 3339)")]
    cycle: Annotated[Count, Meta(description="number of the operation cycle")]


class Fault(msgspec.Struct, frozen=True, kw_only=True):
    """A remembered fault, or an ambiguity group: one thing that failed, with all that may explain it."""

    number: Annotated[Number, Meta(description="its name as long as it is remembered, and no other's after that")]
    system: Annotated[str, Meta(description="the bundle's name (`name@bus` where two have the same)")]
    bundle: Annotated[str, Meta(description="SHA-256 of the manifest of the bundle that saw it last")]
    diagnoses: Annotated[list[Diagnosis], Meta(description="the candidates as they were told last, as in an event")]
    components: Annotated[list[str], Meta(description="those of the candidates, best first; none for what is unknown")]
    dtcs: Annotated[
        list[Dtc],
        Meta(
            description="`spn` and `fmi` (SAE J1939-73) of each fault where one explanation is left; 520192 with FMI "
            "11 where several are, with FMI 31 where it is no known one. Empty where the model gives "
            "none"
        ),
    ]
    tests: Annotated[list[str], Meta(description="those that fired")]
    modes: Annotated[
        list[str],
        Meta(
            description="operating modes that showed it: only where its tests were seen quiet in these, it has passed"
        ),
    ]
    status: Annotated[Status, Meta(description="the eight bits of ISO 14229-1, by name")]
    mask: Annotated[int, Meta(ge=0, lt=2**8, description="the same as a byte")]
    fdc: Annotated[int, Meta(ge=-128, le=127, description="fault detection counter, -128 (passed) to 127 (failed)")]
    occurrences: Annotated[Number, Meta(description="how often it failed after it had passed, from 1")]
    trips: Annotated[Count, Meta(description="operation cycles in a row in which it failed")]
    healing: Annotated[Count, Meta(description="cycles in a row without it, while it is warned of")]
    aging: Annotated[Count, Meta(description="and those after that")]
    first: Annotated[Seen, Meta(description="when it was told first")]
    latest: Annotated[Seen, Meta(description="and when last")]


class FaultRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Record of a change of a fault."""

    schema: Annotated[str, Meta(description="`faultline.fault/1`")]
    id: Annotated[str, Meta(description="as of an event")]
    seq: Annotated[int, Meta(description="as of an event")]
    wall: Annotated[str | None, Meta(description="as of an event")]
    change: Annotated[Change, Meta(description="see below")]
    fault: Annotated[Fault, Meta(description="all of it, after that")]


class Cleared(msgspec.Struct, frozen=True, kw_only=True):
    """Record that a person has erased faults."""

    schema: Annotated[str, Meta(description="`faultline.cleared/1`")]
    id: Annotated[str, Meta(description="as of an event")]
    seq: Annotated[int, Meta(description="as of an event")]
    wall: Annotated[str | None, Meta(description="as of an event")]
    numbers: Annotated[list[int], Meta(description="of the faults that were erased")]
    by: Annotated[str, Meta(description="the user who did it, as the kernel knows")]


CLEARED = "faultline.cleared/1"


def check(fault: Fault, name: str) -> None:
    """Raise ValueError where the fault memory cannot go on with what was kept under `name`, by another version say."""
    if name != f"fault/{fault.number}":
        raise ValueError(f"is of fault {fault.number}")


def names(diagnoses: Sequence[Diagnosis]) -> frozenset[str]:
    """Return the names by which diagnoses are of the same fault: faults, places of what is unknown, else only that."""
    unknown = (f"unknown near {place}" for one in diagnoses if not one.faults for place in one.near)
    known = frozenset(name for one in diagnoses for name in one.faults).union(unknown)
    return known or frozenset("unknown" for _ in diagnoses)
