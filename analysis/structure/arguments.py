"""The arguments of a test's state and output functions, by backtracking its computational graph (thesis 3.3).

A test computes dx/dt = g(x, u) and y = h(x, u). Which states x and signals u each of these functions really depends on
gives the layout of a grey-box network.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from faultline.analysis.model import Model
from faultline.analysis.structure.structure import Structure, structure_of
from faultline.analysis.structure.supports import Test


@dataclass(frozen=True)
class Arguments:
    """What a function depends on: states and known signals, in the model's order."""

    states: tuple[str, ...]
    known: tuple[str, ...]


@dataclass(frozen=True)
class Computation:
    """The arguments of g for every state's derivative, and of h for the predicted signal."""

    rates: Mapping[str, Arguments]
    output: Arguments


def arguments(model: Model | Structure, test: Test) -> Computation:
    """The arguments of every function of a test of this model."""
    structure = structure_of(model)
    reach: dict[str, frozenset[str]] = {state: frozenset([state]) for state in test.states}
    reach |= {signal: frozenset([signal]) for signal in test.known}

    def reached(equation: str, without: str) -> frozenset[str]:
        inside = {*structure.unknowns_in([equation]), *structure.known_in([equation])} - {without}
        return frozenset().union(*(reach[name] for name in inside))

    for equation, variable in test.sequence:
        reach[variable] = reached(equation, variable)

    def sorted_out(names: frozenset[str]) -> Arguments:
        return Arguments(
            tuple(name for name in test.states if name in names), tuple(name for name in test.known if name in names)
        )

    constraints = structure.differentials.values()
    rates = {d.state: sorted_out(reach[d.derivative]) for d in constraints if d.state in test.states}
    return Computation(rates, sorted_out(reached(test.residual, test.predicts)))
