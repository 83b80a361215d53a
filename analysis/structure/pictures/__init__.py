"""Pictures of a structural analysis, each a matplotlib figure; `save` writes one as SVG and PNG."""

from faultline.analysis.structure.pictures.decomposition import draw_decomposition
from faultline.analysis.structure.pictures.graph import draw_graph
from faultline.analysis.structure.pictures.isolability import draw_isolability
from faultline.analysis.structure.pictures.model import draw_model
from faultline.analysis.structure.pictures.signatures import draw_signatures
from faultline.analysis.structure.pictures.style import drawn, save

__all__ = ["draw_decomposition", "draw_graph", "draw_isolability", "draw_model", "draw_signatures", "drawn", "save"]
