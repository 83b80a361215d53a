"""The result of a test as one document, schema `faultline.workshop/1` (docs/workshop.md)."""

from collections.abc import Sequence

import msgspec

from faultline.service.core.records.fault import Fault as Remembered
from faultline.service.core.records.health import Standing
from faultline.service.protocol.answers import ServiceState
from faultline.service.protocol.live import SystemDescription
from faultline.service.workshop.cycle import Cycle, End
from faultline.service.workshop.verdict import Seen, Verdict, judge, required_s

SCHEMA = "faultline.workshop/1"


class StepSeen(msgspec.Struct, frozen=True, kw_only=True):
    """A step: seconds that were required and that counted."""

    mode: str
    visit: int
    required_s: float
    seen_s: float
    done: bool


class TestSeen(msgspec.Struct, frozen=True, kw_only=True):
    """A test: its verdict at the end, whether it alarmed ever, its largest sum in parts of the threshold with its sign.

    `seen_s` [s] is how long it could tell, by mode.
    """

    test: str
    predicts: list[str]
    faults: list[str]
    verdict: str
    alarmed: bool
    worst: float
    seen_s: dict[str, float]


class RememberedSeen(msgspec.Struct, frozen=True, kw_only=True):
    """Remembered fault; `during_test`: it occurred, or occurred again, in the test."""

    fault: Remembered
    during_test: bool


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """The whole result; `begun` and `ended` are wall clock times (RFC 3339), `seconds` [s] is log time."""

    schema: str
    source: str
    system: str
    sensor_set: str
    service: str
    bundle: str
    bundle_version: int
    begun: str
    ended: str
    seconds: float
    end: End
    note: str | None
    verdict: Verdict
    steps: list[StepSeen]
    required_s: dict[str, float]
    tests: list[TestSeen]
    suspicions: int
    restarts: int
    conditions: list[Standing]
    conditions_before: list[Standing]
    remembered: list[RememberedSeen]
    report: str | None = None


class Frame(msgspec.Struct, frozen=True, kw_only=True):
    """Circumstances of the cycle: the service before it, faults remembered then, the person's note, the times."""

    state: ServiceState
    before: Sequence[Remembered]
    begun: str
    note: str | None


def result(cycle: Cycle, frame: Frame, end: End, ended: str, seen: Seen) -> Result:
    """Return the document of a cycle that has ended at the wall clock time `ended`."""
    system, progress = cycle.system, cycle.progress
    return Result(
        schema=SCHEMA,
        source=frame.state.source,
        system=system.name,
        sensor_set=system.sensor_set,
        service=frame.state.version,
        bundle=system.bundle,
        bundle_version=system.version,
        begun=frame.begun,
        ended=ended,
        seconds=round(cycle.elapsed_s, 1),
        end=end,
        note=frame.note,
        verdict=judge(cycle, end, seen),
        steps=[
            StepSeen(
                mode=step.mode,
                visit=step.visit,
                required_s=step.hold_s,
                seen_s=round(progress.seconds[k], 1),
                done=progress.is_done(k),
            )
            for k, step in enumerate(progress.steps)
        ],
        required_s=required_s(cycle),
        tests=[_test(cycle, system, test) for test in system.tests],
        suspicions=cycle.suspicions,
        restarts=cycle.restarts,
        conditions=[*seen.conditions],
        conditions_before=[*frame.state.conditions],
        remembered=[
            RememberedSeen(fault=each, during_test=_is_new(each, frame.before))
            for each in seen.remembered
            if each.system == system.name
        ],
    )


def _test(cycle: Cycle, system: SystemDescription, test: str) -> TestSeen:
    rows = [row for row in system.generators if row.test == test]
    tick = cycle.latest
    verdict = "cannot tell" if tick is None or test in tick.cannot_tell else "alarm" if test in tick.alarm else "quiet"
    return TestSeen(
        test=test,
        predicts=list(dict.fromkeys(row.predicts for row in rows)),
        faults=list(dict.fromkeys(name for row in rows for name in row.faults)),
        verdict=verdict,
        alarmed=test in cycle.alarmed,
        worst=round(cycle.worst[test], 3),
        seen_s={mode: round(cycle.seconds[test][mode], 1) for mode in cycle.modes},
    )


def _is_new(fault: Remembered, before: Sequence[Remembered]) -> bool:
    return all(each.number != fault.number or each.occurrences < fault.occurrences for each in before)
