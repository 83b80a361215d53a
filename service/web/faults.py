"""The fault memory in the terms of SOVD: pure views of the daemon's answers.

Source: field names and filters of ISO 17978-3 as the open implementations have them (Eclipse OpenSOVD's adapter and
fault library, ros2_medkit): camelCase status with "0" and "1", filters by full match of which any is enough.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Fault, Status
from faultline.service.protocol.answers import NO_FRAME, FreezeFrames
from faultline.service.protocol.live import FaultMeaning
from faultline.service.web.shapes import (
    Bit,
    Candidate,
    Detail,
    EnvironmentData,
    ExtendedData,
    FaultStatus,
    Item,
    Snapshot,
)

SCOPE = "Default"
"""There is one fault memory."""

STATUS_KEYS = (
    *("testFailed", "testFailedThisOperationCycle", "pendingDTC", "confirmedDTC", "testNotCompletedSinceLastClear"),
    *("testFailedSinceLastClear", "testNotCompletedThisOperationCycle", "warningIndicatorRequested"),
)
"""The bits, the lowest first."""
AGGREGATED = ("active", "passive", "cleared")

WARNED, NOT_WARNED = 2, 3  # of 1 fatal, 2 error, 3 warning, 4 information


def status_of(status: Status) -> FaultStatus:
    """Return the status byte in SOVD's terms."""
    bit: dict[bool, Bit] = {False: "0", True: "1"}
    return FaultStatus(
        aggregated_status=aggregated(status),
        test_failed=bit[status.test_failed],
        test_failed_this_operation_cycle=bit[status.test_failed_this_cycle],
        pending=bit[status.pending],
        confirmed=bit[status.confirmed],
        test_not_completed_since_last_clear=bit[status.not_completed_since_clear],
        test_failed_since_last_clear=bit[status.failed_since_clear],
        test_not_completed_this_operation_cycle=bit[status.not_completed_this_cycle],
        warning_indicator_requested=bit[status.warning],
        mask=f"0x{status.mask:02X}",
    )


def aggregated(status: Status) -> Literal["active", "passive", "cleared"]:
    """Return *active* if it is there, *passive* if it was, *cleared* if it only failed since the last clear."""
    if status.test_failed:
        return "active"
    return "passive" if status.pending or status.confirmed or status.warning else "cleared"


def item_of(fault: Fault, meanings: Mapping[str, FaultMeaning]) -> Item:
    """Return a fault as an entry of SOVD's list; `meanings` explain its candidates' names, and may lack some."""
    return Item(
        code=str(fault.number),
        scope=SCOPE,
        display_code=", ".join(f"{dtc.spn}-{dtc.fmi}" for dtc in fault.dtcs),
        fault_name=_name(fault.diagnoses, meanings),
        severity=WARNED if fault.status.warning else NOT_WARNED,
        status=status_of(fault.status),
        symptom=_symptom(fault),
        candidates=[_candidate(each, meanings) for each in fault.diagnoses],
    )


def detail_of(
    fault: Fault,
    meanings: Mapping[str, FaultMeaning],
    frames: FreezeFrames,
    *,
    extended: bool = True,
    snapshots: bool = True,
) -> Detail:
    """Return a fault with its counts (`extended`) and freeze frames (`snapshots`)."""
    environment = EnvironmentData()
    if snapshots:
        first, latest = Snapshot(record="first", data=frames.first), Snapshot(record="latest", data=frames.latest)
        environment = EnvironmentData(snapshots=[each for each in (first, latest) if each.data != NO_FRAME])
    if extended:
        environment = EnvironmentData(snapshots=environment.snapshots, extended_data_records=_extended(fault))
    return Detail(item=item_of(fault, meanings), environment_data=environment)


def selected(
    items: Iterable[Item], status: Mapping[str, frozenset[str]], severity: int | None, scope: str | None
) -> list[Item]:
    """Return those with any of the wanted status values (by key; all if none is wanted), that severity and scope."""
    return [
        item
        for item in items
        if (not status or any(value_of(item.status, key) in wanted for key, wanted in status.items()))
        and severity in (None, item.severity)
        and scope in (None, item.scope)
    ]


def value_of(status: FaultStatus, key: str) -> str:
    """Return the value of a status key: a bit, or `aggregatedStatus`."""
    if key == "aggregatedStatus":
        return status.aggregated_status
    return str(int(status.mask, 16) >> STATUS_KEYS.index(key) & 1)


def _candidate(diagnosis: Diagnosis, meanings: Mapping[str, FaultMeaning]) -> Candidate:
    components = (_component(name, meanings) for name in diagnosis.faults)
    return Candidate(
        components=[*dict.fromkeys(components)],
        faults=diagnosis.faults,
        p=diagnosis.p,
        rank=diagnosis.rank,
        near=diagnosis.near,
    )


def _component(fault: str, meanings: Mapping[str, FaultMeaning]) -> str:
    """Return the component that a fault's name stands for; the name if nothing explains it."""
    known = meanings.get(fault)
    return (known.component if known else "") or fault


def _name(diagnoses: Sequence[Diagnosis], meanings: Mapping[str, FaultMeaning]) -> str:
    """Return the best explanations in words; those of one rank are equally good."""
    best = min((each.rank for each in diagnoses), default=0)
    said = (_explanation(each, meanings) for each in diagnoses if each.rank == best)
    return " or ".join(dict.fromkeys(said)) or "unknown"


def _explanation(diagnosis: Diagnosis, meanings: Mapping[str, FaultMeaning]) -> str:
    if not diagnosis.faults:
        return f"unknown, near {', '.join(diagnosis.near)}" if diagnosis.near else "unknown"
    return " and ".join(_said(name, meanings) for name in diagnosis.faults)


def _said(fault: str, meanings: Mapping[str, FaultMeaning]) -> str:
    known = meanings.get(fault)
    if known is None:
        return fault
    return ": ".join(part for part in (known.component, known.description) if part) or fault


def _symptom(fault: Fault) -> str:
    """Return the tests and modes that showed the fault."""
    if not fault.tests:
        return "no test fired by itself: the residuals together have changed"
    modes = f" in mode {', '.join(fault.modes)}" if fault.modes else ""
    return f"tests {', '.join(fault.tests)} fired{modes}"


def _extended(fault: Fault) -> ExtendedData:
    known = {name: getattr(fault, name) for name in ExtendedData.__struct_fields__ if name != "candidates"}
    return ExtendedData(candidates=fault.diagnoses, **known)
