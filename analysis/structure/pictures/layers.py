"""A directed acyclic graph in layers from left to right, its edges routed between the nodes.

The method of Sugiyama, Tagawa and Toda (1981): longest-path layers; an edge over several layers gets a lane of its own
in each of them; barycentres order the layers so that few edges cross; least squares place the nodes of a layer in that
order, close to their neighbours.
"""

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from itertools import pairwise
from typing import Any

import networkx as nx
import numpy as np
from scipy.optimize import isotonic_regression
from scipy.sparse.csgraph import reverse_cuthill_mckee

SWEEPS = 24
LANE = 0.16  # height of a lane [in]
STIFFNESS = 6.0  # how much more a lane resists a bend than a node


def layers_of(graph: "nx.DiGraph[str]", last: AbstractSet[str]) -> dict[str, int]:
    """The layer of every node: behind all it uses; `last`, which nothing may use, in the last layer."""
    layer: dict[str, int] = {}
    for node in nx.topological_sort(graph):
        layer[node] = max((layer[before] + 1 for before in graph.predecessors(node)), default=0)
    end = max(layer.values(), default=0)
    return {node: end if node in last else found for node, found in layer.items()}


def place(
    graph: "nx.DiGraph[str]", layer: Mapping[str, int], height: Mapping[str, float]
) -> tuple[dict[str, float], dict[tuple[str, str], list[float]]]:
    """Where nodes and edges are from bottom to top [in]: of a node its centre, of an edge one place a layer."""
    routed: nx.DiGraph[Any] = nx.DiGraph()  # a lane is named (from, to, layer)
    routed.add_nodes_from(graph)
    paths = {}
    for a, b in graph.edges:
        paths[a, b] = [a, *((a, b, k) for k in range(layer[a] + 1, layer[b])), b]
        routed.add_edges_from(pairwise(paths[a, b]))
    starts = []
    for line in (_in_line(routed), list(routed)):
        columns: list[list[Any]] = [[] for _ in range(max(layer.values(), default=-1) + 1)]
        for node in line:
            columns[node[2] if isinstance(node, tuple) else layer[node]].append(node)
        starts.append(_ordered(routed, columns))
    columns = min(starts, key=lambda found: crossings(routed, found))
    at = _placed(routed, columns, {node: height.get(node, LANE) for node in routed})
    return {node: at[node] for node in graph}, {edge: [at[node] for node in path] for edge, path in paths.items()}


def crossings(graph: "nx.DiGraph[Any]", columns: Sequence[Sequence[Any]]) -> int:
    """How many pairs of edges between neighbouring layers cross."""
    total = 0
    for left, right in pairwise(columns):
        rank = {node: k for k, node in enumerate(right)}
        ends = [sorted(rank[b] for b in graph.successors(node)) for node in left]
        flat = np.array([k for group in ends for k in group])
        total += sum(int(np.sum(flat[:i] > flat[i])) for i in range(1, len(flat)))
    return total


def _in_line(graph: "nx.DiGraph[Any]") -> list[Any]:
    """The nodes in an order with neighbours close together (Cuthill and McKee 1969): a good order to begin with."""
    nodes = list(graph)
    if not nodes:
        return []
    adjacent = nx.to_scipy_sparse_array(graph.to_undirected(), nodes, format="csr")
    return [nodes[i] for i in reverse_cuthill_mckee(adjacent, symmetric_mode=True)]


def _ordered(graph: "nx.DiGraph[Any]", columns: list[list[Any]]) -> list[list[Any]]:
    """The layers in the order with the fewest crossings among those that the sweeps find."""
    best, fewest = columns, crossings(graph, columns)
    for sweep in range(SWEEPS):
        columns = _sweep(graph, columns, forwards=sweep % 2 == 0)
        found = crossings(graph, columns)
        if found < fewest:
            best, fewest = columns, found
    return best


def _sweep(graph: "nx.DiGraph[Any]", columns: list[list[Any]], *, forwards: bool) -> list[list[Any]]:
    """Every layer but the first sorted by the mean rank of its neighbours in the layer before."""
    neighbours = graph.predecessors if forwards else graph.successors
    fresh = [list(column) for column in columns]
    for k in range(1, len(fresh)) if forwards else range(len(fresh) - 2, -1, -1):
        rank = {node: i for i, node in enumerate(fresh[k - 1 if forwards else k + 1])}
        centre = {}
        for i, node in enumerate(fresh[k]):
            around = [rank[other] for other in neighbours(node)]
            centre[node] = sum(around) / len(around) if around else i * len(rank) / len(fresh[k])
        fresh[k].sort(key=centre.__getitem__)
    return fresh


def _placed(
    graph: "nx.DiGraph[Any]", columns: Sequence[Sequence[Any]], height: Mapping[Any, float]
) -> dict[Any, float]:
    """Every node near the mean of its neighbours, in the order of its layer and without touching the next."""
    offsets = []
    for column in columns:
        steps = [(height[a] + height[b]) / 2 for a, b in pairwise(column)]
        offsets.append(np.concatenate([[0.0], np.cumsum(steps)]) if column else np.zeros(0))
    at = {
        node: float(y - offset[-1] / 2)
        for column, offset in zip(columns, offsets, strict=True)
        for node, y in zip(column, offset, strict=True)
    }
    for sweep in range(SWEEPS):
        order = range(len(columns)) if sweep % 2 == 0 else range(len(columns) - 1, -1, -1)
        for k in order:
            column = columns[k]
            around = [[at[x] for x in (*graph.predecessors(n), *graph.successors(n))] for n in column]
            wanted = [sum(ys) / len(ys) if ys else at[n] for n, ys in zip(column, around, strict=True)]
            weights = [STIFFNESS if isinstance(n, tuple) else 1.0 for n in column]
            if column:
                fitted = isotonic_regression(np.array(wanted) - offsets[k], weights=weights).x + offsets[k]
                at.update(zip(column, map(float, fitted), strict=True))
    return at
