"""What may be found out about a discovery besides: parameters, structure, bundle, experiment, fault; as documents."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import msgspec

from faultline.analysis.discrepancy.add.bundle_effect import Bundled, BundleEffect
from faultline.analysis.discrepancy.add.drift import Drifts
from faultline.analysis.discrepancy.add.structure_change import StructureChange
from faultline.analysis.discrepancy.effects.experiments import NO_EXPERIMENTS, Experiments
from faultline.analysis.discrepancy.find.onset import Onset
from faultline.analysis.discrepancy.name.experiment import Plan
from faultline.analysis.discrepancy.name.gauge import Gauge
from faultline.analysis.discrepancy.show import document
from faultline.analysis.model.display import Units


@dataclass(frozen=True, kw_only=True)
class Extras:
    """Optional findings; of the `plans`, that of the first of the `experiments` that is proposed.

    `refused` are reasons why the effects should not be added to the model, `applied` tells that a model with them is
    written.
    """

    drifts: Drifts | None = None
    structure: StructureChange | None = None
    bundle: BundleEffect | None = None
    plans: Sequence[Plan] = ()
    experiments: Experiments = NO_EXPERIMENTS
    gauge: Gauge | None = None
    proposal: document.Proposal | None = None
    onset: Onset | None = None
    refused: Sequence[str] = ()
    applied: bool = False


def drifts_of(drifts: Drifts | None) -> tuple[document.Drift, ...] | None:
    """All parameters, if it was asked for."""
    if drifts is None:
        return None
    return tuple(
        document.Drift(
            name=d.name,
            description=d.description,
            unit=d.unit,
            datasheet=d.datasheet,
            before=d.without,
            after=d.with_it,
            distance_before=d.before,
            distance_after=d.after,
        )
        for d in drifts.parameters
    )


def section(sentences: Sequence[str], data: StructureChange | Onset | None = None) -> document.Section:
    """What was found out, in words and for programs."""
    return document.Section(sentences=tuple(sentences), data=msgspec.to_builtins(asdict(data)) if data else {})


def experiment_section(plan: Plan) -> document.Section:
    """What the experiment is, and what is to be expected of it."""
    experiment = plan.experiment
    record = f"record {experiment.text} ({experiment.name}, {experiment.duration_s:.0f} s)"
    unresolved = "; ".join(f"{a} or {b}" for a, b in plan.unresolved)
    if plan.resolved:
        least, surest = (
            min(plan.resolved.values()),
            min(min(plan.likely[a, b], plan.likely[b, a]) for a, b in plan.resolved),
        )
        sentence = f"{record}: at least {least:.0f} nats of evidence are expected for the right candidate, and that "
        sentence += f"rules a wrong one out with a probability of at least {min(surest, 0.99):.2f}"
        if unresolved:
            sentence += f", but it will not tell whether it is {unresolved}"
    else:
        sentence = "no experiment that can be planned is expected to tell the candidates apart"
    if plan.beyond:
        sentence += f"; it was not planned for {', '.join(plan.beyond)}"
    data = {
        "name": experiment.name,
        "duration_s": experiment.duration_s,
        "left": plan.left,
        "tells": bool(plan.resolved),
        "expected": [
            {"true": true, "rival": rival, "nats": nats, "probability": plan.likely[true, rival]}
            for (true, rival), nats in plan.expected.items()
        ],
    }
    return document.Section(sentences=(sentence,), data=data)


def gauge_section(gauge: Gauge, units: Units) -> document.Section:
    """What a gauge would read, by rival."""
    shown = units.of(gauge.unit)
    values = "; ".join(
        f"{shown.short(mean)} +- {shown.difference(sd)} if it is {name}" for name, (mean, sd) in gauge.expected.items()
    )
    where = f"{gauge.description} ({gauge.variable})" if gauge.description else gauge.variable
    absolute = "absolute, " if gauge.unit == "Pa" else ""  # a gauge shows what is above the atmosphere's
    sentence = f"read {where} with a gauge of the workshop, {absolute}in mode {gauge.mode} on average: {values}"
    return document.Section(sentences=(sentence,), data=msgspec.to_builtins(asdict(gauge)))


def bundle_section(effect: BundleEffect) -> document.Section:
    """Both bundles: what their tests tolerate, their false alarms and their verdicts by recording."""
    data = {"tolerances": effect.tolerances, "before": _bundled(effect.before), "after": _bundled(effect.after)}
    return document.Section(sentences=tuple(effect.sentences()), data=data)


def _bundled(bundled: Bundled) -> dict[str, object]:
    return {
        "generators": [generator.test for generator in bundled.generators],
        "tolerated": [*bundled.tolerated],
        "false_alarms": bundled.false_alarms,
        "fault_free_s": round(3600.0 * bundled.hours, 3),
        "verdicts": {name: msgspec.to_builtins(judged.verdict) for name, judged in bundled.judged.items()},
        "reason": bundled.reason,
    }
