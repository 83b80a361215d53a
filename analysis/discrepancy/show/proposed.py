"""A proposed formula as a part of the document, and in words."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite

from faultline.analysis.discrepancy.add.gate import reasons
from faultline.analysis.discrepancy.add.held_out import shown
from faultline.analysis.discrepancy.discover import Discovery, Kind, Verdict
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.discrepancy.propose.candidates import Candidate
from faultline.analysis.discrepancy.propose.proposal import Proposal
from faultline.analysis.discrepancy.show import document
from faultline.analysis.discrepancy.show.sized import regimes_of, strengths_of
from faultline.analysis.model import Model
from faultline.analysis.model.display import units_of

HARDLY = 0.1
"""Of the evidence: a formula of which the held-out recordings bring less is one of the training's."""

MANY = 4
"""Formulas that a sentence lists."""


def proposal_of(found: Discovery, proposal: Proposal) -> document.Proposal:
    """Return the part of a discovery's document.

    Raises:
        InputError: the model with the terms cannot be run over the held-out recordings.
    """
    model, outcome, library = proposal.study.model, proposal.outcome, proposal.study.library
    chosen, nominal = outcome.chosen, outcome.nominal
    kind: Kind = "named" if proposal.whole else "unnamed"
    verdict = Verdict(kind, (chosen.effects,), outcome.gain, proposal.remainder)
    its = replace(found, study=proposal.study, outcome=outcome, verdict=verdict)
    runs = shown(proposal.study, found.baseline, nominal, chosen)
    return document.Proposal(
        sentence=f"a formula is proposed, to be reviewed: {'; and '.join(_formula(model, t) for t in proposal.terms)}",
        terms=tuple(_term(model, proposal, term) for term in proposal.terms),
        rivals=tuple(_term(model, proposal, term) for term in proposal.rivals),
        strengths=strengths_of(chosen, library, units_of(model), proposal.intervals),
        gain=outcome.gain,
        gain_training=chosen.training - nominal.training,
        gain_held_out=chosen.predicted - nominal.predicted,
        threshold=outcome.threshold,
        remainder=proposal.remainder if isfinite(proposal.remainder) else None,
        regimes=regimes_of(model, runs),
        against=(*_against(proposal), *reasons(its, runs)),
        tried=proposal.tried,
    )


def _term(model: Model, proposal: Proposal, term: Candidate) -> document.Term:
    after = rewritten(model, proposal.study.library[term.name]).equations[term.equation].text
    before = model.equations[term.equation].text
    statement = str(term.table["statement"])
    return document.Term(name=term.name, equation=term.equation, statement=statement, before=before, after=after)


def _formula(model: Model, term: Candidate) -> str:
    return f"in {model.equations[term.equation].description} ({term.equation}) {term.words}"


def _against(proposal: Proposal) -> Iterator[str]:
    outcome, left = proposal.outcome, proposal.left
    held = outcome.chosen.predicted - outcome.nominal.predicted
    yield f"{proposal.tried} terms were composed, the best is given: it describes these recordings, and is no physics"
    if held < HARDLY * outcome.gain:
        yield f"the held-out recordings hardly speak for it: {held:.0f} of {outcome.gain:.0f} nats"
    if left is None:
        yield f"what is left with it in is not known: {proposal.halted}"
    elif left.members:
        yield f"with it in, something is missing still, {proposal.remainder:.0f} nats: {left.sentences[0]}"
    rivals = [rival.name for rival in proposal.rivals]
    if rivals:
        rest = f" and {len(rivals) - MANY} more" if len(rivals) > MANY else ""
        yield f"the data cannot tell it from {', '.join(rivals[:MANY])}{rest}"


def proposal_lines(p: document.Proposal) -> Sequence[str]:
    """Return sentences: the formula, how large it is, its evidence, what speaks against it."""
    formulas = [f"{term.equation}: `{term.before}` becomes `{term.after}` (= 0)" for term in p.terms]
    evidence = (
        f"evidence {p.gain:.0f} nats ({p.gain_training:.0f} of the training recordings, {p.gain_held_out:.0f} of the "
        f"held-out ones), where {p.threshold:.1f} are asked for"
    )
    sizes = [strength.words for strength in p.strengths]
    return [p.sentence, *formulas, *sizes, evidence, *(f"against it: {reason}" for reason in p.against)]
