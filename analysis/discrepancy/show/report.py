"""Everything that is written about a discovery: for programs, for a review, for a page and for those in a hurry."""

from faultline.analysis.discrepancy.add.held_out import Shown
from faultline.analysis.discrepancy.discover import Discovery
from faultline.analysis.discrepancy.show.abscissa import abscissa_of
from faultline.analysis.discrepancy.show.document import Document, encoded
from faultline.analysis.discrepancy.show.page import page
from faultline.analysis.discrepancy.show.summary import summary

DOCUMENT = "discovery.json"

PICTURES = ("free-run", "regimes", "unknown-input", "evidence")
"""All that there may be."""


def files_of(found: Discovery, document: Document, runs: Shown) -> dict[str, bytes]:
    """Content of `discovery.json`, `summary.md`, `report.html` and its pictures as PNG, by file name."""
    from faultline.analysis.discrepancy.show.picture import pictures  # matplotlib takes a second to import

    drawn = pictures(document, runs, found.study.model, abscissa_of(found))
    return {
        DOCUMENT: encoded(document),
        "summary.md": summary(document).encode(),
        "report.html": page(document, drawn).encode(),
        **{f"{name}.png": png for name, png in drawn.items()},
    }
