"""A discovery told: the document made of what a search came to, with what else was found out."""

from collections.abc import Iterator, Sequence
from math import isfinite

from msgspec import structs

from faultline.analysis.discrepancy.add.held_out import Gap, Shown
from faultline.analysis.discrepancy.add.whiteness import Whiteness
from faultline.analysis.discrepancy.data import Data
from faultline.analysis.discrepancy.discover import Discovery
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.find.locate import Location, Suspect
from faultline.analysis.discrepancy.name.attempt import Attempt
from faultline.analysis.discrepancy.name.sensitivity import alike, smallest_sizes
from faultline.analysis.discrepancy.show import document as told
from faultline.analysis.discrepancy.show.extras import (
    Extras,
    bundle_told,
    drifts_told,
    experiment_told,
    gauge_told,
    section,
)
from faultline.analysis.discrepancy.show.sizes import sizes
from faultline.analysis.discrepancy.show.verdicts import sentence_of
from faultline.analysis.model import Model
from faultline.analysis.model.display import units_of


def origin_of(data: Data, without: Sequence[str] = ()) -> told.Origin:
    """Of the recordings of a study, in which effects were looked for, `without` some."""
    return told.Origin(
        training=tuple(log.id for log in data.training),
        held_out=tuple(log.id for log in data.held),
        sources=tuple(data.sources),
        vehicle=data.vehicle,
        missing=tuple(data.gaps()),
        without=tuple(without),
    )


def document_of(found: Discovery, shown: Shown, origin: told.Origin, extras: Extras | None = None) -> told.Document:
    """The document of a discovery, with the free runs over its held-out recordings."""
    extras = extras or Extras()
    outcome, library, units = found.outcome, found.study.library, units_of(found.study.model)
    first = found.before.members[0] if found.before.members else found.before.suspects[0].equation
    return told.Document(
        model=found.study.model.name,
        origin=origin,
        simulated=origin.simulated,
        units=units,
        verdict=_verdict(found, extras),
        evidence=told.Evidence(
            training_before=outcome.nominal.training,
            training_after=outcome.chosen.training,
            held_out_before=outcome.nominal.predicted,
            held_out_after=outcome.chosen.predicted,
            dispersion_before=outcome.nominal.dispersion,
            dispersion_after=outcome.chosen.dispersion,
        ),
        strengths=tuple(
            told.Strength(
                effect=size.effect,
                parameter=size.parameter,
                description=size.description,
                unit=size.unit,
                value=size.value,
                interval=size.interval,
                no_effect=size.null,
                words=size.words,
            )
            for size in sizes(outcome.chosen, library, units)
        ),
        located=_located(found.study.model, found.before, first),
        left=_left(found, first),
        regimes=tuple(_regime(gap, found.study.model.known[gap.output].unit) for gap in shown.gaps),
        zeros=_zeros(found, shown, origin),
        entries=_entries(found),
        drifts=drifts_told(extras.drifts),
        drift=section(extras.drifts.sentences()) if extras.drifts else None,
        structure=section(extras.structure.sentences(), extras.structure) if extras.structure else None,
        bundle=bundle_told(extras.bundle) if extras.bundle else None,
        experiments=dict(extras.experiments.texts),
        unplanned=extras.experiments.unplanned,
        experiment=experiment_told(extras.plans[0]) if extras.plans else None,
        gauge=gauge_told(extras.gauge, units) if extras.gauge else None,
        onset=section([extras.onset.advice()], extras.onset) if extras.onset else None,
        refused=tuple(extras.refused),
        applied=extras.applied,
    )


def _verdict(found: Discovery, extras: Extras) -> told.Verdict:
    verdict, library = found.verdict, found.study.library
    gains = [place.gain for place in found.outcome.places]
    places = tuple(
        told.Place(candidates=tuple(_candidate(library[name]) for name in names), gain=gain)
        for names, gain in zip(verdict.sets, gains, strict=True)
    )
    where = _where(found.before) if found.before.members else f"in the held-out recordings, {_where(found.held)}"
    set_in = extras.onset.what(found.study.model) if extras.onset else None
    return told.Verdict(
        kind=verdict.kind,
        sentence=sentence_of(verdict.kind, places, where, set_in),
        places=places,
        gain=verdict.gain,
        remainder=verdict.remainder,
        threshold=found.outcome.threshold,
    )


def _where(location: Location) -> str:
    """The best account, and how many other places may have it."""
    others = len(location.members) - 1
    besides = f"; or it is in one of {others} other equations, as far as these data tell" if others > 0 else ""
    return f"{location.sentences[0]}{besides}"


def _candidate(effect: Effect) -> told.Candidate:
    return told.Candidate(
        name=effect.name,
        statement=effect.statement,
        component=effect.component,
        separated_by=effect.separated_by,
    )


def _located(model: Model, location: Location, equation: str) -> told.Located:
    """The location; the unknown input is that of `equation`, so that before and after are of the same."""
    course = next((suspect for suspect in location.suspects if suspect.equation == equation), None)
    return told.Located(
        sentences=location.sentences,
        equations=location.members,
        descriptions={name: model.equations[name].description for name in location.members if name in model.equations},
        inseparable=location.inseparable,
        sensors=location.sensors,
        parts=tuple(
            told.Part(equation=finding.equation, words=part.words, value=part.value, sd=part.sd)
            for finding in location.findings
            for part in finding.parts
        ),
        course=None if course is None else _course(course),
    )


def _left(found: Discovery, equation: str) -> told.Located:
    """Where something is left with the effects in; of a held-out recording it is said that it is of one."""
    located = _located(found.study.model, found.left, equation)
    if found.left is found.after:
        return located
    said = tuple(f"in the held-out recordings, {sentence}" for sentence in located.sentences)
    return structs.replace(located, sentences=said, course=None)  # pictures are of the training recordings


def _course(suspect: Suspect) -> told.Course:
    return told.Course(
        equation=suspect.equation,
        variable=suspect.variable,
        unit=suspect.unit,
        size=suspect.size,
        t_s=tuple(suspect.t.round(3).tolist()),
        value=tuple(suspect.value.tolist()),
        sd=tuple(suspect.sd.tolist()),
    )


def _regime(gap: Gap, unit: str) -> told.Regime:
    return told.Regime(
        output=gap.output,
        unit=unit,
        mode=gap.mode,
        samples=gap.after.samples,
        rms_before=gap.before.rms,
        rms_after=gap.after.rms,
        bias_before=gap.before.bias,
        bias_after=gap.after.bias,
        floor=_known(gap.after.floor),
        expected=_known(gap.expected),
        closure=gap.closure,
        white_before=_white(gap.white_before),
        white_after=_white(gap.white_after),
    )


def _known(value: float) -> float | None:
    return value if isfinite(value) else None


def _white(found: Whiteness | None) -> told.White | None:
    return None if found is None else told.White(lag1=found.lag1, probability=found.probability)


def _zeros(found: Discovery, shown: Shown, origin: told.Origin) -> tuple[told.Zero, ...]:
    sd = found.outcome.nominal.unknowns.zeros
    pairs = zip(origin.held_out, shown.before.zeros, shown.after.zeros, strict=True)
    return tuple(
        told.Zero(recording=recording, output=name, before=was[name] / sd[name], after=now[name] / sd[name])
        for recording, was, now in pairs
        for name in sd
    )


def _entries(found: Discovery) -> tuple[told.Entry, ...]:
    """All entries: those that were fitted to the end by their evidence, then the rest, then those without a place."""
    nominal, library = found.outcome.nominal, found.study.library
    smallest = smallest_sizes(found.directions, found.outcome.threshold)
    same = alike(found.directions)
    singles = {attempt.effects[0]: attempt for attempt in found.outcome.singles}
    order = [*singles, *(name for name in library if name not in singles)]
    entries = []
    for name in order:
        single = singles.get(name)
        entries.append(
            told.Entry(
                name=name,
                statement=library[name].statement,
                gain=single.evidence - nominal.evidence if single else None,
                gain_training=single.training - nominal.training if single else None,
                gain_held_out=single.predicted - nominal.predicted if single else None,
                smallest=_known(smallest[name]) if name in smallest else None,
                unit=next(iter(library[name].strengths.values())).unit,
                alike=same.get(name, ()),
                no_place=None,
                halted=found.halted.get(name),
                own=name in found.own,
                against=tuple(_against(found, name, single)) if name in found.own else (),
            )
        )
    return (*entries, *(_without_place(name, reason, name in found.own) for name, reason in found.unfit.items()))


def _against(found: Discovery, name: str, single: Attempt | None) -> Iterator[str]:
    """The reasons why an entry is not named, none if it is."""
    outcome, nominal, kind = found.outcome, found.outcome.nominal, found.verdict.kind
    if name in (rival for names in found.verdict.sets for rival in names):
        if kind == "unnamed":
            yield f"with it in, {found.verdict.remainder:.0f} nats of evidence for an unknown input are left"
        return
    if single is None:
        yield found.halted.get(name, "its model could not be run")
        return
    best = outcome.singles[0]
    if single.evidence - nominal.evidence <= outcome.threshold:
        yield f"{outcome.threshold:.1f} nats are asked for"
    if best is not single and best.evidence > nominal.evidence:
        yield f"{best.effects[0]} brings {best.evidence - single.evidence:.1f} nats more"
    elif outcome.chosen.effects:
        yield f"with {', '.join(outcome.chosen.effects)} in the model it is not needed"
    if single.predicted < nominal.predicted:
        yield "the held-out recordings speak against it"
    for parameter, inside in zip(single.unknowns.parameters, single.inside.tolist(), strict=False):
        strength = found.study.library[name].strengths.get(parameter)
        if strength is not None and not inside:
            nothing = single.values[parameter] == strength.null
            yield f"{parameter} has gone to where {'it does nothing' if nothing else 'its bound is'}"


def _without_place(name: str, reason: str, own: bool) -> told.Entry:
    return told.Entry(
        name=name,
        statement="",
        gain=None,
        gain_training=None,
        gain_held_out=None,
        smallest=None,
        unit="",
        alike=(),
        no_place=reason,
        own=own,
        against=(reason,) if own else (),
    )
