"""A discovery as one HTML file that needs nothing else: pictures inside, readable on a phone, in the dark, on paper."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from faultline.analysis.discrepancy.show.document import Document, Entry, Regime, White
from faultline.analysis.discrepancy.show.proposed import proposal_lines
from faultline.analysis.discrepancy.show.verdicts import confidence, limits, meaning, next_steps
from faultline.analysis.model.display import Units
from faultline.service.core.display import Display
from faultline.service.pages import Table, render

TEMPLATE = Path(__file__).with_name("page.html.j2")

CAPTIONS = {
    "free-run": (
        "The model runs on the inputs alone over a recording that no fit has seen. Below, what is left of every "
        "sensor. Each recording's sensors have zero errors of their own: the most likely ones are taken off."
    ),
    "regimes": (
        "By operating mode, as tests on the vehicle see it. Edges, some seconds after each step, are apart: when a "
        "step came is known to a tenth of a second only."
    ),
    "unknown-input": (
        "An unknown input is put on the equation and estimated from the data alone. A constant part of it is hard to "
        "tell from the parameters, which is most of the band. With what is missing in the model it is flat."
    ),
    "evidence": (
        "How much more likely all recordings are with an entry of the library in the model, its own freedom and that "
        "of all parameters taken into account. Dashed: what is asked for before anything is named."
    ),
}


def page(d: Document, pictures: Mapping[str, bytes]) -> str:
    """Return the file's text; `pictures` are PNGs by their name in `CAPTIONS`."""
    return render(
        TEMPLATE,
        title=f"{d.model}: {d.verdict.kind}",
        d=d,
        confidence=confidence(d),
        figures=[(pictures[name], caption) for name, caption in CAPTIONS.items() if name in pictures],
        strengths=_strengths(d),
        meaning=meaning(d),
        next_steps=next_steps(d),
        proposal=proposal_lines(d.proposal) if d.proposal else (),
        proposed=_regimes(d, d.proposal.regimes) if d.proposal else None,
        regimes=_regimes(d, d.regimes),
        whiteness=_whiteness(d),
        evidence=_evidence(d),
        entries=_entries(d),
        limits=limits(d),
    )


def _strengths(d: Document) -> list[str]:
    nearest = "" if d.named else " (the nearest, and not its name)"
    return [f"{strength.words}; {strength.effect}{nearest}" for strength in d.strengths]


def _evidence(d: Document) -> Table:
    e = d.evidence
    rows = [
        [name, f"{before:.1f}", f"{after:.1f}", f"{after - before:+.1f}"]
        for name, before, after in (
            ("training", e.training_before, e.training_after),
            ("held out", e.held_out_before, e.held_out_after),
        )
    ]
    left = ["left, in the noise's mean square", f"{e.dispersion_before:.2f}", f"{e.dispersion_after:.2f}", ""]
    return Table(["recordings", "before", "after", "gain"], [*rows, left])


def _regimes(d: Document, regimes: Sequence[Regime]) -> Table:
    head = ["output", "mode", "RMS before", "after", "bias before", "after", "floor", "expected", "gap closed"]
    return Table(head, [_regime(r, d.units.of(r.unit, 0.0, r.output)) for r in regimes], text=(1,))


def _regime(r: Regime, shown: Display) -> list[str]:
    def formatted(value: float | None) -> str:
        return "-" if value is None else f"{value / shown.size:z.3g}"

    closed = "-" if r.closure is None else f"{100 * r.closure:.0f} %"
    values = [formatted(v) for v in (r.rms_before, r.rms_after, r.bias_before, r.bias_after, r.floor, r.expected)]
    return [f"{r.output} [{shown.unit}]", r.mode, *values, closed]


def _whiteness(d: Document) -> Table:
    head = ["output", "mode", "neighbours before", "after", "probability before", "after"]
    rows = []
    for r in d.regimes:
        correlations, chances = zip(*(_white(white) for white in (r.white_before, r.white_after)), strict=True)
        rows.append([r.output, r.mode, *correlations, *chances])
    return Table(head, rows, text=(1,))


def _white(found: White | None) -> tuple[str, str]:
    return ("-", "-") if found is None else (f"{found.lag1:+.2f}", f"{found.probability:.2g}")


def _entries(d: Document) -> Table:
    head = [
        "entry",
        "evidence [nats]",
        "training",
        "held out",
        "best size",
        "against it",
        "smallest visible",
        "looks the same here",
    ]
    chosen = {c.name for place in d.verdict.places for c in place.candidates} if d.named else set()
    marked = [k for k, entry in enumerate(d.entries) if entry.name in chosen]
    return Table(head, [_entry(entry, d.units) for entry in d.entries], text=(4, 5, 7), chosen=marked)


def _entry(e: Entry, units: Units) -> list[str]:
    if e.no_place is not None:
        return [e.name, "-", "-", "-", "-", f"no place in this model: {e.no_place}", "-", ""]
    gains = ["-" if gain is None else f"{gain:.1f}" for gain in (e.gain, e.gain_training, e.gain_held_out)]
    smallest = "cannot be shown" if e.smallest is None else units.of(e.unit).difference(e.smallest)
    best = "; ".join(strength.words for strength in e.best)
    return [e.name, *gains, best, "; ".join(e.against), smallest, ", ".join(e.alike)]
