"""A tank chain of any length as a structure, for pictures of small and large models, and a test of it."""

from faultline.analysis.model import Differential
from faultline.analysis.structure import Structure, Test
from faultline.analysis.structure.causality import solving_order
from faultline.analysis.structure.sensors import drop_sensors


def tank_chain(tanks: int) -> Structure:
    """Per tank its volume balance, outflow, differential constraint and level sensor; the inflow is known.

    Faults: a leak in the balance, a clogged valve and a biased sensor of every tank.
    """
    contents: list[tuple[str, list[str], list[str], str | None]] = []  # equation, unknowns, known signals, fault
    for i in range(1, tanks + 1):
        inflow, known = ([f"q{i - 1}"], []) if i > 1 else ([], ["q_in"])
        contents += [
            (f"balance{i}", [f"dh{i}", *inflow, f"q{i}"], known, f"f_leak{i}"),
            (f"flow{i}", [f"q{i}", f"h{i}", *([f"h{i + 1}"] if i < tanks else [])], [], f"f_clog{i}"),
            (f"d_h{i}", [f"h{i}", f"dh{i}"], [], None),
            (f"sensor{i}", [f"h{i}"], [f"y{i}"], f"f_y{i}"),
        ]
    unknowns = [f"{kind}{i}" for i in range(1, tanks + 1) for kind in ("h", "dh", "q")]
    known = ["q_in", *(f"y{i}" for i in range(1, tanks + 1))]
    names = [name for name, *_ in contents]
    faults = {fault: row for row, (*_, fault) in enumerate(contents) if fault is not None}
    return Structure(
        equations=tuple(names),
        unknowns=tuple(unknowns),
        known=tuple(known),
        faults=tuple(faults),
        unknown_rows=tuple(sum(1 << unknowns.index(x) for x in inside) for _, inside, _, _ in contents),
        known_rows=tuple(sum(1 << known.index(z) for z in signals) for _, _, signals, _ in contents),
        fault_rows=faults,
        differentials={
            f"d_h{i}": Differential(name=f"d_h{i}", state=f"h{i}", derivative=f"dh{i}") for i in range(1, tanks + 1)
        },
    )


def predicting(tanks: int) -> tuple[Structure, Test]:
    """The chain with the last level sensor only, and the test that predicts it."""
    structure = drop_sensors(tank_chain(tanks), [f"y{i}" for i in range(1, tanks)])
    return structure, made_test(structure, f"sensor{tanks}")


def made_test(structure: Structure, residual: str) -> Test:
    """The test of all equations of a structure with this sensor's equation as residual; loops are permitted."""
    order = solving_order(structure, structure.equations, residual)
    return Test(
        number=1,
        name="t01",
        equations=structure.equations,
        faults=structure.faults,
        known=structure.known,
        states=structure.states_in(structure.equations),
        obstacle=None,
        residual=residual,
        predicts=structure.known_in([residual])[0],
        sequence=tuple(pair for component in order for pair in component),
    )
