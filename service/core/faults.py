"""What is remembered of a fault, and the record that tells of it, schema `faultline.fault/1`.

Source: the status byte of ISO 14229-1 as a view (bits as in AUTOSAR SWS Diagnostics R22-11); SPN and FMI of SAE
J1939-73.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from faultline.service.core.events import Diagnosis
from faultline.service.core.manifest import MODES

SCHEMA = "faultline.fault/1"

Change = Literal[
    "pending",
    "confirmed",
    "failed",
    "refined",
    "withdrawn",
    "revoked",
    "passed",
    "settled",
    "aged",
    "displaced",
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

    spn: Annotated[int, Meta(ge=0, lt=2**19)]
    fmi: Annotated[int, Meta(ge=0, lt=2**5)]


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """The bits of ISO 14229-1's status byte, the lowest first."""

    test_failed: bool
    test_failed_this_cycle: bool
    pending: bool
    confirmed: bool
    not_completed_since_clear: bool
    failed_since_clear: bool
    not_completed_this_cycle: bool
    warning: bool

    @property
    def mask(self) -> int:
        """The byte."""
        return sum(bit << k for k, bit in enumerate(msgspec.structs.astuple(self)))


class Seen(msgspec.Struct, frozen=True, kw_only=True):
    """When: the event that told it, the wall clock (RFC 3339), and the operation cycle."""

    id: str
    wall: str | None
    cycle: Count


class Fault(msgspec.Struct, frozen=True, kw_only=True):
    """A remembered fault, or an ambiguity group: one thing that failed, with all that may explain it.

    `number` (from 1) is its name as long as it is remembered, and no other's after that. `system` is the name of the
    bundle that found it, `bundle` the SHA-256 of that one's manifest. `diagnoses` and `components` are the candidates
    as they were told last, best first; `dtcs` what they are on a J1939 network; `tests` those that fired and `modes`
    the operating modes that showed it: only where these were seen quiet in these, it has passed. `fdc` is the fault
    detection counter (-128 to 127). `occurrences` counts how often it failed after it had passed, `trips` the cycles
    in a row in which it failed, `healing` and `aging` those in which it passed.
    """

    number: Number
    system: str
    bundle: str
    diagnoses: list[Diagnosis]
    components: list[str]
    dtcs: list[Dtc]
    tests: list[str]
    modes: list[str]
    status: Status
    mask: Annotated[int, Meta(ge=0, lt=2**8)]
    fdc: Annotated[int, Meta(ge=-128, le=127)]
    occurrences: Number
    trips: Count
    healing: Count
    aging: Count
    first: Seen
    latest: Seen


class FaultRecord(msgspec.Struct, frozen=True, kw_only=True):
    """What has become of a fault; numbered with the events of the same source. `fault` is all of it after that."""

    schema: str
    id: str
    seq: int
    wall: str | None
    change: Change
    fault: Fault


class Cleared(msgspec.Struct, frozen=True, kw_only=True):
    """A person has erased these faults; schema `faultline.cleared/1`. `by` is who, as the control socket knows."""

    schema: str
    id: str
    seq: int
    wall: str | None
    numbers: list[int]
    by: str


CLEARED = "faultline.cleared/1"


def encode_record(record: FaultRecord | Cleared) -> bytes:
    """One line of JSON."""
    return msgspec.json.encode(record) + b"\n"


def decode_record(line: bytes) -> FaultRecord:
    """The record in one line of JSON; raises `msgspec.DecodeError` or `msgspec.ValidationError`."""
    return msgspec.json.decode(line, type=FaultRecord)


def decode_cleared(line: bytes) -> Cleared:
    """As `decode_record`, of faults that were erased."""
    return msgspec.json.decode(line, type=Cleared)


def check(fault: Fault, name: str) -> None:
    """Raise ValueError where the fault memory cannot go on with what was kept under `name`, by another version say."""
    if name != f"fault/{fault.number}":
        raise ValueError(f"is of fault {fault.number}")
    if unknown := [mode for mode in fault.modes if mode not in MODES]:
        raise ValueError(f"no operating mode is called {unknown[0]!r}; those are {', '.join(MODES)}")


def names(diagnoses: Sequence[Diagnosis]) -> frozenset[str]:
    """What they have in common with others if it is the same fault: faults, and places of what is unknown."""
    unknown = (f"unknown near {place}" for one in diagnoses if not one.faults for place in one.near or ["nothing"])
    return frozenset(name for one in diagnoses for name in one.faults).union(unknown)
