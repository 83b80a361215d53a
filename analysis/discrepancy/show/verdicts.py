"""The verdict in words: what it is, how sure, what it means for diagnosis, what to do next, what it does not say."""

from collections.abc import Sequence

from faultline.analysis.discrepancy.add.drift import MOVED
from faultline.analysis.discrepancy.discover import REMAINDER, Kind
from faultline.analysis.discrepancy.show.document import Candidate, Document, Entry, Place

MANY = 6
"""Names that a sentence lists."""

HARDLY = 0.1
"""Of the evidence: less from the held-out recordings, and they were of another operation."""

TUNE_AND_EXPORT = (
    "`faultline tune {model} RECORDING... --out tuning.json` with other fault-free recordings, then "
    "`faultline export {model} --tuning tuning.json --dbc DBC --out bundle`"
)

DIFFER = (
    "let `faultline diagnose` look at the held-out recordings, and call again with the recordings exchanged: what is "
    "missing in the model shows then too; or record both again in one session, in the same operation",
    "if the conditions do change that much, say so by the `drift` of a parameter or a sensor in the model file",
)
"""What to do where only the held-out recordings depart from the model."""

FAR = 3.0
"""Standard deviations from which a zero error is not what the datasheet says."""


def sentence_of(kind: Kind, places: Sequence[Place], where: str, set_in: str | None = None) -> str:
    """What was found, for example "missing in the model: the dosing valve passes more when ... (full_open_gain)".

    `set_in` says what did while it was recorded, if anything.
    """
    if set_in is not None:
        return set_in
    if kind == "nothing missing":
        return "nothing is missing in the model that these recordings could show"
    if kind == "unnamed":
        return f"something is missing in the model that no entry of the library describes: {where}"
    if kind == "recordings differ":
        like = f"; they look as if {'; and '.join(_one(place.candidates) for place in places)}" if places else ""
        return f"the held-out recordings depart from the model in a way that the training recordings do not{like}"
    return f"missing in the model: {'; and besides, '.join(_one(place.candidates) for place in places)}"


def _one(candidates: Sequence[Candidate]) -> str:
    said = [f"{candidate.statement} ({candidate.name})" for candidate in candidates]
    return (
        said[0]
        if len(said) == 1
        else f"one of {len(said)} effects that these data cannot tell apart: {'; or '.join(said)}"
    )


def confidence(d: Document) -> list[str]:
    """How sure that is."""
    v, best = d.verdict, max((entry.gain for entry in d.entries if entry.gain is not None), default=None)
    if v.kind == "nothing missing":
        tried = sum(entry.no_place is None for entry in d.entries)
        brought = (
            "none brought any evidence"
            if best is None or best <= 0.0
            else f"the best brought {best:.1f} nats of evidence"
        )
        found = [f"{tried} effects were looked for; {brought}, {_asked(v.threshold)}"]
        if v.remainder > 0.0:
            found.append(
                f"an unknown input has {v.remainder:.0f} nats of evidence, more than chance; from {REMAINDER:.0f} on "
                "something is said to be missing"
            )
        return [*found, *_own(d)]
    lines = []
    if v.kind == "recordings differ":
        lines.append("what a model lacks shows in both, so this is hardly physics that it lacks")
    if v.places:
        e, what = d.evidence, "evidence" if d.named else "the nearest effects bring"
        lines.append(
            f"{what} {v.gain:.0f} nats ({e.training_after - e.training_before:.0f} of the training recordings, "
            f"{e.held_out_after - e.held_out_before:.0f} of the held-out ones), {_asked(v.threshold)}"
        )
    if v.kind == "unnamed":
        nearest = f" with them in ({', '.join(_names(d))})" if v.places else ""
        lines.append(f"{v.remainder:.0f} nats of evidence for an unknown input are left{nearest}")
    return [*lines, *_own(d)]


def _own(d: Document) -> list[str]:
    """The user's own entries that something speaks against: their evidence, and what it is."""
    return [
        f"your entry {e.name}: {_brought(e)}; against it: {'; '.join(e.against)}"
        for e in d.entries
        if e.own and e.against
    ]


def _brought(e: Entry) -> str:
    if e.gain is None or e.gain_training is None or e.gain_held_out is None:
        return "no evidence"
    return (
        f"{e.gain:.1f} nats ({e.gain_training:.1f} of the training recordings, {e.gain_held_out:.1f} of the held-out "
        "ones)"
    )


def _asked(threshold: float) -> str:
    return f"where {threshold:.1f} are asked for, which chance brings in less than 1 of 100 cases"


def _names(d: Document) -> list[str]:
    return [place.candidates[0].name for place in d.verdict.places]


def meaning(d: Document) -> list[str]:
    """What it means for a diagnosis with this model."""
    kind = d.verdict.kind
    if d.onset:
        return [
            "A model fitted to these recordings would take the fault for the healthy vehicle, and its tests would not "
            "see it."
        ]
    if kind == "nothing missing":
        seen = "little more than noise" if d.verdict.remainder > 0.0 else "nothing but noise"
        return [f"Tests made from this model see {seen} on a healthy vehicle, as far as these recordings go."]
    if kind == "recordings differ":
        return [
            "The model may be right: between the recordings the conditions may have changed (temperature, ambient "
            "pressure, a sensor's zero) by more than the model's `drift` says, or a component may have."
        ]
    found = [
        "Until the model has this, its tests see a deviation on a healthy vehicle: either they are set so that they "
        "tolerate it, and small faults stay unseen, or they raise false alarms."
    ]
    bent = [drift for drift in d.drifts or () if abs(drift.distance_before) - abs(drift.distance_after) >= MOVED]
    bent.sort(key=lambda drift: abs(drift.distance_after) - abs(drift.distance_before))
    back = [f"the {drift.description} ({drift.name})" for drift in bent]
    if back and kind != "unnamed":
        found.append(
            f"A fit without it has bent {_listed(back)} instead; with it they come back towards the datasheet, so that "
            "a component that wears is seen where it is."
        )
    if kind == "one of":
        found.append(
            "The candidates describe these recordings equally well: a diagnosis in the same operation does not depend "
            "on which it is; outside of it, it may."
        )
    if kind == "unnamed":
        found.append(
            "The place is known, not the reason. It must not be given the name of the effect that fits best: its "
            "parameters, and others, would absorb what it does not describe."
        )
    return found


def next_steps(d: Document) -> list[str]:
    """What to do now."""
    if d.onset:
        return list(d.onset.sentences)
    steps = {"recordings differ": [*DIFFER], "named": _once_named(d), "one of": _to_tell_apart(d)}
    steps["nothing missing"] = [f"use the model as it is: {TUNE_AND_EXPORT.format(model='MODEL')}"]
    return steps.get(d.verdict.kind) or _to_name(d)


def _once_named(d: Document) -> list[str]:
    if d.refused:
        return [f"do not add it as it is, {d.refused[0]}: try other forms of the same effect in a file for --library"]
    if d.applied:
        return [f"make a bundle of the model that was written: {TUNE_AND_EXPORT.format(model='model.toml')}"]
    return ["take it into the model (`faultline discover ... --apply`), then tune and export anew"]


def _to_tell_apart(d: Document) -> list[str]:
    taken = [f"`model.toml` has {_names(d)[0]}, the most probable: which it is stays open"] if d.applied else []
    read = d.gauge.sentences if d.gauge else ()
    if d.experiment and d.experiment.data.get("tells"):
        return [*d.experiment.sentences, *read, *taken]
    named = [name for name in experiments(d) if d.experiment is None or name in d.unplanned]
    record = [f"record what may tell them apart: {'; or '.join(d.experiments.get(name, name) for name in named)}"]
    planned = d.experiment.sentences if d.experiment else () if named else ("no experiment is known that tells them",)
    known = ["once you know what it is not, call again with --without and its name"] if read else []
    return [*planned, *(record if named else []), *read, *known, *taken]


def _to_name(d: Document) -> list[str]:
    steps = ["have an engineer describe it as an entry of the library, and give that file with --library"]
    if d.proposal:
        steps.append("the formula in `proposal.toml` is an entry to begin with: review it and name it by what it means")
    if d.located.sensors:
        steps.append(f"a sensor of {d.located.sensors[0]} would tell better where it is")
    return steps


def experiments(d: Document) -> tuple[str, ...]:
    """Of the library: which experiments tell candidates of a place apart, those first that most of them name."""
    named: dict[str, int] = {}
    for place in d.verdict.places:
        if len(place.candidates) > 1:
            for candidate in place.candidates:
                for experiment in candidate.separated_by:
                    named[experiment] = named.get(experiment, 0) + 1
    return tuple(sorted(named, key=lambda name: -named[name]))


def limits(d: Document) -> list[str]:
    """What these recordings could not show, and what was taken for granted."""
    found = [*d.origin.missing]
    if d.origin.without:
        found.append(f"left out of the search, as was asked for: {_listed(d.origin.without)}")
    if d.origin.same_conditions:
        found.append(
            "that nothing changed from one recording to the next is your word (--same-conditions): where a sensor's "
            "zero, a temperature or a level did, an effect may be named in its place"
        )
    held = d.evidence.held_out_after - d.evidence.held_out_before
    if d.verdict.places and held < HARDLY * d.verdict.gain:
        found.append(
            f"the held-out recordings hardly show it ({held:.0f} of {d.verdict.gain:.0f} nats): hold out one that has "
            "the operation in which it acts"
        )
    named = {candidate.name for place in d.verdict.places for candidate in place.candidates}
    unseen = [e.name for e in d.entries if _is_unseen(e) and e.name not in named]
    if unseen:
        found.append(f"these recordings cannot show, at any possible size: {_listed(unseen)}")
    groups = alike_groups(d.entries)
    if groups:
        found.append(f"look the same in these recordings: {'; '.join(_listed(group) for group in groups)}")
    found += halted(d)
    absent = [entry.name for entry in d.entries if entry.no_place is not None]
    if absent:
        found.append(f"have no place in this model: {_listed(absent)}")
    found += [
        f"the zero error of {zero.output} in {zero.recording} would be {abs(zero.after):.1f} times what its datasheet "
        "says; check the sensor"
        for zero in d.zeros
        if abs(zero.after) > FAR and d.named  # there it may do what is missing
    ]
    found.append(
        "the library is what was looked for: an effect that looks like an entry's here may be another elsewhere"
    )
    if d.simulated:
        found.append("these data are simulated: no figure here is of a real vehicle")
    return found


def _is_unseen(e: Entry) -> bool:
    """True if no strength could be seen; of a searched entry with another parameter that is true at one value only."""
    return e.no_place is None and e.smallest is None and not (e.sizes and len(e.best) > 1)


def halted(d: Document) -> list[str]:
    """Entries that were not judged, though they have a place in the model."""
    return [
        f"{entry.name} may be it all the same: its model could not be run from everywhere ({entry.halted})"
        for entry in d.entries
        if entry.halted is not None
    ]


def alike_groups(entries: Sequence[Entry]) -> list[list[str]]:
    """Entries that do the same, each group once."""
    groups: list[list[str]] = []
    for entry in entries:
        group = sorted((entry.name, *entry.alike))
        if entry.alike and group not in groups:
            groups.append(group)
    return groups


def _listed(names: Sequence[str]) -> str:
    rest = f" and {len(names) - MANY} more" if len(names) > MANY else ""
    return f"{', '.join(names[:MANY])}{rest}"
