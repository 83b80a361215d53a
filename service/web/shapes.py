"""Bodies of HTTP answers, a struct each; the API document is made from these.

Source of the names of faults: ISO 17978-3 (SOVD), as far as open implementations show them (docs/http.md).
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Dtc, Seen
from faultline.service.core.records.health import Standing
from faultline.service.protocol.answers import BusStatus, StoreStatus, SystemStatus

Bit = Literal["0", "1"]
Code = Annotated[str, Meta(pattern="^[1-9][0-9]*$")]


class _Body(msgspec.Struct, frozen=True, kw_only=True):
    """Common: by name, and never changed."""


class Component(_Body, frozen=True):
    """A watched system as a component of the vehicle; `href` is where it is described."""

    id: str
    name: str
    href: str


class Components(_Body, frozen=True):
    """All components of the vehicle."""

    items: list[Component]


class Capabilities(_Body, frozen=True):
    """A component, and where to ask for what it has; `history` is of a finished recording alone."""

    id: str
    name: str
    faults: str
    system: str
    live: str
    history: str | None = None


class FaultStatus(_Body, frozen=True, rename="camel"):
    """The status byte of ISO 14229-1: in `mask`, and bit by bit; `aggregatedStatus` is all of it in a word."""

    aggregated_status: Literal["active", "passive", "cleared"]
    test_failed: Bit
    test_failed_this_operation_cycle: Bit
    pending: Bit = msgspec.field(name="pendingDTC")
    confirmed: Bit = msgspec.field(name="confirmedDTC")
    test_not_completed_since_last_clear: Bit
    test_failed_since_last_clear: Bit
    test_not_completed_this_operation_cycle: Bit
    warning_indicator_requested: Bit
    mask: Annotated[str, Meta(pattern="^0x[0-9A-F]{2}$")]


class Candidate(_Body, frozen=True):
    """An explanation: all of `faults`, in `components`, together; where it is unknown, what it is `near`.

    `p` and `rank` are as in docs/events.md.
    """

    components: list[str]
    faults: list[str]
    p: float | None
    rank: int
    near: list[str]


class Item(_Body, frozen=True):
    """A remembered fault. `code` is its number; `display_code` lists SPN-FMI; `severity` is 2 where it is warned of."""

    code: Code
    scope: str
    display_code: str
    fault_name: str
    severity: Annotated[int, Meta(ge=1, le=4)]
    status: FaultStatus
    symptom: str
    candidates: list[Candidate]


class Items(_Body, frozen=True):
    """Remembered faults, the oldest first."""

    items: list[Item]


class Snapshot(_Body, frozen=True):
    """A freeze frame: of the first time, or of the latest; schema `faultline.frame/1`."""

    record: Literal["first", "latest"]
    data: Any


class ExtendedData(_Body, frozen=True):
    """Counters of a fault, and what showed it (docs/events.md)."""

    occurrences: int
    trips: int
    healing: int
    aging: int
    fdc: int
    first: Seen
    latest: Seen
    candidates: list[Diagnosis]
    components: list[str]
    dtcs: list[Dtc]
    tests: list[str]
    modes: list[str]
    bundle: str


class EnvironmentData(_Body, frozen=True, omit_defaults=True):
    """Environment data of a fault; parts that were not requested are left out."""

    snapshots: list[Snapshot] | msgspec.UnsetType = msgspec.UNSET
    extended_data_records: ExtendedData | msgspec.UnsetType = msgspec.UNSET


class Detail(_Body, frozen=True):
    """One fault with its environment data."""

    item: Item
    environment_data: EnvironmentData


class HealthBody(_Body, frozen=True):
    """Health of the daemon, for clients that must not take silence for "no fault".

    `status`: *well*; *degraded*, something stands and it can tell; *blind*, something stands that keeps a system from
    telling at all; *away*, it does not answer. `cursor` is the number of the last record that was told.
    """

    status: Literal["well", "degraded", "blind", "away"]
    detail: str
    source: str | None = None
    version: str | None = None
    since: str | None = None
    wall: str | None = None
    cycle: int | None = None
    cursor: int | None = None
    conditions: list[Standing] = []
    store: StoreStatus | None = None
    buses: list[BusStatus] = []
    systems: list[SystemStatus] = []


class Ready(_Body, frozen=True):
    """Readiness: this server listens and the daemon answers."""

    ready: Literal[True] = True


class Problem(_Body, frozen=True):
    """Problem document (RFC 9457); `code` is the last part of `type`."""

    type: str
    title: str
    status: Annotated[int, Meta(ge=400, le=599)]
    detail: str
    code: str
