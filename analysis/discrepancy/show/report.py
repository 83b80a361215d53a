"""Everything that is written about a discovery: for programs, for a review, for a page and for those in a hurry."""

from pathlib import Path

from faultline.analysis.discrepancy.add.held_out import Shown
from faultline.analysis.discrepancy.discover import Discovery
from faultline.analysis.discrepancy.show.abscissa import abscissa_of
from faultline.analysis.discrepancy.show.document import Document, encoded
from faultline.analysis.discrepancy.show.page import page
from faultline.analysis.discrepancy.show.summary import summary
from faultline.service.core.errors import InputError

DOCUMENT = "discovery.json"

PICTURES = ("free-run", "regimes", "unknown-input", "evidence")
"""All that there may be."""


def write(folder: Path, found: Discovery, document: Document, runs: Shown) -> list[Path]:
    """Writes `discovery.json`, `summary.md`, `report.html` and its pictures as PNG; the paths written.

    Raises:
        InputError: the folder cannot be written.
    """
    from faultline.analysis.discrepancy.show.picture import pictures  # matplotlib takes a second to import

    drawn = pictures(document, runs, found.study.model, abscissa_of(found))
    files = {
        DOCUMENT: encoded(document),
        "summary.md": summary(document).encode(),
        "report.html": page(document, drawn).encode(),
        **{f"{name}.png": png for name, png in drawn.items()},
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in PICTURES if (folder / DOCUMENT).exists() else ():  # of an earlier call, and not of this one
            (folder / f"{name}.png").unlink(missing_ok=True)
        for name, content in files.items():
            (folder / name).write_bytes(content)
    except OSError as error:
        raise InputError(f"{error.filename or folder}: {error.strerror}; give --out another place") from error
    return [folder / name for name in files]
