"""Build the document of a discovery and of what else was found out."""

from collections.abc import Sequence

from msgspec import structs

from faultline.analysis.discrepancy.add.held_out import Shown
from faultline.analysis.discrepancy.data import Data
from faultline.analysis.discrepancy.discover import Discovery
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.find.locate import Location, Suspect
from faultline.analysis.discrepancy.show import document
from faultline.analysis.discrepancy.show.entries import entries
from faultline.analysis.discrepancy.show.extras import (
    Extras,
    bundle_section,
    drifts_of,
    experiment_section,
    gauge_section,
    section,
)
from faultline.analysis.discrepancy.show.sized import regimes_of, strengths_of
from faultline.analysis.discrepancy.show.verdicts import sentence_of
from faultline.analysis.model import Model
from faultline.analysis.model.display import units_of


def origin_of(data: Data, without: Sequence[str] = ()) -> document.Origin:
    """Of the recordings of a study, in which effects were looked for, `without` some."""
    return document.Origin(
        training=tuple(log.id for log in data.training),
        held_out=tuple(log.id for log in data.held),
        sources=tuple(data.sources),
        vehicle=data.vehicle,
        missing=tuple(data.gaps()),
        without=tuple(without),
        same_conditions=data.same_conditions,
    )


def document_of(
    found: Discovery, shown: Shown, origin: document.Origin, extras: Extras | None = None
) -> document.Document:
    """The document of a discovery, with the free runs over its held-out recordings."""
    extras = extras or Extras()
    outcome, library, units = found.outcome, found.study.library, units_of(found.study.model)
    first = found.before.members[0] if found.before.members else found.before.suspects[0].equation
    return document.Document(
        model=found.study.model.name,
        origin=origin,
        simulated=origin.simulated,
        units=units,
        verdict=_verdict(found, extras),
        evidence=document.Evidence(
            training_before=outcome.nominal.training,
            training_after=outcome.chosen.training,
            held_out_before=outcome.nominal.predicted,
            held_out_after=outcome.chosen.predicted,
            dispersion_before=outcome.nominal.dispersion,
            dispersion_after=outcome.chosen.dispersion,
        ),
        strengths=strengths_of(outcome.chosen, library, units, found.intervals),
        located=_located(found.study.model, found.before, first),
        left=_left(found, first),
        regimes=regimes_of(found.study.model, shown),
        zeros=_zeros(found, shown, origin),
        entries=entries(found),
        drifts=drifts_of(extras.drifts),
        drift=section(extras.drifts.sentences()) if extras.drifts else None,
        structure=section(extras.structure.sentences(), extras.structure) if extras.structure else None,
        bundle=bundle_section(extras.bundle) if extras.bundle else None,
        experiments=dict(extras.experiments.texts),
        unplanned=extras.experiments.unplanned,
        experiment=experiment_section(extras.plans[0]) if extras.plans else None,
        gauge=gauge_section(extras.gauge, units) if extras.gauge else None,
        proposal=extras.proposal,
        onset=section([extras.onset.advice()], extras.onset) if extras.onset else None,
        refused=tuple(extras.refused),
        applied=extras.applied,
    )


def _verdict(found: Discovery, extras: Extras) -> document.Verdict:
    verdict, library = found.verdict, found.study.library
    gains = [place.gain for place in found.outcome.places]
    places = tuple(
        document.Place(candidates=tuple(_candidate(library[name]) for name in names), gain=gain)
        for names, gain in zip(verdict.sets, gains, strict=True)
    )
    where = _where(found.before) if found.before.members else f"in the held-out recordings, {_where(found.held)}"
    set_in = extras.onset.what(found.study.model) if extras.onset else None
    return document.Verdict(
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


def _candidate(effect: Effect) -> document.Candidate:
    return document.Candidate(
        name=effect.name,
        statement=effect.statement,
        component=effect.component,
        separated_by=effect.separated_by,
    )


def _located(model: Model, location: Location, equation: str) -> document.Located:
    """The location; the unknown input is that of `equation`, so that before and after are of the same."""
    course = next((suspect for suspect in location.suspects if suspect.equation == equation), None)
    return document.Located(
        sentences=location.sentences,
        equations=location.members,
        descriptions={name: model.equations[name].description for name in location.members if name in model.equations},
        inseparable=location.inseparable,
        sensors=location.sensors,
        parts=tuple(
            document.Part(equation=finding.equation, words=part.words, value=part.value, sd=part.sd)
            for finding in location.findings
            for part in finding.parts
        ),
        course=None if course is None else _course(course),
    )


def _left(found: Discovery, equation: str) -> document.Located:
    """Where something is left with the effects in; of a held-out recording it is said that it is of one."""
    located = _located(found.study.model, found.left, equation)
    if found.left is found.after:
        return located
    said = tuple(f"in the held-out recordings, {sentence}" for sentence in located.sentences)
    return structs.replace(located, sentences=said, course=None)  # pictures are of the training recordings


def _course(suspect: Suspect) -> document.Course:
    return document.Course(
        equation=suspect.equation,
        variable=suspect.variable,
        unit=suspect.unit,
        size=suspect.size,
        t_s=tuple(suspect.t.round(3).tolist()),
        value=tuple(suspect.value.tolist()),
        sd=tuple(suspect.sd.tolist()),
    )


def _zeros(found: Discovery, shown: Shown, origin: document.Origin) -> tuple[document.Zero, ...]:
    sd = found.outcome.nominal.unknowns.zeros
    pairs = zip(origin.held_out, shown.before.zeros, shown.after.zeros, strict=True)
    return tuple(
        document.Zero(recording=recording, output=name, before=was[name] / sd[name], after=now[name] / sd[name])
        for recording, was, now in pairs
        for name in sd
    )
