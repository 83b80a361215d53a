"""What a reader would see in a picture: its marks, and texts that overlap or are cut off."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox


def texts(figure: Figure) -> list[tuple[str, Bbox]]:
    """All visible texts with their places in pixels."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
    found = [t for t in figure.findobj(Text) if isinstance(t, Text) and t.get_visible() and t.get_text().strip()]
    return [(t.get_text(), t.get_window_extent(renderer)) for t in found]


def overlapping(seen: list[tuple[str, Bbox]]) -> list[tuple[str, str]]:
    """Pairs of texts that overlap by more than half a pixel on each side."""
    names, boxes = [name for name, _ in seen], np.array([box.extents for _, box in seen]).reshape(-1, 4)
    low, high = boxes[:, :2] + 0.5, boxes[:, 2:] - 0.5
    over = ((low[:, None] < high[None]) & (low[None] < high[:, None])).all(axis=2)
    return [(names[i], names[j]) for i, j in np.argwhere(np.triu(over, 1))]


def cut_off(seen: list[tuple[str, Bbox]], figure: Figure) -> list[str]:
    """Texts that stick out of the figure."""
    width, height = figure.get_size_inches() * figure.dpi
    return [name for name, box in seen if box.x0 < 0 or box.y0 < 0 or box.x1 > width or box.y1 > height]


def marks(figure: Figure, name: str) -> list[tuple[float, float]]:
    """The (x, y) of the marks with this name, in columns and rows."""
    [axes] = figure.axes
    [found] = [c for c in axes.collections if c.get_gid() == name]
    return [(float(x), float(y)) for x, y in np.asarray(found.get_offsets())]
