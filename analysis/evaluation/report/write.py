"""Writes the report's two files."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.report.document import Evaluation, evaluation
from faultline.analysis.evaluation.report.page import page
from faultline.analysis.evaluation.report.pictures import pictures
from faultline.analysis.evaluation.story import Story
from faultline.service.bundle.load import Bundle
from faultline.writing import write_files

PAGE, DATA = "report.html", "report.json"


def write(
    folder: Path,
    bundle: Bundle,
    judged: Sequence[Facts],
    stories: Sequence[Story],
    required: Sequence[tuple[str, str | None]] = (),
) -> Evaluation:
    """Writes `report.html` and `report.json`; `stories` are those of the recordings shown over time."""
    document = evaluation(bundle, judged, required)
    files = {
        PAGE: page(document, pictures(document, judged, stories)).encode(),
        DATA: msgspec.json.format(msgspec.json.encode(document), indent=1) + b"\n",
    }
    write_files({folder / name: content for name, content in files.items()})
    return document
