"""All pictures of a model in one folder."""

from pathlib import Path

from matplotlib.figure import Figure

from analysis.model import Model
from analysis.structure.decomposition import dulmage_mendelsohn
from analysis.structure.diagnosability import isolability_of
from analysis.structure.document import CAUSALITIES
from analysis.structure.pictures import (
    draw_decomposition,
    draw_graph,
    draw_isolability,
    draw_model,
    draw_signatures,
    save,
)
from analysis.structure.structure import Structure, structure_of
from analysis.structure.supports import Test, find_tests


def draw_all(model: Model | Structure, folder: Path) -> list[Path]:
    """Draws structure, decomposition, isolability, fault signatures and the graph of every test that can be run.

    Each is an SVG and a PNG; the paths written. Pictures that would show nothing are left out.
    """
    structure, tests = structure_of(model), find_tests(model)
    name = model.name if isinstance(model, Model) else "the model"
    figures: dict[str, Figure] = {
        "structure": draw_model(structure, name),
        "decomposition": draw_decomposition(structure, dulmage_mendelsohn(structure), name),
    }
    if structure.faults:
        relations = {str(causality): isolability_of(structure, causality) for causality in CAUSALITIES}
        figures["isolability"] = draw_isolability(relations, name)
    if tests:
        figures["signatures"] = draw_signatures(tests, structure.faults, name)
    for test in tests:
        if isinstance(test, Test):
            figures[f"graph-{test.name}"] = draw_graph(structure, test, name)
    return [path for title, figure in figures.items() for path in save(figure, folder, title)]
