"""Numbers in words, and what the report's terms mean."""

from collections.abc import Mapping

from faultline.analysis.evaluation.measure.intervals import Rate, Share

NONE = "–"


def percent(value: float | None) -> str:
    """A share.

    >>> percent(0.5), percent(None)
    ('50 %', '–')
    """
    return NONE if value is None else f"{100 * value:.0f} %"


def between(of: Share) -> str:
    """The interval of a share.

    >>> between(Share(0, 4, 0.0, 0.0, 0.6024))
    '0–60 %, n 4'
    """
    return f"{100 * of.low:.0f}–{100 * of.high:.0f} %, n {of.trials}"


def hourly(of: Rate) -> str:
    """The interval of a rate."""
    return NONE if of.high is None else f"{of.low:.2g}–{of.high:.2g} an hour"


def seconds(value: float | None) -> str:
    """A time."""
    return NONE if value is None else f"{value:.1f} s"


def number(value: float | None) -> str:
    """With two digits after the point."""
    return NONE if value is None else f"{value:.2f}"


TERMS = (
    (
        "Detected, told",
        "What a subscriber of the vehicle's service would have heard, from the same core: a fault is told once it was "
        "confirmed. What was told last stands until something else is told. An alarm of a single test is no more than "
        "a suspicion and is not told; the tests' tables count those alarms.",
    ),
    (
        "True detection rate (TDR), false alarm rate (FAR)",
        "DX 2025 challenge: shares of the faulty and of the fault-free samples in which some diagnosis stands; of the "
        "fault-free ones those alone in which some test could tell. DAMADICS calls them true and false detection rate.",
    ),
    (
        "Fault isolation accuracy (FIA)",
        "DX 2025 challenge: the mean probability given to the true diagnosis, over the faulty samples in which some "
        "diagnosis stands. Where diagnoses have no probability, it is shared equally by those of rank 1.",
    ),
    (
        "True and false isolation rate",
        "DAMADICS: shares of the faulty time in which the true diagnosis alone is of rank 1, and in which others are "
        "of rank 1 and it is not among them. Detection and isolation time run from the onset to the last rising edge: "
        "what is lost and found again counts from when it was found again.",
    ),
    (
        "True diagnosis",
        "The faults that were there, all together. Of a fault that the bundle does not know, such as a leak, it is "
        "unknown: naming a component is then wrong.",
    ),
    (
        "Block",
        "About 60 s of a recording, before the onset or after it. A generator counts in a block if it could tell in "
        "half of it, and alarms there if its detector does at any time. Intervals are exact (Clopper and Pearson) at "
        "95 % and take blocks as independent, which those of one recording are not quite.",
    ),
    (
        "False alarms",
        "Of what is told: episodes that began before the onset, for each hour in which some test could tell. Of a "
        "generator: alarms of its detector that began before the onset, for each hour in which it could tell. With "
        "exact Poisson intervals (Garwood) at 95 %.",
    ),
    (
        "Score, area under the curve (AUC)",
        "The score of a generator in a block is the absolute mean of its residual, in fault-free spreads of the "
        "operating mode, without the edges; no threshold is in it. The area is the probability that a faulty block "
        "scores higher than a fault-free one: 1 separates them, 0.5 is chance.",
    ),
    (
        "Sensitive, decoupled",
        "By structure: a fault that is in the equations of a test may move its residual, another one may not. Cells to "
        "which a test is sensitive are framed in tables and grey in pictures.",
    ),
)
"""The report's section of definitions; the modules `metrics`, `blocks`, `intervals` and `roc` hold the formulas."""


def modes_of(modes: Mapping[str, str]) -> str:
    """The operating modes with their descriptions."""
    told = "; ".join(f"{name}: {text}" if text else name for name, text in modes.items())
    return f"{told}; edge: some time after each step of an input, when a residual's size says little."


LIMITS = (
    "Rates are those of these recordings: of their vehicles, drives and sizes of faults. Thresholds tuned on one "
    "vehicle say little of another one, and blocks of one drive resemble each other more than drives do.",
    "A fault begins at once and stays in these recordings unless their truth says otherwise. Of creeping faults, "
    "loose contacts and repairs nothing is said.",
    "Which generators to keep was chosen on the recordings it is judged on. Judge the smaller bundle on others.",
)
