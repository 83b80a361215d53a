"""What the pictures of a discovery share: colours, the models' names, units, and how a figure becomes bytes."""

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from faultline.analysis.discrepancy.show.document import Document

# Okabe and Ito, Color universal design (2008): told apart with every kind of colour blindness.
BEFORE, AFTER, ALSO, INK, QUIET, BAND = "#D55E00", "#0072B2", "#56B4E9", "#222222", "#9a9a9a", "#e4e4e4"

IS, WAS = "model as it is", "model as it was"


def simulated(document: Document) -> str:
    """What titles end with."""
    return "; simulated data" if document.simulated else ""


def with_effects(document: Document) -> str:
    """What the model after is called."""
    return "with the nearest effects" if document.verdict.kind == "unnamed" else "with the effect"


def png(figure: Figure) -> bytes:
    """As PNG; the same figure gives the same bytes."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()
