"""The page of a fleet, and the same as text."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from faultline.analysis.fleet.findings import Finding, Fleet
from faultline.service.pages import Row, Table, render

TEMPLATE = Path(__file__).with_name("page.html.j2")
HEAD = ("vehicle", "component", "since", "drives", "how sure", "size", "or else")
WORDS = (1, 2, 5, 6)
"""Columns of it that hold words."""

MEANING = {
    "fault": "a fault was found",
    "no fault": "every test could tell, and none alarms",
    "open": "no fault was found, and that there is none cannot be said",
    "failed": "the log could not be diagnosed",
}


def page_of(fleet: Fleet) -> str:
    """Return the page (HTML)."""
    note = (
        "A finding is what the likeliest explanation of a drive names, with its probability at the end of the last "
        "drive that has it. It stands where the vehicle's last drive with a verdict has it. Drives without a verdict "
        "neither confirm nor end one."
    )
    tables = {
        "standing": Table(HEAD, [_row(each) for each in fleet.standing], text=WORDS),
        "components": Table(("component", "vehicles"), [(n, str(k)) for n, k in fleet.by_component.most_common()]),
        "past": Table(HEAD, [_row(each) for each in fleet.past], text=WORDS),
        "silent": Table(("vehicle", "why, of its last drive"), list(fleet.silent.items()), text=(1,)),
        "drives": Table(("verdict", "drives", "meaning"), _verdicts(fleet), text=(2,)),
    }
    return render(TEMPLATE, title="The fleet", verdict=sentence(fleet), note=note, tables=tables)


def sentence(fleet: Fleet) -> str:
    """Return the verdict on a fleet in a sentence."""
    having = len({each.vehicle for each in fleet.standing})
    made = f" {fleet.simulated} of {fleet.verdicts.total()} drives are simulated." if fleet.simulated else ""
    nothing = f"; of {len(fleet.silent)} nothing is known" if fleet.silent else ""
    return f"{having} of {fleet.vehicles} vehicles have a fault, by {fleet.hours:.1f} hours of driving{nothing}.{made}"


def text_of(fleet: Fleet) -> str:
    """Return the same as lines of text: what stands, what was found before, and vehicles of which nothing is known."""
    lines = [sentence(fleet), *_lines(fleet.standing)]
    if fleet.past:
        lines += ["found before, and not in the last drive:", *_lines(fleet.past)]
    lines += [f"{vehicle}: nothing is known: {why}" for vehicle, why in fleet.silent.items()]
    return "\n".join(lines)


def _lines(findings: Sequence[Finding]) -> list[str]:
    """Return the findings as a table, or nothing where there are none."""
    return _columns([[str(cell) for cell in row] for row in (HEAD, *map(_row, findings))]) if findings else []


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _row(finding: Finding) -> Row:
    sure = "not said" if finding.p is None else f"{100 * finding.p:.0f} %"
    drives = f"{finding.number} of {finding.of}"
    return finding.vehicle, finding.components, _day(finding.first), drives, sure, finding.size, finding.others


def _day(start: datetime | None) -> str:
    return "undated" if start is None else f"{start:%Y-%m-%d %H:%M}"


def _verdicts(fleet: Fleet) -> list[Row]:
    return [(name, str(fleet.verdicts[name]), meaning) for name, meaning in MEANING.items() if fleet.verdicts[name]]
