"""A discovery as one HTML file that needs nothing else: pictures inside, readable on a phone, in the dark, on paper."""

import base64
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape

from faultline.analysis.discrepancy.show.document import Document, Entry, Regime, White
from faultline.analysis.discrepancy.show.sizes import readable
from faultline.analysis.discrepancy.show.verdicts import confidence, limits, meaning, next_steps

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
        "An unknown input is put on the equation and told from the data alone. A constant part of it is hard to tell "
        "from the parameters, which is most of the band. With what is missing in the model it is flat."
    ),
    "evidence": (
        "How much more likely all recordings are with an entry of the library in the model, its own freedom and that "
        "of all parameters taken into account. Dashed: what is asked for before anything is named."
    ),
}

CODE = re.compile("`([^`]*)`")

STYLE = """
:root{color-scheme:light dark;--ink:#1d2126;--soft:#5b646e;--paper:#fff;--card:#f5f6f8;--line:#d9dde2;--blue:#0072b2}
@media (prefers-color-scheme:dark){:root{--ink:#e8eaed;--soft:#a5adb6;--paper:#14171a;--card:#1f2428;--line:#363d44;
--blue:#6cb8e6}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1rem;max-width:72rem;background:var(--paper);color:var(--ink);
font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif}
h1{font-size:1.15rem;margin:.5rem 0;color:var(--soft);font-weight:600}
h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid var(--line)}
.verdict{font-size:1.3rem;line-height:1.35;margin:.5rem 0;border-left:.35rem solid var(--blue);padding:.3rem .8rem}
.note{background:var(--card);border:1px solid var(--line);border-radius:.4rem;padding:.5rem .8rem}
figure{margin:1.5rem 0}
figure img{display:block;width:100%;min-width:40rem;height:auto;background:#fff;border-radius:.4rem;
border:1px solid var(--line)}
figcaption{color:var(--soft);font-size:.9rem;margin-top:.3rem}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.88rem;min-width:100%}
th,td{text-align:right;padding:.25rem .6rem;border-bottom:1px solid var(--line);white-space:nowrap}
th:first-child,td:first-child,th.text,td.text{text-align:left}
td.text{white-space:normal;min-width:14rem}
thead th{color:var(--soft);font-weight:600}
tr.chosen td{color:var(--blue);font-weight:600}
li{margin:.2rem 0}
@media print{body{max-width:none;padding:0;font-size:11pt}figure,tr{break-inside:avoid}.wide{overflow:visible}
figure img{min-width:0}
td,th{white-space:normal}}
"""


def page(d: Document, pictures: Mapping[str, bytes]) -> str:
    """The file's text; `pictures` are PNGs by their name in `CAPTIONS`."""
    of = f" of vehicle {escape(d.origin.vehicle)}" if d.origin.vehicle else ""
    body = [
        f"<h1>What model {escape(d.model)}{of} lacks</h1>",
        f'<p class="verdict">{escape(_upper(d.verdict.sentence))}.</p>',
        _list(confidence(d)),
        f'<p class="note">{_origin(d)}</p>',
        *(
            _figure(name, pictures[name])
            for name in ("free-run", "regimes", "unknown-input", "evidence")
            if name in pictures
        ),
        *_section("How large it is", _list(_strengths(d))),
        *_section("Where in the model", _list(d.located.sentences) + _equations(d)),
        *_section(
            "Where something is still missing", _list(d.left.sentences) if d.left.equations and d.strengths else ""
        ),
        *_section("What it means for diagnosis", "".join(f"<p>{escape(text)}</p>" for text in meaning(d))),
        *_section("Why it should not be added as it is", _list(d.refused)),
        *_section("What to do next", _list(next_steps(d))),
        *_section("The held-out free run by operating mode", _regimes(d)),
        *_section("Whether what is left is noise", _whiteness(d)),
        *_section("Evidence", _evidence(d)),
        *_section("Parameters against the datasheet", _list(d.drift.sentences) if d.drift and d.named else ""),
        *_section("What changes in the structure", _list(d.structure.sentences) if d.structure and d.named else ""),
        *_section("What changes on the vehicle", _list(d.bundle.sentences) if d.bundle else ""),
        *_section("The library, entry by entry", _entries(d)),
        *_section("What this does not say", _list(limits(d))),
    ]
    title = escape(f"{d.model}: {d.verdict.kind}")
    head = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{title}</title><style>{STYLE}</style></head><body>\n"
    )
    return head + "\n".join(body) + "\n</body></html>\n"


def _origin(d: Document) -> str:
    names = ", ".join(d.origin.held_out)
    said = f"Fitted to {', '.join(d.origin.training)}; held out: {names}."
    sources = f" Recordings: {'; '.join(d.origin.sources)}." if d.origin.sources else ""
    simulated = " <strong>All data are simulated; no figure is of a real vehicle.</strong>" if d.simulated else ""
    return escape(said + sources) + simulated


def _figure(name: str, png: bytes) -> str:
    caption = escape(CAPTIONS[name])
    source = f"data:image/png;base64,{base64.b64encode(png).decode()}"
    picture = f'<div class="wide"><img alt="{caption}" src="{source}"></div>'
    return f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"


def _section(title: str, body: str) -> list[str]:
    return [f"<h2>{escape(title)}</h2>", body] if body else []


def _list(lines: Iterable[str]) -> str:
    items = "".join(f"<li>{_marked(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def _marked(line: str) -> str:
    """With what is between backticks as code."""
    return CODE.sub(r"<code>\1</code>", escape(_upper(line)))


def _equations(d: Document) -> str:
    said = [f"{name}: {text}" for name, text in d.located.descriptions.items()]
    return f"<p>{escape('; '.join(said))}</p>" if said else ""


def _strengths(d: Document) -> list[str]:
    nearest = "" if d.named else " (the nearest, and not its name)"
    return [f"{strength.words}; {strength.effect}{nearest}" for strength in d.strengths]


def _evidence(d: Document) -> str:
    e = d.evidence
    rows = [
        [
            "training",
            f"{e.training_before:.1f}",
            f"{e.training_after:.1f}",
            f"{e.training_after - e.training_before:+.1f}",
        ],
        [
            "held out",
            f"{e.held_out_before:.1f}",
            f"{e.held_out_after:.1f}",
            f"{e.held_out_after - e.held_out_before:+.1f}",
        ],
        ["left, in the noise's mean square", f"{e.dispersion_before:.2f}", f"{e.dispersion_after:.2f}", ""],
    ]
    note = (
        "<p>Log probabilities [nats] of the recordings under the model, up to a constant, with all that is unknown "
        "integrated out. 5 nats are odds of 150 to 1.</p>"
    )
    return _table(["recordings", "before", "after", "gain"], rows, text=()) + note if d.strengths else ""


def _regimes(d: Document) -> str:
    head = ["output", "mode", "RMS before", "after", "bias before", "after", "floor", "expected", "gap closed"]
    note = (
        "<p>Floor: the sensor's own flicker; expected: with what the inputs' noise makes of a free run. No gap is told "
        "where there was none that an RMS error could show.</p>"
    )
    return _table(head, [_regime(r) for r in d.regimes]) + note


def _regime(r: Regime) -> list[str]:
    one, unit = (100.0, "mbar") if r.unit == "Pa" else (1.0, r.unit)

    def told(value: float | None) -> str:
        return "-" if value is None else f"{value / one:z.1f}" if unit == "mbar" else f"{value:.3g}"

    closed = "-" if r.closure is None else f"{100 * r.closure:.0f} %"
    values = [told(v) for v in (r.rms_before, r.rms_after, r.bias_before, r.bias_after, r.floor, r.expected)]
    return [f"{r.output} [{unit}]", r.mode, *values, closed]


def _whiteness(d: Document) -> str:
    head = ["output", "mode", "neighbours before", "after", "probability before", "after"]
    rows = []
    for r in d.regimes:
        correlations, chances = zip(*(_white(white) for white in (r.white_before, r.white_after)), strict=True)
        rows.append([r.output, r.mode, *correlations, *chances])
    note = (
        "<p>Of means of a second, weighed as the evidence is: the correlation of neighbours, and the probability of "
        "more correlation (Ljung and Box, ten lags) if only noise were left. Minutes of data show where "
        "a hundredth of a bar is left: how large it is, the errors above say.</p>"
    )
    return _table(head, rows) + note


def _white(found: White | None) -> tuple[str, str]:
    return ("-", "-") if found is None else (f"{found.lag1:+.2f}", f"{found.probability:.2g}")


def _entries(d: Document) -> str:
    head = ["entry", "evidence [nats]", "training", "held out", "smallest visible", "looks the same here"]
    chosen = {c.name for place in d.verdict.places for c in place.candidates} if d.named else set()
    rows = [_entry(entry) for entry in d.entries]
    note = (
        "<p>Entries without evidence were left behind after a few steps of their fit, as others did more. Smallest "
        "visible: the size from which these recordings would speak for it.</p>"
    )
    marked = [entry.name in chosen for entry in d.entries]
    return _table(head, rows, text=(5,), marked=marked) + note


def _entry(e: Entry) -> list[str]:
    if e.no_place is not None:
        return [e.name, "-", "-", "-", "-", f"no place in this model: {e.no_place}"]
    gains = ["-" if gain is None else f"{gain:.1f}" for gain in (e.gain, e.gain_training, e.gain_held_out)]
    smallest = "cannot be shown" if e.smallest is None else readable(e.smallest, e.unit)
    return [e.name, *gains, smallest, ", ".join(e.alike)]


def _table(
    head: Sequence[str], rows: Sequence[Sequence[str]], text: Sequence[int] = (1,), marked: Sequence[bool] = ()
) -> str:
    """A table that scrolls by itself if it is too wide; columns in `text` are words, `marked` rows stand out."""

    def row(cells: Sequence[str], tag: str) -> str:
        kinds = [' class="text"' if k in text else "" for k in range(len(cells))]
        return "".join(f"<{tag}{kind}>{escape(cell)}</{tag}>" for kind, cell in zip(kinds, cells, strict=True))

    of = [*marked, *(False for _ in rows)]
    lines = [f"<tr{' class=chosen' if of[k] else ''}>{row(cells, 'td')}</tr>" for k, cells in enumerate(rows)]
    table = f"<table><thead><tr>{row(head, 'th')}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
    return f'<div class="wide">{table}</div>'


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]
