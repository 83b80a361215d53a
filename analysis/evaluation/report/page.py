"""An evaluation as one HTML file that needs nothing else: sections in the order of a review."""

from collections.abc import Mapping, Sequence

from faultline.analysis.evaluation.report import markup, tables
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.report.markup import folded, paragraph, section
from faultline.analysis.evaluation.report.pictures import Picture
from faultline.analysis.evaluation.report.wording import LIMITS, TERMS, hourly
from faultline.analysis.evaluation.sentence import never


def page(e: Evaluation, drawn: Mapping[str, Sequence[Picture]]) -> str:
    """The file's text; `drawn` are the pictures of each section (`analysis.evaluation.report.pictures`)."""
    shown = {name: [markup.figure(p.png, p.alt, p.caption) for p in found] for name, found in drawn.items()}
    several = len({test.test for test in e.tests}) < len(e.tests)
    parts = [
        markup.title(f"What bundle {e.bundle} tells, against the truth"),
        paragraph(_verdict(e), "verdict"),
        paragraph(_origin(e), "note"),
        section("At a glance", tables.glance(e), paragraph(_shared(e))),
        section("Recordings", folded("each recording, with its verdict", tables.recordings(e))),
        section(
            "Isolation: what is told of each fault",
            tables.confusion(e),
            tables.isolation(e),
            folded("which component each fault is of", tables.faults(e)),
        ),
        section("Fault-free: each test by itself", tables.fault_free(e)),
        section(
            "Fault signature matrix, realised and structural",
            tables.signature(e) if e.isolation else "",
            tables.delays(e) if e.isolation else "",
            tables.blind(e) if e.isolation else "",
        ),
        section("Residuals without and with each fault", *shown.get("histograms", [])),
        section(
            "How well each residual separates",
            *shown.get("roc", []),
            tables.by_mode(e) if e.isolation else "",
            folded("each generator and fault", tables.areas(e)) if e.isolation else "",
        ),
        section(
            "Equations and networks side by side",
            tables.methods(e) if several else "",
            *shown.get("methods", []),
        ),
        section("Which generators to keep", *_selection(e)),
        section("Residuals and detectors over time", *shown.get("traces", [])),
        section("What the terms mean", markup.definitions(TERMS)),
        section("What this does not say", "".join(map(paragraph, LIMITS))),
    ]
    return markup.document(f"Evaluation of bundle {e.bundle}", parts)


def _verdict(e: Evaluation) -> str:
    cases, false = e.isolation, e.told.false_alarms
    recordings = sum(case.recordings for case in cases)
    detected, contained, alone = (
        sum(getattr(case, name).hits for case in cases) for name in ("detected", "contained", "alone")
    )
    peace = (
        f"{false.events} false alarms in {false.hours:.2f} h without a fault in which some test could tell "
        f"({hourly(false)} at 95 %){never([one.verdict for one in e.recordings])}"
    )
    if not cases:
        return f"No recording has a fault. {peace}."
    return (
        f"{detected} of {recordings} faults were detected; at the end the true diagnosis was among those told of "
        f"{contained} and alone of rank 1 of {alone}; {peace}."
    )


def _origin(e: Evaluation) -> str:
    sources = ", ".join(dict.fromkeys(one.source for one in e.recordings))
    vehicles = ", ".join(dict.fromkeys(one.vehicle for one in e.recordings))
    hours = sum(one.fault_free_hours + one.faulty_hours for one in e.recordings)
    modes = ", ".join(f"{mode} {60 * value:.0f} min" for mode, value in e.mode_hours.items())
    said = "All data are simulated; no figure is of a real vehicle. " if e.simulated else ""
    made_for = f"made for vehicle {e.made_for}, " if e.made_for else ""
    return (
        f"{said}Judged: bundle {e.bundle_id[:12]} ({made_for}model {e.model}, sensors {e.sensor_set}, {len(e.tests)} "
        f"generators) on {len(e.recordings)} recordings of {hours:.2f} h ({modes}), vehicle {vehicles}; source: "
        f"{sources}. The bundle names none of them as used for calibration, training or tuning."
    )


def _shared(e: Evaluation) -> str:
    if not e.told.shared:
        return ""
    return (
        "Where diagnoses have no probability (before residuals have settled, of two faults, unknown), it is shared "
        "equally by those of rank 1; FIA is to be read so."
    )


def _selection(e: Evaluation) -> list[str]:
    s = e.selection
    if s is None:
        return [paragraph(f"{len(e.tests)} generators are more than can be searched exactly; give a smaller bundle.")]
    unmet = [paragraph(f"Required, and done by no generator in these recordings: {what}.") for what in s.unmet]
    if not s.requirements:
        none = "what is required" if s.unmet else "a fault of these recordings"
        return [*unmet, paragraph(f"No generator reaches {none}: there is nothing to choose by.")]
    said = (
        f"Keep {', '.join(s.keep)}. They meet all {len(s.requirements)} requirements with an alarm in "
        f"{s.false_blocks} of {s.free_blocks} fault-free blocks and a cost of {s.cost} (one for each generator and "
        f"each of its states); all {len(e.tests)} generators have one in {s.all_false_blocks} and cost {s.all_cost}."
    )
    equal = [f"{test.generator} is numerically {test.equals}" for test in e.tests if test.equals != test.generator]
    also = [" or ".join(", ".join(names) for names in s.alternatives)] if s.alternatives else []
    return [
        *unmet,
        paragraph(said),
        *(paragraph(f"As good: {words}.") for words in also),
        paragraph(f"Counted once, as the same signal: {'; '.join(equal)}.") if equal else "",
        paragraph(
            "A generator reaches a fault if its test is sensitive to it and it alarms in half of the fault's blocks at "
            "least, more often than without a fault; it isolates it from another fault that its test decouples, unless "
            "it is a network: those are no conflicts. All sets of generators were looked at: fewest fault-free blocks "
            "with an alarm first, then the lowest cost."
        ),
        folded("what was required, and which generators do it", tables.requirements(s)),
    ]
