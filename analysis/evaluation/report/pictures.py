"""The pictures of the page, as PNG with the words for those who cannot see them."""

import io
from collections.abc import Sequence
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.report import compared, curves, histograms, traces
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.story import Story

DPI = 100


class Picture(NamedTuple):
    """A picture (PNG), what it says to who cannot see it, and its caption."""

    png: bytes
    alt: str
    caption: str


def pictures(e: Evaluation, of: Sequence[Facts], stories: Sequence[Story]) -> dict[str, list[Picture]]:
    """By the section that they are in; `stories` are of the recordings shown over time."""
    mpl.use("Agg")
    facts = {one.verdict.recording: one for one in of}
    drawn = [(story, facts[story.recording]) for story in stories]
    return {
        "histograms": [picture(*made) for made in histograms.draw(e, of)],
        "roc": [picture(*made) for made in curves.draw(e, of)],
        "methods": [picture(*made) for made in compared.draw(e, drawn)],
        "traces": [picture(*traces.draw(e, story, one)) for story, one in drawn],
    }


def picture(figure: Figure, alt: str, caption: str) -> Picture:
    """A figure as a picture."""
    out = io.BytesIO()
    figure.savefig(out, dpi=DPI, metadata={"Software": None})  # the same data give the same bytes
    return Picture(out.getvalue(), alt, caption)
