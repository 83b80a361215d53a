"""The printable report: one HTML file of its own, without script, readable in grey."""

from collections.abc import Sequence
from pathlib import Path

from faultline.service.core.records.health import Standing, meaning
from faultline.service.pages import Table, render
from faultline.service.protocol.live import SystemDescription
from faultline.service.workshop import svg
from faultline.service.workshop.hindrance import remedy
from faultline.service.workshop.result import RememberedSeen, Result
from faultline.service.workshop.trace import Sample
from faultline.service.workshop.verdict import ENDS, Candidate
from faultline.service.workshop.words import HEADLINES, separation_line

TEMPLATE = Path(__file__).with_name("report.html.j2")

SAID = {"fault": "A fault was found", "no-fault": "No fault found", "cannot-tell": "Cannot tell: this is no all-clear"}


def page(result: Result, system: SystemDescription, samples: Sequence[Sample]) -> str:
    """Return the report of a result, with pictures of what was seen."""
    verdict = result.verdict
    return render(
        TEMPLATE,
        title=f"Diagnosis test of {result.system}, {result.source}",
        facts=_facts(result),
        headline=HEADLINES[verdict.kind],
        said=SAID[verdict.kind],
        verdict=verdict,
        candidates=_candidates(result),
        separating=[separation_line(each) for each in verdict.separating],
        steps=_steps(result),
        coverage=_coverage(result),
        tests=_tests(result, system),
        pictures=[*svg.signals(system, samples), svg.sums(system, samples)] if samples else [],
        shades=svg.shade_by_mode(system.steady).items(),
        before=_conditions(result.conditions_before),
        after=_conditions(result.conditions),
        remembered=_remembered(result.remembered),
    )


def _words(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    return Table(head, rows, text=range(len(head)))


def _facts(result: Result) -> Table:
    facts = [
        ("vehicle", result.source),
        ("system", f"{result.system}, sensors: {result.sensor_set}"),
        ("begun, ended", f"{result.begun} to {result.ended}, {result.seconds:.0f} s observed"),
        ("ended as", ENDS[result.end]),
        ("service", f"faultline {result.service}"),
        ("bundle", f"version {result.bundle_version}, {result.bundle}"),
        ("note", result.note or ""),
    ]
    return Table([], [fact for fact in facts if fact[1]], text=(1,))


def _candidates(result: Result) -> Table:
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
    return _words(("rank", "component", "fault", "p", "J1939 code"), rows)


def _described(candidate: Candidate) -> str:
    if not candidate.faults:
        return f"no fault of a component, near {', '.join(candidate.near)}" if candidate.near else "none that is known"
    return " and ".join(
        f"{name.name}: {name.description or 'not described'}{f' ({name.place})' if name.place else ''}"
        for name in candidate.faults
    )


def _steps(result: Result) -> Table:
    rows = [
        (each.mode, str(each.visit), f"{each.required_s:.0f} s", f"{each.seen_s:.0f} s", "yes" if each.done else "NO")
        for each in result.steps
    ]
    return _words(("mode", "time", "required", "seen", "done"), rows)


def _coverage(result: Result) -> Table:
    def cell(seconds: float, required: float) -> str:
        return f"{seconds:.0f} of {required:.0f} s{'' if seconds >= required else ', SHORT'}"

    rows = [
        (each.test, *(cell(each.seen_s[mode], result.required_s[mode]) for mode in result.required_s))
        for each in result.tests
    ]
    return _words(("test", *result.required_s), rows)


def _tests(result: Result, system: SystemDescription) -> Table:
    means = {fault.name: fault.component or fault.name for fault in system.faults}
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
    return _words(("test", "predicts", "verdict at the end", "largest sum (alarm from 1 on)", "knows faults of"), rows)


def _conditions(conditions: Sequence[Standing]) -> list[str]:
    return [f"{each.of} {meaning(each.kind)}: {remedy(each.kind)}" for each in conditions]


def _remembered(remembered: Sequence[RememberedSeen]) -> Table:
    rows = [
        (
            str(each.fault.number),
            " or ".join(each.fault.components) or "unknown",
            f"{each.fault.status.words}, 0x{each.fault.mask:02X}",
            f"{each.fault.occurrences}x, last {each.fault.latest.wall or 'at an unknown time'}",
            "in this test" if each.during_test else "before this test",
        )
        for each in remembered
    ]
    return _words(("number", "component", "status", "seen", "told"), rows)
