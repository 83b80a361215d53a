"""The printable report: one HTML file of its own, without script, readable in grey. Every text is escaped."""

from collections.abc import Iterable, Sequence
from html import escape

from faultline.service.core.faults import Fault as Remembered
from faultline.service.core.health import MEANINGS, Standing
from faultline.service.workshop import svg
from faultline.service.workshop.answers import System
from faultline.service.workshop.hindrance import REMEDIES
from faultline.service.workshop.plan import REQUIRED
from faultline.service.workshop.result import RememberedSeen, Result
from faultline.service.workshop.trace import Sample
from faultline.service.workshop.verdict import ENDS, Candidate
from faultline.service.workshop.words import HEADLINES, separation_line

STYLE = """@page{size:A4;margin:15mm}
body{font:10pt/1.35 sans-serif;color:#000;background:#fff;max-width:180mm;margin:8mm auto}
h1{font-size:15pt;margin:0 0 2mm}h2{font-size:11pt;margin:6mm 0 1mm;break-after:avoid}
table{border-collapse:collapse;width:100%;font-size:9pt}th,td{border:0.2mm solid #888;padding:0.6mm 1.5mm;
text-align:left;vertical-align:top;overflow-wrap:break-word}th{background:#eee}tr,svg,.verdict{break-inside:avoid}
.verdict{border:0.8mm solid #000;padding:2mm 4mm;margin:3mm 0}.verdict p{margin:0;font-size:14pt;font-weight:bold}
ul{margin:1mm 0;padding-left:5mm}svg{width:100%;font:9px sans-serif}.short{font-weight:bold}
figcaption{font-size:8pt}figure{margin:2mm 0;break-inside:avoid}
@media print{body{margin:0}}"""

SAID = {
    "fault": "A fault was found.",
    "no-fault": "No fault found.",
    "cannot-tell": "Cannot tell: this is no all-clear.",
}


def page(result: Result, system: System, samples: Sequence[Sample]) -> str:
    """The report of a result, with pictures of what was seen."""
    title = f"Diagnosis test of {result.system}, {result.source}"
    body = [
        f"<h1>{escape(title)}</h1>",
        _facts(result),
        _verdict(result),
        _candidates(result),
        _separating(result),
        _steps(result),
        _coverage(result),
        _tests(result, system),
        _pictures(system, samples),
        _conditions(result),
        _remembered(result.remembered),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body>\n{chr(10).join(filter(None, body))}\n"
        "</body></html>\n"
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; its cells are escaped here."""
    cells = "".join(f"<th>{escape(each)}</th>" for each in head)
    lines = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>\n" for row in rows)
    return f"<table><thead><tr>{cells}</tr></thead><tbody>\n{lines}</tbody></table>"


def _list(texts: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def _section(head: str, content: str) -> str:
    return f"<h2>{escape(head)}</h2>\n{content}" if content else ""


def _facts(result: Result) -> str:
    facts = [
        ("vehicle", result.source),
        ("system", f"{result.system}, sensors: {result.sensor_set}"),
        ("begun, ended", f"{result.begun} to {result.ended}, {result.seconds:.0f} s observed"),
        ("ended as", ENDS[result.end]),
        ("service", f"faultline {result.service}"),
        ("bundle", f"version {result.bundle_version}, {result.bundle}"),
        ("note", result.note or ""),
    ]
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in facts if value)
    return f"<table><tbody>{rows}</tbody></table>"


def _verdict(result: Result) -> str:
    verdict = result.verdict
    there = ("; it is there now" if verdict.present else "; it is not there now") if verdict.kind == "fault" else ""
    said = SAID[verdict.kind].rstrip(".") + there
    return f'<div class="verdict"><p>{escape(HEADLINES[verdict.kind])}</p>{escape(said)}.{_list(verdict.reasons)}</div>'


def _candidates(result: Result) -> str:
    rows = [
        (
            str(each.rank),
            " and ".join(name.component or name.name for name in each.faults) or "unknown",
            _described(each),
            "-" if each.p is None else f"{each.p:.3f}",
            ", ".join(f"SPN {name.spn} FMI {name.fmi}" for name in each.faults if name.spn is not None) or "-",
        )
        for each in result.verdict.candidates
    ]
    if not rows:
        return ""
    note = "<p>Candidates of one rank cannot be told apart. p: probability, if it is one of these.</p>"
    return _section("Candidates", _table(("rank", "component", "fault", "p", "J1939 code"), rows) + note)


def _described(candidate: Candidate) -> str:
    if not candidate.faults:
        near = f", near {', '.join(candidate.near)}" if candidate.near else ""
        return f"no fault of a component{near}"
    return " and ".join(f"{name.name}: {name.description or 'not described'}" for name in candidate.faults)


def _separating(result: Result) -> str:
    return _section("Tests that tell them apart", _list(map(separation_line, result.verdict.separating)))


def _steps(result: Result) -> str:
    rows = [
        (each.mode, str(each.visit), f"{each.required_s:.0f} s", f"{each.seen_s:.0f} s", "yes" if each.done else "NO")
        for each in result.steps
    ]
    return _section("Steps of the cycle", _table(("mode", "time", "required", "seen", "done"), rows))


def _coverage(result: Result) -> str:
    def cell(seconds: float, required: float) -> str:
        return f"{seconds:.0f} of {required:.0f} s{'' if seconds >= required else ', SHORT'}"

    rows = [
        (each.test, *(cell(each.seen_s[mode], result.required_s[mode]) for mode in REQUIRED)) for each in result.tests
    ]
    return _section("How long each test could tell, by mode", _table(("test", *REQUIRED), rows))


def _tests(result: Result, system: System) -> str:
    means = {fault.name: fault.component for fault in system.faults}
    rows = [
        (
            each.test,
            " ".join(each.predicts),
            each.verdict + (", alarmed during the test" if each.alarmed and each.verdict != "alarm" else ""),
            f"{each.worst:+.2f}",
            ", ".join(dict.fromkeys(means.get(name, name) for name in each.faults)),
        )
        for each in result.tests
    ]
    head = ("test", "predicts", "verdict at the end", "largest sum (alarm from 1 on)", "knows faults of")
    return _section("Tests", _table(head, rows))


def _pictures(system: System, samples: Sequence[Sample]) -> str:
    if not samples:
        return ""
    figures = "".join(
        f"<figure>{picture}<figcaption>{escape(caption)}</figcaption></figure>"
        for caption, picture in svg.signals(system, samples)
    )
    shades = "Background: white idle, grey partial dose, dark grey maximum dose."
    caption = "Sum of each test in parts of its threshold, held at -2 and 2; alarm beyond the dashed lines, -1 and 1."
    return _section(
        "What was seen",
        f"<p>{shades}</p>{figures}<figure>{svg.sums(system, samples)}<figcaption>{caption}</figcaption></figure>",
    )


def _conditions(result: Result) -> str:
    def lines(conditions: Sequence[Standing]) -> str:
        return _list(f"{each.of} {MEANINGS[each.kind]}: {REMEDIES[each.kind]}" for each in conditions)

    before, after = lines(result.conditions_before), lines(result.conditions)
    return _section("Buses and signals, before the test", before) + _section("Buses and signals, at its end", after)


def _remembered(remembered: Sequence[RememberedSeen]) -> str:
    rows = [
        (
            str(each.fault.number),
            _components(each.fault),
            _status(each.fault),
            f"{each.fault.occurrences}x, last {each.fault.latest.wall or 'at an unknown time'}",
            "in this test" if each.during_test else "before this test",
        )
        for each in remembered
    ]
    text = _table(("number", "component", "status", "seen", "told"), rows) if rows else "<p>No fault is remembered.</p>"
    return _section("Fault memory, as history", text)


def _components(fault: Remembered) -> str:
    return " or ".join(fault.components) or "unknown"


def _status(fault: Remembered) -> str:
    status = fault.status
    kind = "confirmed" if status.confirmed else "pending" if status.pending else "was pending"
    return f"{'is there' if status.test_failed else 'is not there any more'}, {kind}, 0x{fault.mask:02X}"
