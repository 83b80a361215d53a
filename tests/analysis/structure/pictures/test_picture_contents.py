"""What the pictures show is what the structure says."""

import networkx as nx
import numpy as np
import pytest
from looked_at import marks, texts
from made_chain import made_test, predicting, tank_chain
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.path import Path

from faultline.analysis.model import Differential, load_model
from faultline.analysis.structure import Structure, Test, find_tests, signature_matrix, structure_of
from faultline.analysis.structure.decomposition import dulmage_mendelsohn
from faultline.analysis.structure.diagnosability import isolability_of
from faultline.analysis.structure.pictures import (
    draw_decomposition,
    draw_graph,
    draw_isolability,
    draw_model,
    draw_signatures,
)
from faultline.analysis.structure.pictures.layers import crossings, layers_of, place

UDS4 = structure_of(load_model("uds"))
TESTS = find_tests(load_model("uds"))
PARTS = Structure(  # M- of 2 x 3, two components of M0, an equation without unknowns beside a class in M+
    equations=("a1", "a2", "b1", "b2", "c1", "c2", "d1", "d2", "d3"),
    unknowns=("u", "v", "w", "p", "q", "x", "y", "z"),
    known=(),
    faults=("f1", "f2", "f3"),
    unknown_rows=(0b111, 0b10000110, 0b11000, 0b111000, 0b1100000, 0b1100000, 0b10000000, 0b10000000, 0),
    known_rows=(0,) * 9,
    fault_rows={"f1": 0, "f2": 2, "f3": 2},
    differentials={},
)
LOOP = Structure(
    equations=("loop1", "loop2", "loop3", "rate", "int", "sense"),
    unknowns=("a", "b", "c", "x", "dx"),
    known=("u", "y"),
    faults=(),
    unknown_rows=(0b01011, 0b00110, 0b00101, 0b11100, 0b11000, 0b01000),
    known_rows=(1, 0, 1, 0, 0, 2),
    fault_rows={},
    differentials={"int": Differential(name="int", state="x", derivative="dx")},
)


def names(figure: Figure) -> list[str]:
    return [text for text, _ in texts(figure)]


def columns(figure: Figure) -> list[str]:
    return [label.get_text() for label in figure.axes[0].get_xticklabels()]


def rows(figure: Figure) -> list[str]:
    return [label.get_text() for label in figure.axes[0].get_yticklabels()]


def patches(figure: Figure, name: str) -> list[Rectangle]:
    return [p for p in figure.axes[0].patches if isinstance(p, Rectangle) and p.get_gid() == name]


@pytest.mark.parametrize("structure", [UDS4, tank_chain(25), PARTS], ids=["uds", "chain", "parts"])
def test_the_structural_model_has_a_mark_for_every_incidence(structure: Structure) -> None:
    figure = draw_model(structure)
    unknown = sum(row.bit_count() for row in structure.unknown_rows)
    constraints = 2 * len(structure.differentials)
    assert len(marks(figure, "marks-unknowns")) == unknown - constraints
    assert len(marks(figure, "marks-differential")) == constraints
    assert len(marks(figure, "marks-faults")) == len(structure.faults)
    if structure.known:
        assert len(marks(figure, "marks-known")) == sum(row.bit_count() for row in structure.known_rows)
    assert columns(figure)[: len(structure.unknowns)] == list(structure.unknowns)
    assert rows(figure)[: len(structure.equations)] == list(structure.equations)


def test_a_state_has_an_i_and_its_derivative_a_d() -> None:
    [axes] = draw_model(UDS4).axes
    letters = {(t.get_position(), t.get_text()) for t in axes.texts if t.get_text() in ("I", "D")}
    expected = set()
    for name, constraint in UDS4.differentials.items():
        row = UDS4.equations.index(name)
        expected.add(((UDS4.unknowns.index(constraint.state), row), "I"))
        expected.add(((UDS4.unknowns.index(constraint.derivative), row), "D"))
    assert letters == expected


@pytest.mark.parametrize("structure", [UDS4, tank_chain(25), PARTS], ids=["uds", "chain", "parts"])
def test_the_decomposition_is_block_upper_triangular_and_keeps_every_incidence(structure: Structure) -> None:
    found = dulmage_mendelsohn(structure)
    figure = draw_decomposition(structure, found)
    shown_rows, shown_columns = rows(figure)[: len(structure.equations)], columns(figure)[: len(structure.unknowns)]
    assert {*shown_rows} == {*structure.equations}
    assert {*shown_columns} == {*structure.unknowns}
    cells = {(shown_rows[int(y)], shown_columns[int(x)]) for x, y in marks(figure, "marks-unknowns")}
    assert cells == {(e, x) for e in structure.equations for x in structure.unknowns_in([e])}
    boxes = [*patches(figure, "component"), *patches(figure, "part-under"), *patches(figure, "class")]
    for box in boxes:
        below = [(x, y) for x, y in marks(figure, "marks-unknowns") if y > box.get_y() + box.get_height()]
        assert not [x for x, _ in below if box.get_x() < x < box.get_x() + box.get_width()]


def test_the_parts_of_a_decomposition_are_outlined_and_named() -> None:
    figure = draw_decomposition(PARTS, dulmage_mendelsohn(PARTS))
    sizes = {
        kind: [(p.get_height(), p.get_width()) for p in patches(figure, f"part-{kind}")]
        for kind in ("under", "just", "over")
    }
    assert sizes == {"under": [(2, 3)], "just": [(4, 4)], "over": [(3, 1)]}
    assert [(p.get_height(), p.get_width()) for p in patches(figure, "component")] == [(2, 2), (2, 2)]
    assert {"M-  2 x 3", "M0  4 x 4", "M+  3 x 1"} <= {*names(figure)}


def test_the_classes_of_the_thesis_model_are_boxes_over_their_own_unknowns() -> None:
    found = dulmage_mendelsohn(UDS4)
    figure = draw_decomposition(UDS4, found)
    sizes = [(p.get_height(), p.get_width()) for p in patches(figure, "class")]
    assert sizes == [(len(c.equations), len(c.unknowns)) for c in found.classes if len(c.equations) > 1]
    assert sorted(sizes) == [(2, 1), (2, 1), (2, 1), (3, 2), (4, 3)]


def test_faults_stand_at_the_rows_of_their_equations() -> None:
    figure = draw_decomposition(PARTS, dulmage_mendelsohn(PARTS))
    shown = rows(figure)
    at = {t.get_text(): shown[int(t.get_position()[1])] for t in figure.axes[0].texts if "f" in t.get_text()}
    assert at == {"f1": "a1", "f2, f3": "b1"}
    assert {shown[int(y)] for _, y in marks(figure, "marks-faults")} == {"a1", "b1"}


def test_isolability_shows_which_pairs_are_mutual_and_which_are_not() -> None:
    relation = isolability_of(UDS4, "integral")
    figure = draw_isolability({"integral": relation})
    order = rows(figure)
    shown = {kind: marks(figure, f"{kind}-integral") for kind in ("mutual", "oneway", "itself")}
    pairs = {kind: {(order[int(y)], order[int(x)]) for x, y in found} for kind, found in shown.items()}
    everything = {(fault, other) for fault, others in relation.items() for other in others}
    assert pairs["mutual"] | pairs["oneway"] == everything
    assert pairs["mutual"] == {(a, b) for a, b in everything if (b, a) in everything}
    assert pairs["itself"] == {(fault, fault) for fault in UDS4.faults}


def test_faults_of_a_class_stand_together_in_every_matrix() -> None:
    """Given apart: a, c and e cannot be told apart with the first relation, a and e with the second."""
    coarse = {"a": ("c", "e"), "b": (), "c": ("a", "e"), "d": (), "e": ("a", "c")}
    fine = {"a": ("e",), "b": (), "c": (), "d": (), "e": ("a",)}
    for relations in ({"x": coarse, "y": fine}, {"y": fine, "x": coarse}):
        figure = draw_isolability(relations)
        assert rows(figure)[:5] == ["a", "e", "c", "b", "d"]
        frames = [p for p in figure.axes[0].patches if isinstance(p, Rectangle)]
        assert sorted(frame.get_width() for frame in frames) == [2, 3]
        assert {"x: 3 classes", "y: 4 classes"} <= {*names(figure)}


def test_the_signature_matrix_keeps_the_order_and_highlights_tests_that_can_be_run() -> None:
    given = TESTS[::-1]
    figure = draw_signatures(given, UDS4.faults)
    assert rows(figure)[: len(given)] == [test.name for test in given]
    shown = np.zeros((len(given), len(UDS4.faults)), dtype=bool)
    for kind, runnable in (("runnable", True), ("other", False)):
        for x, y in marks(figure, f"marks-{kind}"):
            assert isinstance(given[int(y)], Test) == runnable
            shown[int(y), int(x)] = True
    assert (shown == signature_matrix(given, UDS4.faults)).all()


def nodes(figure: Figure) -> set[str]:
    gids = [str(p.get_gid()) for p in figure.axes[0].patches]
    return {gid.removeprefix("node-") for gid in gids if gid.startswith("node-")}


def edges(figure: Figure) -> int:
    return sum(p.get_gid() == "edge" for p in figure.axes[0].patches)


@pytest.mark.parametrize("number", [2, 21])
def test_the_graph_has_a_box_for_every_signal_state_and_step_and_an_arrow_for_every_use(number: int) -> None:
    test = TESTS[number - 1]
    assert isinstance(test, Test)
    figure = draw_graph(UDS4, test)
    assert nodes(figure) == {*test.known, *test.states, *(variable for _, variable in test.sequence), "residual"}
    uses = [len({*UDS4.unknowns_in([e]), *UDS4.known_in([e])} - {v}) for e, v in test.sequence]
    assert edges(figure) == sum(uses) + len(UDS4.unknowns_in([test.residual])) + len(UDS4.known_in([test.residual]))
    assert {equation for equation, _ in test.sequence} <= {*names(figure)}


def test_an_algebraic_loop_is_one_box() -> None:
    figure = draw_graph(LOOP, made_test(LOOP, "sense"))
    assert nodes(figure) == {"u", "y", "x", "a", "dx", "residual"}
    assert {"loop", "a: loop1", "b: loop2", "c: loop3"} <= {*names(figure)}
    assert edges(figure) == 6  # u and x to the loop, the loop and x to dx, x and y to the residual


def test_the_graph_of_a_chain_has_no_crossing() -> None:
    """The best order is known here: along the chain. A poor start used to end in a knot."""
    graph = nx.DiGraph([(a, b) for i in range(25) for a, b in ((f"h{i}", f"q{i}"), (f"h{i + 1}", f"q{i}"))])
    shuffled: nx.DiGraph[str] = nx.DiGraph()
    shuffled.add_nodes_from(sorted(graph))
    shuffled.add_edges_from(graph.edges)
    layer = layers_of(shuffled, set())
    heights, _ = place(shuffled, layer, dict.fromkeys(shuffled, 1.0))
    columns = [sorted((n for n in shuffled if layer[n] == k), key=heights.__getitem__) for k in (0, 1)]
    assert crossings(shuffled, columns) == 0
    for column in columns:
        assert np.diff([heights[n] for n in column]).min() > 1 - 1e-9  # boxes do not touch


def test_no_arrow_runs_through_a_box() -> None:
    """Arrows over several columns have lanes of their own between the boxes."""
    for structure, test in [predicting(25), *((UDS4, t) for t in TESTS if isinstance(t, Test))]:
        [axes] = draw_graph(structure, test).axes
        to_data = axes.transData.inverted()
        boxes = [p for p in axes.patches if str(p.get_gid()).startswith("node-")]
        areas = [box.get_extents().transformed(to_data) for box in boxes]
        for arrow in (p for p in axes.patches if p.get_gid() == "edge"):
            lines = arrow.get_path().to_polygons(closed_only=False)
            x, y = np.concatenate([Path(line).interpolated(16).vertices for line in lines]).T
            for at in areas:
                inside = (at.x0 + 0.03 < x) & (x < at.x1 - 0.03) & (at.y0 + 0.03 < y) & (y < at.y1 - 0.03)
                assert not inside.any()
