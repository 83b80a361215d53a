"""An evaluation as one HTML file that needs nothing else: sections in the order of a review."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from faultline.analysis.evaluation.report import tables
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.report.pictures import Picture
from faultline.analysis.evaluation.report.wording import LIMITS, TERMS, hourly, modes_of
from faultline.analysis.evaluation.sentence import never
from faultline.service.pages import render

TEMPLATE = Path(__file__).with_name("page.html.j2")


def page(e: Evaluation, drawn: Mapping[str, Sequence[Picture]]) -> str:
    """Return the file's text; `drawn` are the pictures of each section (`analysis.evaluation.report.pictures`)."""
    return render(
        TEMPLATE,
        title=f"Evaluation of bundle {e.bundle}",
        e=e,
        verdict=_verdict(e),
        origin=origin(e),
        drawn=drawn,
        tables=tables,
        terms=[*TERMS, ("Operating modes", modes_of(e.modes))],
        limits=LIMITS,
    )


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


def origin(e: Evaluation) -> str:
    """Return what was judged, and on which recordings."""
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
