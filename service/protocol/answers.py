"""Answers of the control socket, but for live ticks and what names mean (`service.protocol.live`)."""

from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Fault
from faultline.service.core.records.health import Standing

STATE = "faultline.state/2"
"""Schema of `ServiceState`; 1, in which `suspected` was what `anomaly` is now, had no `schema`."""


NO_FRAME = msgspec.Raw(b"null")


class StoreStatus(msgspec.Struct, frozen=True, kw_only=True):
    """The store of records."""

    path: Annotated[str | None, Meta(description="its file; null: none")] = None
    kept: Annotated[int, Meta(description="number of the last record that is on the disk")] = 0
    failing: Annotated[bool, Meta(description="the disk takes nothing now")] = False


class BusStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A bus, with its counts since the service started."""

    name: Annotated[str, Meta(description="as in the configuration")]
    interface: Annotated[str, Meta(description="as `socketcan:can0`; of a recording its file")] = ""
    frames: Annotated[int, Meta(description="received")] = 0
    dropped: Annotated[int, Meta(description="lost")] = 0
    errors: Annotated[int, Meta(description="error frames")] = 0
    trouble: Annotated[
        str | None, Meta(description="`down`, `removed`, `bus-off`, `error-passive`; null where it can be used")
    ] = None


class BaselineStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A baseline that a system learns anew, or has learnt, instead of its bundle's."""

    since: Annotated[str | None, Meta(description="when that was asked for (RFC 3339)")]
    by: Annotated[str, Meta(description="by whom")]
    learnt: Annotated[bool, Meta(description="it has been learnt; until then no test can tell")]
    wanting: Annotated[list[str], Meta(description="operating modes of which more has to be seen")] = []


class SystemStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A watched system, and what its tests say now."""

    name: Annotated[str, Meta(description="the bundle's name (`name@bus` where two have the same)")]
    bundle: Annotated[str, Meta(description="SHA-256 of its manifest")] = ""
    bus: Annotated[str, Meta(description="the bus it listens to")] = ""
    tick: Annotated[int | None, Meta(description="the last sample; null before the first")] = None
    alarm: Annotated[list[str], Meta(description="as in an event")] = []
    cannot_tell: Annotated[list[str], Meta(description="as in an event; all tests before the first sample")] = []
    suspected: Annotated[bool, Meta(description="as in an event")] = False
    anomaly: Annotated[bool, Meta(description="as in a live tick")] = False
    diagnoses: Annotated[list[Diagnosis], Meta(description="as in an event")] = []
    baseline: Annotated[BaselineStatus | None, Meta(description="in place of the bundle's; null: the bundle's")] = None


class ServiceState(msgspec.Struct, frozen=True, kw_only=True):
    """The service: its vehicle and version, what stands, its store, buses and systems."""

    schema: Annotated[str, Meta(description=f"`{STATE}`")] = STATE
    source: Annotated[str, Meta(description="the vehicle's name")]
    version: Annotated[str, Meta(description="of faultline")]
    since: Annotated[str | None, Meta(description="when it started (RFC 3339)")] = None
    wall: Annotated[str | None, Meta(description="the wall clock now (RFC 3339)")] = None
    is_recording: Annotated[bool, Meta(description="it listens to no vehicle, but serves a finished recording")] = False
    cycle: Annotated[int, Meta(description="number of the operation cycle")] = 0
    seq: Annotated[int, Meta(description="number of the last record")]
    conditions: Annotated[list[Standing], Meta(description="what stands, as in [health](events.md#health)")] = []
    store: Annotated[StoreStatus | None, Meta(description="where records are kept")] = None
    buses: Annotated[list[BusStatus], Meta(description="what it listens to")] = []
    systems: Annotated[list[SystemStatus], Meta(description="what it watches")] = []


class FaultList(msgspec.Struct, frozen=True, kw_only=True):
    """The fault memory."""

    faults: Annotated[list[Fault], Meta(description="what is remembered, oldest number first")]
    overflow: Annotated[bool, Meta(description="a fault was displaced since all were erased last")] = False
    seq: Annotated[int, Meta(description="number of the last record")] = 0


class FreezeFrames(msgspec.Struct, frozen=True, kw_only=True):
    """The [freeze frames](events.md#freeze-frames) of a fault, as they are kept."""

    first: Annotated[msgspec.Raw, Meta(description="when it was told first")] = NO_FRAME
    latest: Annotated[msgspec.Raw, Meta(description="when last; null where it occurred once")] = NO_FRAME


class FaultDetail(msgspec.Struct, frozen=True, kw_only=True):
    """One fault with its freeze frames."""

    fault: Annotated[Fault, Meta(description="the fault")]
    frames: Annotated[FreezeFrames, Meta(description="its freeze frames")] = FreezeFrames()


class Erased(msgspec.Struct, frozen=True, kw_only=True):
    """Faults that were erased; that is on the disk."""

    cleared: Annotated[list[int], Meta(description="their numbers")]
    id: Annotated[str, Meta(description="of the record that says so")] = ""


class Begun(msgspec.Struct, frozen=True, kw_only=True):
    """A baseline that is learnt anew from now on."""

    system: Annotated[str, Meta(description="its name")]
    baseline: Annotated[BaselineStatus, Meta(description="as in the state")]


class RecordPage(msgspec.Struct, frozen=True, kw_only=True):
    """Records of the event socket."""

    records: Annotated[list[msgspec.Raw], Meta(description="as they were sent, oldest first")]
