"""A discovery in the terminal: a line a matter, what was found before how it was found."""

from faultline.analysis.calibration.validate import STEADY
from faultline.analysis.discrepancy.show.document import Document, Regime
from faultline.analysis.discrepancy.show.proposed import proposal_lines
from faultline.analysis.discrepancy.show.verdicts import confidence, halted, next_steps

MOST = 25
"""Lines."""


def sentences(d: Document) -> list[str]:
    """What a reader needs to know, the verdict first."""
    lines = [d.verdict.sentence, *(f"  {line}" for line in confidence(d))]
    nearest = "" if d.named else "nearest, and not its name: "
    lines += [f"  {nearest}{strength.effect}: {strength.words}" for strength in d.strengths]
    if d.located.equations:
        lines += ["where:", *(f"  {sentence}" for sentence in d.located.sentences)]
    if d.proposal:
        first, *others = proposal_lines(d.proposal)
        lines += [first, *(f"  {line}" for line in others)]
    if d.left.equations and d.strengths and not d.proposal:
        lines += ["still left, with the effects in:", *(f"  {sentence}" for sentence in d.left.sentences[:1])]
    lines += gap_lines(d)
    if d.drift and d.named:
        lines += [f"parameters: {sentence}" for sentence in d.drift.sentences[:3]]
    if d.structure and d.named:
        lines += [f"structure: {sentence}" for sentence in d.structure.sentences[:3]]
    if d.bundle:
        lines += [f"bundle: {sentence}" for sentence in d.bundle.sentences[:3]]
    last = [f"not added: {reason}" for reason in d.refused if d.named]
    last += [f"next: {step}" for step in next_steps(d)]
    last += [f"note: {sentence}" for sentence in (*d.origin.missing[:2], *halted(d)[:2])]
    last += [f"note: left out of the search: {', '.join(d.origin.without)}"] if d.origin.without else []
    room = max(MOST - len(last), 1)  # what to do is never cut away
    return [*(lines if len(lines) <= room else [*lines[: room - 1], "..."]), *last]


def gap_lines(d: Document) -> list[str]:
    """The steady free run's error by output."""
    steady = [regime for regime in d.regimes if regime.mode == STEADY]
    if not steady:
        return []
    head = "held-out free run, RMS error in steady operation" + (": before -> after" if d.strengths else "")
    return [head, *(f"  {regime.output}: {gap_words(regime, d)}" for regime in steady)]


def gap_words(r: Regime, d: Document) -> str:
    """For example "0.276 -> 0.031 bar (expected from the noise: 0.046); the gap is closed by 100 %"."""
    shown, changed = d.units.of(r.unit, signal=r.output), bool(d.strengths)
    one = shown.size
    after = f" -> {r.rms_after / one:.3g}" if changed else ""
    text = f"{r.rms_before / one:.3g}{after} {shown.unit}"
    if r.expected is not None:
        text += f" (noise lets expect {r.expected / one:.3g})"
    if changed:
        text += (
            "; no gap that an RMS error could show"
            if r.closure is None
            else f"; {100 * r.closure:.0f} % of the gap closed"
        )
    return text
