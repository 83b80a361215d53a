"""Report every entry of the library: its evidence, its best size, how it was searched, and what speaks against it."""

from collections.abc import Iterator
from math import isfinite

from faultline.analysis.discrepancy.discover import Discovery
from faultline.analysis.discrepancy.name.attempt import Attempt, Glance
from faultline.analysis.discrepancy.name.sensitivity import alike, smallest_sizes
from faultline.analysis.discrepancy.name.tried import UNSETTLED, Tried
from faultline.analysis.discrepancy.show import document
from faultline.analysis.discrepancy.show.sized import strength_of
from faultline.analysis.discrepancy.show.sizes import sizes
from faultline.analysis.model.display import Units, units_of

FAR = 3.0
"""Standard deviations of a prior: what is further away is not what the entry says."""


def entries(found: Discovery) -> tuple[document.Entry, ...]:
    """All entries: those that were fitted to the end by their evidence, the rest by promise, those without a place."""
    nominal, library, tried = found.outcome.nominal, found.study.library, found.outcome.tried
    units = units_of(found.study.model)
    smallest = smallest_sizes(found.directions, found.outcome.threshold)
    same = alike(found.directions)
    singles = {attempt.effects[0]: attempt for attempt in found.outcome.singles}
    rest = sorted((name for name in library if name not in singles), key=lambda n: -tried.get(n, Tried(0)).promised)
    rows = []
    for name in (*singles, *rest):
        single, how = singles.get(name), tried.get(name, Tried(0))
        size = smallest.get(name)
        rows.append(
            document.Entry(
                name=name,
                statement=library[name].statement,
                gain=single.evidence - nominal.evidence if single else None,
                gain_training=single.training - nominal.training if single else None,
                gain_held_out=single.predicted - nominal.predicted if single else None,
                smallest=size if size is not None and isfinite(size) else None,
                unit=next(iter(library[name].strengths.values())).unit,
                alike=same.get(name, ()),
                no_place=None,
                halted=found.halted.get(name),
                own=name in found.own,
                against=tuple(_against(found, name, single, how)),
                best=_best(found, name, single, how, units),
                promised=how.promised,
                starts=how.starts,
                sizes=how.sizes,
            )
        )
    return (*rows, *(_without_place(name, reason, name in found.own) for name, reason in found.unfit.items()))


def _best(
    found: Discovery, name: str, single: Attempt | None, how: Tried, units: Units
) -> tuple[document.Strength, ...]:
    """The entry's parameters at their best, or where the most was in sight, then without intervals."""
    if single is not None:
        profiled = found.intervals if single.effects == found.outcome.chosen.effects else {}
        return tuple(map(strength_of, sizes(single, found.study.library, units, profiled)))
    return () if how.nearest is None else tuple(_on_the_way(found, name, how.nearest, units))


def _on_the_way(found: Discovery, name: str, glance: Glance, units: Units) -> Iterator[document.Strength]:
    values, effect = glance.unknowns.theta(glance.x), found.study.library[name]
    for own, p in effect.parameters.items():
        if (parameter := effect.prefixed(own)) in values:
            value = values[parameter]
            yield document.Strength(
                effect=name,
                parameter=parameter,
                description=p.description,
                unit=p.unit,
                value=value,
                interval=None,
                no_effect=p.null,
                words=f"{p.description}: {units.of(p.unit, shifted=False).short(value)}, after a few steps",
            )


def _against(found: Discovery, name: str, single: Attempt | None, how: Tried) -> Iterator[str]:
    """The reasons against an entry, none if it is named and nothing is wrong with it."""
    if name in (rival for names in found.verdict.sets for rival in names):
        if found.verdict.kind == "unnamed":
            yield f"with it in, {found.verdict.remainder:.0f} nats of evidence for an unknown input are left"
    elif single is None:
        yield from _not_fitted(found, name, how)
    else:
        yield from _beaten(found, single)
    if single is not None:
        yield from _of_fit(found, name, single)
    if how.failed and how.sizes:
        yield f"its model could not be run with {how.failed} of {how.sizes} sizes"


def _not_fitted(found: Discovery, name: str, how: Tried) -> Iterator[str]:
    if name in found.halted:
        yield f"its model could not be run from everywhere: {found.halted[name]}"
    if how.nearest is not None:
        globally = f" and a global search of {how.sizes} sizes" if how.sizes else ""
        starts = f"{how.starts} start{'s' if how.starts > 1 else ''}"
        yield f"promised at most {document.nats(how.promised)} from {starts}{globally}"
    elif name not in found.halted:
        yield "its model could not be run"


def _beaten(found: Discovery, single: Attempt) -> Iterator[str]:
    outcome, nominal = found.outcome, found.outcome.nominal
    best = outcome.singles[0]
    if single.evidence - nominal.evidence <= outcome.threshold:
        yield f"{outcome.threshold:.1f} nats are asked for"
    if best is not single and best.evidence > nominal.evidence:
        yield f"{best.effects[0]} brings {best.evidence - single.evidence:.1f} nats more"
    elif outcome.chosen.effects:
        yield f"with {', '.join(outcome.chosen.effects)} in the model it is not needed"
    if single.predicted < nominal.predicted:
        yield f"worse in the held-out recordings by {nominal.predicted - single.predicted:.1f} nats"


def _of_fit(found: Discovery, name: str, single: Attempt) -> Iterator[str]:
    """What is wrong with where the fit of an entry ended."""
    effect = found.study.library[name]
    for own, p in effect.parameters.items():
        if (parameter := effect.prefixed(own)) in single.unknowns.parameters:
            k = single.unknowns.parameters.index(parameter)
            away = abs(float(single.x[k]))
            if not single.inside[k]:
                nothing = single.values[parameter] == p.null
                yield f"{parameter} has gone to where {'it does nothing' if nothing else 'its bound is'}"
            elif away > FAR:
                yield f"{parameter} goes {away:.0f} standard deviations from its prior"
    if single.promised > UNSETTLED:
        yield f"its fit is not at its end: {single.promised:.0f} nats more are in sight"


def _without_place(name: str, reason: str, own: bool) -> document.Entry:
    return document.Entry(
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
        against=(reason,),
    )
