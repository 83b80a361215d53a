"""The evaluation of a bundle as data, schema `faultline.evaluation/1`: what `report.json` holds and the page shows."""

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from faultline.analysis.evaluation.blocks import joined, scored
from faultline.analysis.evaluation.judge import Verdict
from faultline.analysis.evaluation.measure.equal import equal_groups
from faultline.analysis.evaluation.measure.facts import EVERY_H, WITHIN_S, Facts
from faultline.analysis.evaluation.measure.intervals import Rate, Share, rate, share
from faultline.analysis.evaluation.measure.isolation import Isolation, isolations
from faultline.analysis.evaluation.measure.methods import Method, methods
from faultline.analysis.evaluation.measure.metrics import Scores, scores
from faultline.analysis.evaluation.measure.reached import Reached, reached
from faultline.analysis.evaluation.measure.selection import EXACT, REACHED, Reach, Selection, select
from faultline.analysis.evaluation.measure.signature import Cell, cells
from faultline.analysis.evaluation.measure.sizes import SizeTold
from faultline.analysis.limit.limits import Limits, limits_of
from faultline.service.bundle.load import Bundle
from faultline.service.core.display import Display, fitting
from faultline.service.logs.recording import is_simulated

SCHEMA: Final = "faultline.evaluation/1"


class Judged(msgspec.Struct, frozen=True, kw_only=True):
    """One recording: where it is from, its case, hours, the verdict, and times by DAMADICS [s]."""

    id: str
    source: str
    vehicle: str
    cycle: str
    case: str
    fault_free_hours: float
    faulty_hours: float
    detection_s: float | None
    isolation_s: float | None
    size: SizeTold | None
    verdict: Verdict


class Test(msgspec.Struct, frozen=True, kw_only=True):
    """One generator on fault-free data.

    `alarms`: episodes of its detector for each hour in which it could tell; `blocks`: blocks with an alarm. `rms` is
    that of the residual [`unit`], which people read in `display`. `equals` is the first generator that is numerically
    the same signal, itself or other.
    """

    generator: str
    test: str
    predicts: str
    unit: str
    display: list[Display]
    faults: list[str]
    states: int
    rms: float | None
    alarms: Rate
    blocks: Share
    cannot_tell: float
    equals: str

    def shown(self, size: float) -> Display:
        """Return the unit in which people read values up to `size`."""
        return fitting(self.display or [Display(unit=self.unit)], size)


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """What was told over all recordings; false alarms are told episodes of the fault-free parts.

    Their hours are those in which some test could tell.

    `shared`: where no probability was told, it was shared equally by the diagnoses of rank 1.
    """

    false_alarms: Rate
    scores: Scores
    shared: bool


class Evaluation(msgspec.Struct, frozen=True, kw_only=True):
    """Everything. `selection` is None where there are more generators than can be searched exactly.

    `limits` say what any detector could find, by the fault-free recordings; None where none is long enough, or where
    the bundle assumes no sizes. `reached` are the single faults beside it.
    """

    schema: str
    bundle: str
    bundle_id: str
    sensor_set: str
    made_for: str | None
    model: str
    simulated: bool
    faults: dict[str, str]
    modes: dict[str, str]
    mode_hours: dict[str, float]
    recordings: list[Judged]
    told: Told
    tests: list[Test]
    cells: list[Cell]
    isolation: list[Isolation]
    methods: list[Method]
    limits: Limits | None
    reached: list[Reached]
    selection: Selection | None


def evaluation(bundle: Bundle, of: Sequence[Facts], required: Sequence[tuple[str, str | None]] = ()) -> Evaluation:
    """The evaluation of a bundle over recordings, some of which are fault-free (`analysis.evaluation.given`)."""
    manifest = bundle.manifest
    known = [fault.name for fault in manifest.faults]
    modes = np.sum([one.modes.sum(axis=0) for one in of], axis=0)
    tests = _tests(bundle, of)
    found = cells(of, manifest.generators, known, scored(manifest))
    limits = _limits(bundle, of)
    return Evaluation(
        schema=SCHEMA,
        bundle=manifest.name,
        bundle_id=bundle.id,
        sensor_set=manifest.sensor_set,
        made_for=manifest.origin.vehicle,
        model=manifest.origin.model,
        simulated=all(is_simulated(one.given.recording.source) for one in of),
        faults={fault.name: ": ".join(filter(None, (fault.component, fault.description))) for fault in manifest.faults},
        modes={mode.name: mode.description for mode in manifest.modes.steady},
        mode_hours={
            m: round(float(n) * manifest.period_s / 3600.0, 4) for m, n in zip(manifest.modes.names, modes, strict=True)
        },
        recordings=[_judged(one) for one in of],
        told=Told(
            false_alarms=rate(sum(one.verdict.false_alarms for one in of), sum(one.free_hours for one in of)),
            scores=scores([one.told for one in of]),
            shared=any(one.told.shared for one in of),
        ),
        tests=tests,
        cells=found,
        isolation=isolations(of, known),
        methods=methods(of, manifest.generators, known),
        limits=limits,
        reached=[] if limits is None else reached(of, limits, manifest.evidence),
        selection=_selection(bundle, of, tests, found, required) if len(tests) <= EXACT else None,
    )


def _limits(bundle: Bundle, of: Sequence[Facts]) -> Limits | None:
    drives = {one.given.recording.id: one.limits for one in of if one.limits is not None}
    if not any(len(drive.apart) for drive in drives.values()):
        return None
    return limits_of(bundle.manifest, bundle.id, drives, EVERY_H, WITHIN_S)


def _judged(one: Facts) -> Judged:
    recording = one.given.recording
    return Judged(
        id=recording.id,
        source=recording.source,
        vehicle=recording.vehicle,
        cycle=recording.cycle,
        case=one.case.label,
        fault_free_hours=round(float(one.hours[0]), 4),
        faulty_hours=round(float(one.hours[1]), 4),
        detection_s=one.told.detection_s,
        isolation_s=one.told.isolation_s,
        size=one.size,
        verdict=one.verdict,
    )


def _tests(bundle: Bundle, of: Sequence[Facts]) -> list[Test]:
    generators = bundle.manifest.generators
    inputs = {channel.signal: channel for channel in bundle.manifest.inputs}
    blocks = joined([one.blocks for one in of])
    ticks = sum(int(one.ticks[0]) for one in of)
    equal = equal_groups([part for one in of for part in one.products])
    found = []
    for column, generator in enumerate(generators):
        usable = sum(int(one.usable[0, column]) for one in of)
        tells = blocks.tells[:, column] & ~blocks.faulty
        square = sum(float(one.square[0, column]) for one in of)
        found.append(
            Test(
                generator=generator.name,
                test=generator.test,
                predicts=generator.predicts,
                unit=inputs[generator.predicts].unit,
                display=inputs[generator.predicts].display,
                faults=generator.faults,
                states=len(generator.states),
                rms=float(np.sqrt(square / usable)) if usable else None,
                alarms=rate(sum(int(one.episodes[column]) for one in of), usable * bundle.manifest.period_s / 3600.0),
                blocks=share(int((blocks.alarms[:, column] & tells).sum()), int(tells.sum())),
                cannot_tell=round(1.0 - usable / ticks, 4),
                equals=generators[equal[column]].name,
            )
        )
    return found


def _selection(
    bundle: Bundle,
    of: Sequence[Facts],
    tests: Sequence[Test],
    found: Sequence[Cell],
    required: Sequence[tuple[str, str | None]],
) -> Selection:
    names = [test.generator for test in tests]
    known = [fault.name for fault in bundle.manifest.faults]
    faults = {one.case.label: one.case.faults for one in of}
    free = {test.generator: test.blocks for test in tests}
    reached = [
        Reach(case, faults[case], [_reaches(cell, free[cell.generator]) for cell in found if cell.case == case])
        for case in dict.fromkeys(cell.case for cell in found)
        if len(faults[case]) == 1 and faults[case][0] in known
    ]
    blocks = joined([one.blocks for one in of])
    return select(
        names,
        [test.faults for test in tests],
        [test.states for test in tests],
        reached,
        (blocks.alarms & blocks.tells)[~blocks.faulty],
        [names.index(test.equals) for test in tests],
        known,
        isolating(bundle),
        required,
    )


def isolating(bundle: Bundle) -> list[bool]:
    """Whether each generator's alarm is a conflict: those in a graph that hypotheses are predicted for."""
    generators = bundle.manifest.generators
    graphs = {g.graph for g in generators if g.name in bundle.manifest.evidence.generators}
    return [generator.graph in graphs for generator in generators]


def _reaches(cell: Cell, free: Share) -> bool:
    p = cell.alarm.p
    return bool(cell.sensitive) and p is not None and p >= REACHED and cell.alarm.low > free.high
