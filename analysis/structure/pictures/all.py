"""All pictures of a model."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from faultline.analysis.model import Model
from faultline.analysis.structure.decomposition import dulmage_mendelsohn
from faultline.analysis.structure.diagnosability import isolability_of
from faultline.analysis.structure.document import CAUSALITIES
from faultline.analysis.structure.pictures import (
    draw_decomposition,
    draw_graph,
    draw_isolability,
    draw_model,
    draw_signatures,
    drawn,
)
from faultline.analysis.structure.structure import Structure, structure_of
from faultline.analysis.structure.supports import Support, Test, find_tests

MANY_ROWS, MANY_GRAPHS = 120, 40


def draw_all(model: Model | Structure, name: str, tests: Sequence[Support] | None = None) -> dict[str, bytes]:
    """Draws structure, decomposition, isolability, fault signatures and the graph of every test that can be run.

    Each is an SVG and a PNG with the model's `name`; their content by file name. Pictures that would show nothing are
    left out. Of many tests the first are drawn, those that can be run before others: a longer picture nobody reads.
    """
    structure, tests = structure_of(model), find_tests(model) if tests is None else tests
    figures: dict[str, Figure] = {
        "structure": draw_model(structure, name),
        "decomposition": draw_decomposition(structure, dulmage_mendelsohn(structure), name),
    }
    if structure.faults:
        relations = {str(causality): isolability_of(structure, causality) for causality in CAUSALITIES}
        figures["isolability"] = draw_isolability(relations, name)
    runnable = [test for test in tests if isinstance(test, Test)]
    if tests:
        shown = tests if len(tests) <= MANY_ROWS else (runnable or tests)[:MANY_ROWS]
        of_all = name if len(shown) == len(tests) else f"{name} (of its {len(tests)} tests)"
        figures["signatures"] = draw_signatures(shown, structure.faults, of_all)
    for test in runnable[:MANY_GRAPHS]:
        figures[f"graph-{test.name}"] = draw_graph(structure, test, name)
    return {file: raw for title, figure in figures.items() for file, raw in drawn(figure, title).items()}
