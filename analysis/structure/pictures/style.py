"""What all pictures share: colours, sizes in inches, the title and legend above a drawing, and how it is written."""

import textwrap
from collections.abc import Sequence
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.textpath import TextPath

from faultline.writing import write_files

# Okabe and Ito, Color universal design (2008): told apart with every kind of colour blindness.
BLUE, ORANGE, GREEN, VERMILION, SKY, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7"
INK, GREY, LINE, BAND = "#222222", "#767676", "#d9d9d9", "#f1f1f1"

Colour = str | tuple[float, float, float]

POINTS_PER_INCH = 72
MARGIN, GAP = 0.15, 0.12  # around a picture, and between title, legend and drawing [in]
NARROW = 6.5  # where the title is broken, though the drawing be narrower [in]
TITLE_POINTS, LEGEND_POINTS = 12.0, 9.0
DPI, MOST_PIXELS = 160, 10_000  # of a PNG; a wider picture gets fewer dots per inch

STYLE: dict[Any, object] = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Verdana", "Arial", "Helvetica"],
    "svg.fonttype": "none",  # text stays text: it can be searched and copied
    "svg.hashsalt": "faultline",  # or every run would give other bytes
    "text.parse_math": False,  # a name may contain dollar signs
}


@cache
def text_width(text: str, points: float, *, bold: bool = False) -> float:
    """The width of a line of text [in]; a little more, because a viewer of an SVG may have another font."""
    if not text.strip():
        return 0.0
    font = FontProperties(weight="bold" if bold else "normal")
    return 1.05 * float(TextPath((0, 0), text, size=points, prop=font).vertices[:, 0].max()) / POINTS_PER_INCH


def blank(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure with axes of this size [in] and nothing else; `finish` makes room for what sticks out of them."""
    figure = Figure(figsize=(width, height))
    axes = figure.add_axes((0, 0, 1, 1))
    for spine in axes.spines.values():
        spine.set_visible(False)
    return figure, axes


def finish(figure: Figure, title: str, handles: Sequence[Artist]) -> Figure:
    """The figure made as large as its drawing needs, with a title and a legend above it."""
    renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    width, height = figure.get_size_inches()
    drawn = figure.get_tightbbox(renderer)
    room = max(drawn.width, NARROW)
    columns = _legend_columns(handles, room)
    line = int(room / text_width("n", TITLE_POINTS, bold=True))
    head = figure.text(0, 0, textwrap.fill(title, line), fontsize=TITLE_POINTS, fontweight="bold", color=INK, va="top")
    legend = figure.legend(
        handles=list(handles), ncols=columns, loc="upper left", fontsize=LEGEND_POINTS, frameon=False, borderpad=0,
        borderaxespad=0, labelcolor=INK, handlelength=1.4, handletextpad=0.5,
    )  # fmt: skip
    sizes = [extent.get_window_extent(renderer) for extent in (head, legend)]
    head_height, legend_height = (size.height / figure.dpi for size in sizes)
    above = head_height + GAP + (legend_height + GAP if handles else 0)
    whole = (
        max(drawn.width, *(size.width / figure.dpi for size in sizes)) + 2 * MARGIN,
        drawn.height + above + 2 * MARGIN,
    )
    figure.set_size_inches(*whole)
    left, bottom = MARGIN - drawn.x0, MARGIN - drawn.y0
    for axes in figure.axes:
        axes.set_position((left / whole[0], bottom / whole[1], width / whole[0], height / whole[1]))
    head.set_position((MARGIN / whole[0], 1 - MARGIN / whole[1]))
    legend.set_bbox_to_anchor((MARGIN / whole[0], 1 - (MARGIN + head_height + GAP) / whole[1]))
    if not handles:
        legend.remove()
    return figure


def marker(colour: str, label: str, shape: str = "s") -> Line2D:
    """The entry of a legend for a mark."""
    return Line2D([], [], linestyle="none", marker=shape, markersize=8, color=colour, label=label)


def box(face: Colour, label: str, edge: str | None = None) -> Patch:
    """The entry of a legend for an area."""
    return Patch(facecolor=face, edgecolor=edge or face, label=label)


def tint(colour: str, share: float) -> Colour:
    """A colour mixed with white; `share` 1 is the colour itself."""
    red, green, blue = mpl.colors.to_rgb(colour)
    return 1 - share * (1 - red), 1 - share * (1 - green), 1 - share * (1 - blue)


def save(figure: Figure, folder: Path, name: str) -> tuple[Path, Path]:
    """Writes NAME.svg and NAME.png; the folder is made. Returns the paths."""
    write_files({folder / file: content for file, content in drawn(figure, name).items()})
    return folder / f"{name}.svg", folder / f"{name}.png"


def drawn(figure: Figure, name: str) -> dict[str, bytes]:
    """Content of NAME.svg and of NAME.png, the same bytes for the same picture."""
    svg, png = BytesIO(), BytesIO()
    dpi = min(DPI, MOST_PIXELS / max(figure.get_size_inches()))
    with mpl.rc_context(STYLE):
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
        figure.savefig(png, format="png", dpi=dpi, metadata={"Software": None})
    return {f"{name}.svg": svg.getvalue(), f"{name}.png": png.getvalue()}


def _legend_columns(handles: Sequence[Artist], width: float) -> int:
    """As many entries side by side as the drawing is wide, one at least."""
    widest = max((text_width(str(handle.get_label()), LEGEND_POINTS) + 0.6 for handle in handles), default=1.0)
    return max(1, min(len(handles), int(width / widest)))
