"""Writes the report's three files."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.report.document import Evaluation, evaluation
from faultline.analysis.evaluation.report.figures.page import page as figures
from faultline.analysis.evaluation.report.page import page
from faultline.analysis.evaluation.report.pictures import pictures
from faultline.analysis.evaluation.story import Array, Story
from faultline.service.bundle.load import Bundle
from faultline.writing import write_files

PAGE, DATA, FIGURES = "report.html", "report.json", "figures.html"


def write(
    folder: Path,
    bundle: Bundle,
    judged: Sequence[Facts],
    stories: Sequence[Story],
    required: Sequence[tuple[str, str | None]] = (),
    made_from: Sequence[tuple[str, Array]] = (),
    beside: Mapping[str, Sequence[Story]] | None = None,
) -> Evaluation:
    """Writes `report.html`, `report.json` and `figures.html`; `stories` are those of the recordings shown over time.

    `made_from` are samples of recordings that the bundle was made from, `beside` the stories of other bundles.
    """
    document = evaluation(bundle, judged, required)
    facts = {one.verdict.recording: one for one in judged}
    drawn = [(story, facts[story.recording]) for story in stories]
    files = {
        PAGE: page(document, pictures(document, judged, stories)).encode(),
        FIGURES: figures(document, drawn, made_from, beside, PAGE).encode(),
        DATA: msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n",
    }
    write_files({folder / name: content for name, content in files.items()})
    return document
