"""Every picture, of a small, a large and an empty model: written, the same bytes again, complete and legible."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest
from looked_at import cut_off, overlapping, texts
from made_chain import predicting, tank_chain
from matplotlib.figure import Figure

from faultline.analysis.model import load_model
from faultline.analysis.structure import Structure, Test, find_tests, structure_of
from faultline.analysis.structure.decomposition import dulmage_mendelsohn
from faultline.analysis.structure.diagnosability import Interpretation, isolability_of
from faultline.analysis.structure.pictures import (
    draw_decomposition,
    draw_graph,
    draw_isolability,
    draw_model,
    draw_signatures,
    save,
)

UDS4, CHAIN = structure_of(load_model("uds")), tank_chain(25)
TESTS = {test.name: test for test in find_tests(load_model("uds"))}
EMPTY = Structure((), (), (), (), (), (), {}, {})
BARE = Structure(("e1", "e2"), ("x", "unused"), (), (), (1, 1), (0, 0), {}, {})
CAUSALITIES: tuple[Interpretation, ...] = ("mixed", "integral", "derivative")


def graph(name: str) -> Figure:
    test = TESTS[name]
    assert isinstance(test, Test)
    return draw_graph(UDS4, test, "uds")


def relations(structure: Structure) -> dict[str, dict[str, tuple[str, ...]]]:
    return {causality: isolability_of(structure, causality) for causality in CAUSALITIES}


PICTURES: dict[str, Callable[[], Figure]] = {
    "model-uds": lambda: draw_model(UDS4, "uds"),
    "model-100": lambda: draw_model(CHAIN),
    "model-bare": lambda: draw_model(BARE),
    "model-empty": lambda: draw_model(EMPTY),
    "decomposition-uds": lambda: draw_decomposition(UDS4, dulmage_mendelsohn(UDS4), "uds"),
    "decomposition-100": lambda: draw_decomposition(CHAIN, dulmage_mendelsohn(CHAIN)),
    "decomposition-bare": lambda: draw_decomposition(BARE, dulmage_mendelsohn(BARE)),
    "decomposition-empty": lambda: draw_decomposition(EMPTY, dulmage_mendelsohn(EMPTY)),
    "isolability-uds": lambda: draw_isolability(relations(UDS4), "uds"),
    "isolability-75-faults": lambda: draw_isolability(relations(CHAIN)),
    "isolability-empty": lambda: draw_isolability(relations(EMPTY)),
    "isolability-nothing": lambda: draw_isolability({}),
    "signatures-uds": lambda: draw_signatures([*TESTS.values()], UDS4.faults, "uds"),
    "signatures-empty": lambda: draw_signatures([], ()),
    "graph-t02": lambda: graph("t02"),
    "graph-t21": lambda: graph("t21"),
    "graph-76": lambda: draw_graph(*predicting(25)),
}


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_legible_and_written_with_all_its_text(name: str, tmp_path: Path) -> None:
    figure = PICTURES[name]()
    seen = texts(figure)
    assert overlapping(seen) == []
    assert cut_off(seen, figure) == []
    svg, png = save(figure, tmp_path / "new" / "folder", name)
    assert [svg.name, png.name] == [f"{name}.svg", f"{name}.png"]
    assert png.read_bytes().startswith(b"\x89PNG\r\n")
    root = ET.fromstring(svg.read_text())  # noqa: S314 - our own file
    written = {"".join(element.itertext()).strip() for element in root.iter("{http://www.w3.org/2000/svg}text")}
    assert written == {line for text, _ in seen for line in text.split("\n")}


SMALL = ["model-uds", "decomposition-uds", "isolability-uds", "signatures-uds", "graph-t21"]


@pytest.mark.parametrize("name", SMALL)
def test_the_same_picture_has_the_same_bytes(name: str, tmp_path: Path) -> None:
    first, again = (save(PICTURES[name](), tmp_path / folder, name) for folder in ("first", "again"))
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in again]


def test_the_bytes_do_not_depend_on_the_hash_seed_of_the_process(tmp_path: Path) -> None:
    """networkx returns sets in places: the order of the nodes must not come from them."""
    program = (
        "import sys; from pathlib import Path; from faultline.analysis.model import load_model; "
        "from faultline.analysis.structure import integral_tests, structure_of; "
        "from faultline.analysis.structure.pictures import draw_graph, save; m = load_model('uds'); "
        "save(draw_graph(structure_of(m), integral_tests(m)[-1], 'uds'), Path(sys.argv[1]), 'graph')"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "1"}  # here it is a random one
    root = Path(__file__).resolve().parents[4]
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "there")], check=True, env=environment, cwd=root)
    for path in save(graph("t21"), tmp_path / "here", "graph"):
        assert path.read_bytes() == (tmp_path / "there" / path.name).read_bytes()
