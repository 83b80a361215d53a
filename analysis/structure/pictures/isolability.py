"""Isolability matrices side by side, one for every causality."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from faultline.analysis.structure.pictures.grid import Grid, Group, grid
from faultline.analysis.structure.pictures.style import BLUE, GREY, ORANGE, STYLE, box, finish, marker

Relation = Mapping[str, Sequence[str]]
"""For every fault the other faults that it is not isolable from."""


@mpl.rc_context(STYLE)
def draw_isolability(relations: Mapping[str, Relation], name: str = "the model") -> Figure:
    """Faults against faults for every causality of `relations`: the row's fault is not isolable from a marked column's.

    The faults are reordered, the same way everywhere: those that cannot be told apart from each other stand together.
    """
    faults = _order([*relations.values()])
    place = {fault: i for i, fault in enumerate(faults)}
    groups = [
        Group(f"{causality}: {_many(len(set(_classes(relation).values())), 'class', 'classes')}", faults)
        for causality, relation in relations.items()
    ]
    drawn = grid(faults, groups)
    for g, (causality, relation) in enumerate(relations.items()):
        pairs = {(place[fault], place[other]) for fault in faults for other in relation.get(fault, ())}
        mutual = sorted((i, j) for i, j in pairs if (j, i) in pairs)
        drawn.mark([(i, i) for i in range(len(faults))], GREY, f"itself-{causality}", group=g, size=0.3, shape="o")
        drawn.mark(mutual, BLUE, f"mutual-{causality}", group=g, size=0.72)
        drawn.mark(sorted(pairs - {*mutual}), ORANGE, f"oneway-{causality}", group=g, size=0.62, shape="D")
        _outline(drawn, g, [_classes(relation).get(fault, fault) for fault in faults])
    handles: list[Artist] = []
    if faults:
        handles = [
            marker(BLUE, "not isolable, either way"), marker(ORANGE, "row's fault not isolable from column's", "D"),
            marker(GREY, "the fault itself", "o"), box("none", "faults that no test tells apart: a class", BLUE),
        ]  # fmt: skip
    return finish(drawn.figure, f"Isolability of {_many(len(faults), 'fault', 'faults')} of {name}", handles)


def _classes(relation: Relation) -> dict[str, str]:
    """Every fault with the first of those that are not isolable from each other."""
    first: dict[str, str] = {}
    for fault, others in relation.items():
        first.setdefault(fault, fault)
        for other in others:
            if fault in relation.get(other, ()):
                first.setdefault(other, first[fault])
    return first


def _order(relations: Sequence[Relation]) -> tuple[str, ...]:
    """The faults, those of a class together: first by the relation with the fewest classes, then by the next."""
    faults = tuple(dict.fromkeys(fault for relation in relations for fault in relation))
    place = {fault: i for i, fault in enumerate(faults)}
    coarse_first = sorted(map(_classes, relations), key=lambda found: len(set(found.values())))

    def rank(fault: str) -> list[int]:
        return [place[found[fault]] if fault in found else place[fault] for found in coarse_first]

    return tuple(sorted(faults, key=rank))


def _outline(drawn: Grid, group: int, classes: Sequence[str]) -> None:
    """A frame around every class of several faults that stand together."""
    for begin, end in _runs(classes):
        if end - begin > 1:
            corner = (drawn.starts[group] + begin - 0.5, begin - 0.5)
            size = end - begin
            drawn.axes.add_patch(
                Rectangle(corner, size, size, facecolor="none", edgecolor=BLUE, linewidth=1.8, zorder=4, clip_on=False)
            )


def _many(number: int, one: str, several: str) -> str:
    return f"{number} {one if number == 1 else several}"


def _runs(values: Sequence[object]) -> list[tuple[int, int]]:
    """Where equal neighbours begin and end (exclusive)."""
    edges = [0, *(i for i in range(1, len(values)) if values[i] != values[i - 1]), len(values)]
    return [(a, b) for a, b in pairwise(edges) if a < b]
