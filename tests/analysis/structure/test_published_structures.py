"""Textbook structures whose numbers of MSO sets and tests are published."""

import pytest

from analysis.model import parse_model
from analysis.structure import find_tests, integral_tests, mso_sets, mtes_sets, structure_of

SIGNAL = 'unit = "1"\nmin = 0.0\nmax = 1.0\nnoise = 0.1\n'


def source(known: list[str], unknown: list[str], states: list[str], equations: list[tuple[str, str | None]]) -> str:
    """A model file: equations (expression, name that a fault is added to); d<state> are added to the unknowns."""
    lines = ["schema = 1", 'name = "published"']
    lines += [f"[known.{name}]\n{SIGNAL}" for name in known]
    for name in [*unknown, *states, *(f"d{state}" for state in states)]:
        lines.append(f'[unknown.{name}]\nunit = "1"' + ("\ninitial = ['0']" if name in states else ""))
    for k, (expr, faulty) in enumerate(equations, start=1):
        lines.append(f'[[equation]]\nname = "e{k}"\nexpr = "{expr}"')
        if faulty is not None:
            enters = f"{faulty} -> {faulty} + f{k}"
            lines.append(f'[equation.fault]\nname = "f{k}"\ncomponent = "c"\nenters = "{enters}"\nsizes = [1.0]')
    for k, state in enumerate(states, start=len(equations) + 1):
        lines.append(f'[[differential]]\nname = "e{k}"\nstate = "{state}"\nderivative = "d{state}"')
    return "\n".join(lines)


def tank_chain(tanks: int) -> str:
    """A chain of tanks: inflow and all levels measured; valves, tanks and level sensors may fail."""
    p, q = [f"p{i}" for i in range(1, tanks + 1)], [f"q{i}" for i in range(tanks + 1)]
    equations: list[tuple[str, str | None]] = [
        (f"q{i} - (p{i} - p{i + 1})" if i < tanks else f"q{i} - p{i}", f"q{i}") for i in range(1, tanks + 1)
    ]
    equations += [(f"dp{i} - (q{i - 1} - q{i})", f"dp{i}") for i in range(1, tanks + 1)]
    equations += [(f"y{i} - p{i}", f"p{i}") for i in range(1, tanks + 1)]
    equations += [("y0 - q0", None)]
    return source([f"y{i}" for i in range(tanks + 1)], q, p, equations)


def test_the_three_tank_example_has_6_mso_sets_and_4_tests() -> None:
    """Frisk, Krysander and Jung: A toolbox for analysis and design of model based diagnosis systems (IFAC 2017)."""
    equations: list[tuple[str, str | None]] = [
        ("q1 - (p1 - p2)", "q1"),
        ("q2 - (p2 - p3)", "q2"),
        ("q3 - p3", "q3"),
        ("dp1 - (q0 - q1)", "dp1"),
        ("dp2 - (q1 - q2)", "dp2"),
        ("dp3 - (q2 - q3)", "dp3"),
        ("y1 - p1", None),
        ("y2 - q2", None),
        ("y3 - q0", None),
    ]
    text = source(["y1", "y2", "y3"], ["q0", "q1", "q2", "q3"], ["p1", "p2", "p3"], equations)
    structure = structure_of(parse_model(text, "three_tank"))
    assert len(structure.equations) == 12
    assert len(structure.unknowns) == 10
    assert len(mso_sets(structure)) == 6
    assert len(mtes_sets(structure)) == 4


@pytest.mark.parametrize(("tanks", "sets", "integral"), [(3, 18, 10), (4, 58, 20), (5, 179, 35)])
def test_tank_chains_have_as_many_tests_as_the_peer_finds(tanks: int, sets: int, integral: int) -> None:
    model = parse_model(tank_chain(tanks), "tanks")
    assert len(mso_sets(structure_of(model))) == sets
    assert len(find_tests(model)) == sets
    assert len(integral_tests(model)) == integral
