"""The computational graph of a test as a picture: from known signals and states to derivatives and the residual.

An arrow goes from a variable to what is computed with it (thesis 3.3). Equations that must be solved together are an
algebraic loop, drawn as one box.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import matplotlib as mpl
import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path

from faultline.analysis.structure.pictures.layers import layers_of, place
from faultline.analysis.structure.pictures.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    POINTS_PER_INCH,
    PURPLE,
    STYLE,
    VERMILION,
    blank,
    box,
    finish,
    text_width,
    tint,
)
from faultline.analysis.structure.structure import Structure
from faultline.analysis.structure.supports import Test

Kind = Literal["known", "state", "variable", "loop", "derivative", "residual"]
KINDS: dict[Kind, tuple[str, str]] = {
    "known": (GREEN, "known signal"),
    "state": (BLUE, "state, the integral of its derivative"),
    "variable": (GREY, "variable, and the equation that gives it"),
    "loop": (PURPLE, "algebraic loop, solved together"),
    "derivative": (ORANGE, "derivative of a state"),
    "residual": (VERMILION, "residual: its equation and the signal it predicts"),
}
POINTS, SMALL_POINTS = 10.0, 8.0
INSIDE, BETWEEN, APART = 0.09, 0.13, 0.75  # padding of a box, space below it and between columns [in]


@dataclass(frozen=True)
class _Node:
    kind: Kind
    lines: tuple[str, ...]
    """The first is bold."""

    @property
    def width(self) -> float:
        bold, *rest = self.lines
        return max(text_width(bold, POINTS, bold=True), *(text_width(t, SMALL_POINTS) for t in rest), 0.4) + 2 * INSIDE

    @property
    def height(self) -> float:
        return 1.25 * (POINTS + SMALL_POINTS * (len(self.lines) - 1)) / POINTS_PER_INCH + 1.5 * INSIDE


@mpl.rc_context(STYLE)
def draw_graph(structure: Structure, test: Test, name: str = "the model") -> Figure:
    """How a test of this structure is computed; `name` is the model's in the title."""
    graph, nodes = _graph(structure, test)
    last = {n for n in graph if nodes[n].kind in ("derivative", "residual") and not graph.out_degree(n)}
    layer = layers_of(graph, last)
    heights, routes = place(graph, layer, {n: node.height + BETWEEN for n, node in nodes.items()})
    columns = range(max(layer.values()) + 1)
    widths = [max(nodes[n].width for n in graph if layer[n] == k) for k in columns]
    left = [sum(widths[:k]) + APART * k for k in columns]
    low = min(heights[n] - nodes[n].height / 2 for n in graph)
    high = max(heights[n] + nodes[n].height / 2 for n in graph)
    figure, axes = blank(left[-1] + widths[-1], high - low)
    axes.set_xlim(0, left[-1] + widths[-1])
    axes.set_ylim(low, high)
    axes.set_axis_off()
    for (a, b), ys in routes.items():
        inner = range(layer[a] + 1, layer[b])
        begin = left[layer[a]] + (widths[layer[a]] + nodes[a].width) / 2
        end = left[layer[b]] + (widths[layer[b]] - nodes[b].width) / 2
        _arrow(axes, begin, [(left[k], left[k] + widths[k]) for k in inner], end, ys, KINDS[nodes[a].kind][0])
    for n, node in nodes.items():
        _box(axes, n, node, left[layer[n]] + widths[layer[n]] / 2, heights[n])
    shown = [kind for kind in KINDS if any(node.kind == kind for node in nodes.values())]
    handles = [box(tint(KINDS[kind][0], 0.25), KINDS[kind][1], KINDS[kind][0]) for kind in shown]
    return finish(figure, f"Computational graph of test {test.name} of {name}: predicts {test.predicts}", handles)


def _graph(structure: Structure, test: Test) -> "tuple[nx.DiGraph[str], Mapping[str, _Node]]":
    """The graph of boxes; a box is named by its first variable, the residual by an empty name."""
    integrated = {structure.differentials[e].state: e for e in test.equations if e in structure.differentials}
    rates = {structure.differentials[e].derivative: e for e in integrated.values()}
    given = {e for e, variable in test.sequence if integrated.get(variable) == e}  # an integration is no step
    steps = [(e, variable) for e, variable in test.sequence if e not in given]
    computed = {variable: e for e, variable in steps}

    def used(equation: str, variable: str) -> list[str]:
        inside = [*structure.known_in([equation]), *structure.unknowns_in([equation])]
        return [x for x in inside if x != variable]

    single: nx.DiGraph[str] = nx.DiGraph()
    single.add_nodes_from([*test.known, *(s for s in test.states if s not in computed)])
    for equation, variable in steps:
        single.add_node(variable)
        single.add_edges_from((x, variable) for x in used(equation, variable))
    single.add_edges_from((x, "") for x in used(test.residual, ""))

    nodes: dict[str, _Node] = {}
    owner: dict[str, str] = {}
    for members in sorted(nx.strongly_connected_components(single), key=lambda m: min(map([*single].index, m))):
        variables = sorted(members, key=[*single].index)
        owner |= dict.fromkeys(variables, variables[0])
        nodes[variables[0]] = _node(structure, test, variables, computed, integrated, rates)
    graph: nx.DiGraph[str] = nx.DiGraph()
    graph.add_nodes_from(n for n in single if owner[n] == n)
    graph.add_edges_from((owner[a], owner[b]) for a, b in single.edges if owner[a] != owner[b])
    return graph, nodes


def _node(
    structure: Structure, test: Test, variables: list[str], computed: Mapping[str, str],
    integrated: Mapping[str, str], rates: Mapping[str, str],
) -> _Node:  # fmt: skip
    [variable, *more] = variables
    if more:
        return _Node("loop", ("loop", *(f"{v}: {computed[v]}" for v in variables)))
    if variable == "":
        return _Node("residual", ("residual", f"{test.residual}: {test.predicts}"))
    if variable in test.known:
        return _Node("known", (variable,))
    if variable not in computed:
        constraint = integrated[variable]
        return _Node("state", (variable, f"{constraint}: ∫ {structure.differentials[constraint].derivative}"))
    return _Node("derivative" if variable in rates else "variable", (variable, computed[variable]))


def _box(axes: Axes, name: str, node: _Node, x: float, y: float) -> None:
    colour = KINDS[node.kind][0]
    corner = (x - node.width / 2, y - node.height / 2)
    axes.add_patch(
        FancyBboxPatch(
            corner, node.width, node.height, boxstyle="round,pad=0,rounding_size=0.05", facecolor=tint(colour, 0.25),
            edgecolor=colour, linewidth=1.2, zorder=3, clip_on=False, gid=f"node-{name or 'residual'}",
        )
    )  # fmt: skip
    top = y + 1.25 * (POINTS + SMALL_POINTS * (len(node.lines) - 1)) / POINTS_PER_INCH / 2
    for k, line in enumerate(node.lines):
        size = SMALL_POINTS if k else POINTS
        top -= 1.25 * size / POINTS_PER_INCH
        axes.text(
            x, top + 0.25 * size / POINTS_PER_INCH, line, ha="center", fontsize=size, color=INK, zorder=4,
            fontweight="normal" if k else "bold",
        )  # fmt: skip


def _arrow(
    axes: Axes, begin: float, lanes: list[tuple[float, float]], end: float, ys: list[float], colour: str
) -> None:
    """An arrow that bends between the columns only, and runs straight through its lanes."""
    points, codes = [(begin, ys[0])], [Path.MOVETO]
    for k, (entry, leave) in enumerate([*lanes, (end, end)], start=1):
        x, y = points[-1]
        half = (x + entry) / 2
        points += [(half, y), (half, ys[k]), (entry, ys[k])]
        codes += [Path.CURVE4] * 3
        if leave > entry:
            points.append((leave, ys[k]))
            codes.append(Path.LINETO)
    axes.add_patch(
        FancyArrowPatch(
            path=Path(np.array(points), codes), arrowstyle="-|>,head_length=4,head_width=2", color=colour,
            linewidth=1.1, shrinkA=0, shrinkB=0, zorder=2, clip_on=False, gid="edge",
        )
    )  # fmt: skip
