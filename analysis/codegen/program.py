"""A residual generator as a straight-line program: what the Python and the C99 code are both written from."""

from collections.abc import Sequence
from dataclasses import dataclass

from faultline.analysis.codegen.identifiers import words_in


@dataclass(frozen=True)
class Line:
    """`target` = `text`; the `note` says which equation that is."""

    target: str
    text: str
    note: str = ""


@dataclass(frozen=True)
class Constant:
    """A parameter of the model."""

    name: str
    value: float
    note: str


@dataclass(frozen=True)
class Input:
    """A known signal: its identifier, and its name in the model."""

    name: str
    signal: str
    note: str


@dataclass(frozen=True)
class State:
    """What is carried from step to step, NaN where it is not known; `next` is the local that it becomes."""

    name: str
    next: str
    note: str


@dataclass(frozen=True, kw_only=True)
class Program:
    """One step: `lines` in order, then `residual` is the result and every state becomes its `next`.

    Texts are valid in Python and C99. A local may be assigned again.
    """

    name: str
    notes: tuple[str, ...]
    unit: str
    inputs: tuple[Input, ...]
    constants: tuple[Constant, ...]
    states: tuple[State, ...]
    lines: tuple[Line, ...]
    residual: str


def alive(lines: Sequence[Line], wanted: Sequence[str]) -> list[Line]:
    """The lines that the wanted texts depend on, whichever assignment of a local it is."""
    live: set[str] = set().union(*map(words_in, wanted))
    size = -1
    while size != len(live):
        size = len(live)
        for line in reversed(lines):
            if line.target in live:
                live |= words_in(line.text)
    return [line for line in lines if line.target in live]
