"""A discovery on one page in plain words, for those who look after the vehicles: `summary.md`."""

from faultline.analysis.calibration.validate import STEADY
from faultline.analysis.discrepancy.show.document import Document, nats
from faultline.analysis.discrepancy.show.proposed import proposal_lines
from faultline.analysis.discrepancy.show.sentences import gap_words
from faultline.analysis.discrepancy.show.verdicts import confidence, limits, meaning, next_steps

HEADS = {
    "nothing missing": "The model describes these recordings",
    "named": "The model lacks something, and it has a name",
    "one of": "The model lacks something: one of several effects",
    "unnamed": "The model lacks something that has no name yet",
    "recordings differ": "The recordings were made under different conditions, it seems",
}

SET_IN = "Something set in while this was recorded: a fault, it seems"

NATS = "Nats measure evidence: 5 nats are odds of 150 to 1, and each further one multiplies them by 2.7."


def summary(d: Document) -> str:
    """The page, as Markdown."""
    v = d.verdict
    of = f" of vehicle {d.origin.vehicle}" if d.origin.vehicle else ""
    parts = [f"# {SET_IN if d.onset else HEADS[v.kind]}", f"Model {d.model}{of}. {_origin(d)}"]
    parts += ["## What was found", *_found(d)]
    parts += ["## How sure this is", *_bullets([_upper(line) for line in confidence(d)]), NATS, *_gap(d)]
    if d.proposal:
        parts += ["## A formula that is proposed", *_bullets([_upper(line) for line in proposal_lines(d.proposal)])]
    parts += ["## What it means for diagnosis", *meaning(d)]
    if d.bundle:
        parts += ["For the tests on the vehicle:", *_bullets([*d.bundle.sentences])]
    if d.refused:
        parts += ["It should not be added to the model as it is:", *_bullets([*d.refused])]
    parts += ["## What to do next", *_bullets([_upper(step) for step in next_steps(d)])]
    parts += ["## What was tried", *_tried(d)]
    parts += ["## What this does not say", *_bullets([_upper(limit) for limit in limits(d)])]
    return "\n\n".join(part for part in parts if part) + "\n"


def _origin(d: Document) -> str:
    source = f"; source: {'; '.join(d.origin.sources)}" if d.origin.sources else ""
    return (
        f"Fitted to {', '.join(d.origin.training)}, judged on {', '.join(d.origin.held_out)} as well, which no fit has "
        f"seen{source}.{' **All data are simulated.**' if d.simulated else ''}"
    )


def _found(d: Document) -> list[str]:
    v = d.verdict
    found = [f"**{_upper(v.sentence)}.**"]
    if d.named and v.kind == "one of":
        for place in v.places:
            found += _bullets([f"{c.statement} (`{c.name}`, {c.component})" for c in place.candidates])
    if d.named:
        found += _bullets([_upper(strength.words) for strength in d.strengths])
    if d.located.equations:
        _, *others = d.located.equations
        where = [d.located.sentences[0]]
        if others:
            said = "; ".join(d.located.descriptions.get(name) or name for name in others)
            where.append(f"with what is missing unknown it may as well be in: {said}")
        if d.located.sensors:
            where.append(f"a sensor of {d.located.sensors[0]} would tell more")
        found += ["Where in the model, estimated from the data alone, without any library:", *_bullets(where)]
    return found


def _tried(d: Document) -> list[str]:
    """The entries that were fitted to the end as a table, the others by the most that any of them promised."""
    fitted = [entry for entry in d.entries if entry.gain is not None]
    rows = [
        f"| {e.name} | {e.gain:.1f} | {'; '.join(s.words for s in e.best)} | {'; '.join(e.against)} |" for e in fitted
    ]
    head = ["| entry | evidence [nats] | best size | against it |", "|---|---:|---|---|"]
    rest = [entry for entry in d.entries if entry.gain is None and entry.no_place is None]
    table = ["\n".join([*head, *rows])] if rows else []
    if not rest:
        return table
    most, wide = max(entry.promised for entry in rest), sum(entry.sizes > 0 for entry in rest)
    globally = f"; searched globally: {wide} of them" if wide else ""
    return [*table, f"Left behind after a few steps: {len(rest)}, with at most {nats(most)} in sight{globally}."]


def _gap(d: Document) -> list[str]:
    steady = [regime for regime in d.regimes if regime.mode == STEADY]
    if not steady:
        return []
    said = [f"{regime.output}: {gap_words(regime, d)}" for regime in steady]
    nearest = "" if d.named else " with the nearest effects, none of which is its name"
    head = "The model run freely over the held-out recordings, on the inputs alone, is off in steady operation by (RMS"
    return [f"{head}{f', before -> after{nearest}' if d.strengths else ''}):", *_bullets(said)]


def _bullets(lines: list[str]) -> list[str]:
    """One part of the page; none of no lines."""
    return ["\n".join(f"- {line}" for line in lines)] if lines else []


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]
