"""Detectability and isolability under three causal interpretations, against the sets that they are the union of."""

import dataclasses
import json
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.analysis.model import Differential, ModelError, load_model
from faultline.analysis.structure import Structure, mso_sets, over_determined, structure_of
from faultline.analysis.structure.causality import residual_causality
from faultline.analysis.structure.diagnosability import (
    Interpretation,
    OverDeterminedPart,
    detectability,
    isolability_of,
)
from faultline.analysis.structure.sensors import drop_sensors

ORACLE: dict[str, Any] = json.loads((Path(__file__).parent / "uds_oracle.json").read_text())
UDS4 = structure_of(load_model("uds"))
INTERPRETATIONS: tuple[Interpretation, ...] = get_args(Interpretation)
STEADY = settings(derandomize=True, deadline=None, max_examples=150)


def made(
    contents: list[int], unknowns: list[str], differentials: list[tuple[str, str]], faulty: list[int]
) -> Structure:
    """Algebraic equations e0 ... that contain `contents`, constraints d0 ... (state, derivative), faults f0 ..."""
    rows = [*contents, *(1 << unknowns.index(s) | 1 << unknowns.index(d) for s, d in differentials)]
    names = [*(f"e{k}" for k in range(len(contents))), *(f"d{k}" for k in range(len(differentials)))]
    return Structure(
        equations=tuple(names),
        unknowns=tuple(unknowns),
        known=(),
        faults=tuple(f"f{k}" for k in range(len(faulty))),
        unknown_rows=tuple(rows),
        known_rows=(0,) * len(rows),
        fault_rows={f"f{k}": row for k, row in enumerate(faulty)},
        differentials={
            f"d{k}": Differential(name=f"d{k}", state=s, derivative=d) for k, (s, d) in enumerate(differentials)
        },
    )


@st.composite
def structures(draw: st.DrawFn) -> Structure:
    """Up to three states, some of them derivatives of others; equations without unknowns and unused unknowns occur."""
    states = [f"x{i}" for i in range(draw(st.integers(0, 3)))]
    chained = draw(st.booleans())
    derivatives = [states[i + 1] if chained and i == 0 and len(states) > 1 else f"d{s}" for i, s in enumerate(states)]
    algebraic = [f"a{i}" for i in range(draw(st.integers(0 if states else 1, 3)))]
    unknowns = list(dict.fromkeys([*states, *derivatives, *algebraic]))
    row = st.lists(st.integers(0, len(unknowns) - 1), max_size=3).map(lambda chosen: sum(1 << x for x in {*chosen}))
    contents = draw(st.lists(row, min_size=1, max_size=len(unknowns) + 3))
    number = len(contents) + len(states)
    faulty = draw(st.lists(st.integers(0, number - 1), max_size=5))
    return made(contents, unknowns, list(zip(states, derivatives, strict=True)), faulty)


def capable(structure: Structure, mso: tuple[str, ...], causality: Interpretation) -> bool:
    """Whether some choice of the residual equation has this causality, by the causality of every choice.

    A differential constraint as the residual is taken as integral there; here it may be derivative as well: then it is
    an equation like any other and the causality is that of the rest.
    """
    choices = residual_causality(structure, mso)
    if causality != "derivative":
        return causality == "mixed" or any(c in ("integral", "algebraic") for c in choices.values())
    for residual, found in choices.items():
        if residual in structure.differentials:
            others = {name: d for name, d in structure.differentials.items() if name != residual}
            found = residual_causality(dataclasses.replace(structure, differentials=others), mso)[residual]
        if found in ("derivative", "algebraic"):
            return True
    return False


@pytest.mark.parametrize("causality", INTERPRETATIONS)
@STEADY
@given(structure=structures())
def test_the_part_is_the_union_of_the_mso_sets_that_can_be_run_so(
    causality: Interpretation, structure: Structure
) -> None:
    union = {name for mso in mso_sets(structure) if capable(structure, mso, causality) for name in mso}
    assert {*structure.names(OverDeterminedPart(structure, causality).without())} == union
    if causality == "mixed":
        assert {*over_determined(structure)} == union


@pytest.mark.parametrize("causality", INTERPRETATIONS)
@STEADY
@given(structure=structures(), data=st.data())
def test_the_part_of_some_rows_is_that_of_a_structure_without_the_others(
    causality: Interpretation, structure: Structure, data: st.DataObject
) -> None:
    removed = data.draw(st.integers(0, (1 << len(structure.equations)) - 1))
    left = {name for row, name in enumerate(structure.equations) if not removed >> row & 1}
    union = {n for mso in mso_sets(structure) if {*mso} <= left and capable(structure, mso, causality) for n in mso}
    assert {*structure.names(OverDeterminedPart(structure, causality).without(removed))} == union


@pytest.mark.parametrize("causality", INTERPRETATIONS)
@STEADY
@given(structure=structures())
def test_isolability_is_that_of_the_signatures_of_these_mso_sets(
    causality: Interpretation, structure: Structure
) -> None:
    signatures = [{*structure.faults_in(mso)} for mso in mso_sets(structure) if capable(structure, mso, causality)]
    expected = {
        fault: tuple(
            other
            for other in structure.faults
            if other != fault and not any(fault in s and other not in s for s in signatures)
        )
        for fault in structure.faults
    }
    assert isolability_of(structure, causality) == expected
    assert detectability(structure, causality) == tuple(f for f in structure.faults if any(f in s for s in signatures))


@pytest.mark.parametrize(
    ("causality", "figure"), [("mixed", "mixed"), ("derivative", "mixed"), ("integral", "integral")]
)
def test_isolability_of_the_thesis_model_is_that_of_figure_5_5(causality: Interpretation, figure: str) -> None:
    found = isolability_of(UDS4, causality)
    assert {f: set(others) for f, others in found.items()} == {
        f: set(others) for f, others in ORACLE["isolability"][figure].items()
    }
    assert list(found) == list(UDS4.faults)
    assert all(list(others) == [f for f in UDS4.faults if f in others] for others in found.values())
    assert detectability(UDS4, causality) == UDS4.faults


def test_without_the_tank_side_sensor_differentiation_isolates_less_than_mixed_causality() -> None:
    """Found with another tool: with y_p_tp derivative causality does what mixed does, with y_p_ap it does not."""
    only_tp, only_ap = (drop_sensors(UDS4, [signal]) for signal in ("y_p_ap", "y_p_tp"))
    assert isolability_of(only_tp, "derivative") == isolability_of(only_tp, "mixed")
    assert {f: {*others} for f, others in isolability_of(only_ap, "derivative").items()} == {
        "fA_ori": {"fA_dos", "fy_p_du"},
        "fA_dos": {"fA_ori", "fy_p_du"},
        "fA_t": {"fA_p", "fq_pump", "fy_p_du"},
        "fA_p": {"fA_t", "fq_pump", "fy_p_du"},
        "fA_du": {"fy_p_du"},
        "fq_pump": {"fA_t", "fA_p", "fy_p_du"},
        "fy_p_du": set(),
        "fy_p_ap": {"fy_p_du"},
    }


def test_an_equation_without_unknowns_is_a_test_of_every_causality() -> None:
    """Regression against the peer tool, which drops consistency checks of known signals."""
    structure = made([0, 0b01], ["x", "dx"], [("x", "dx")], [0, 1])
    for causality in INTERPRETATIONS:
        assert detectability(structure, causality) == ("f0",)
        assert isolability_of(structure, causality) == {"f0": (), "f1": ("f0",)}


def test_a_state_measured_with_its_derivative_can_be_tested_either_way() -> None:
    structure = made([0b01, 0b10], ["x", "dx"], [("x", "dx")], [0, 1, 2])
    for causality in INTERPRETATIONS:
        assert detectability(structure, causality) == ("f0", "f1", "f2")


def test_an_unknown_input_needs_derivative_causality() -> None:
    """x0 and x1 are measured and have the same unknown rate a: only their derivatives can be compared."""
    unknowns, constraints = ["x0", "x1", "dx0", "dx1", "a"], [("x0", "dx0"), ("x1", "dx1")]
    structure = made([0b00001, 0b00010, 0b10100, 0b11000], unknowns, constraints, [0, 2])
    assert [detectability(structure, c) for c in INTERPRETATIONS] == [("f0", "f1"), (), ("f0", "f1")]


def test_states_measured_only_together_need_integral_causality() -> None:
    """The rates of x0 and x1 are known, and a sensor sees their sum: neither can be differentiated."""
    structure = made([0b0011, 0b0100, 0b1000], ["x0", "x1", "dx0", "dx1"], [("x0", "dx0"), ("x1", "dx1")], [0, 1])
    assert [detectability(structure, c) for c in INTERPRETATIONS] == [("f0", "f1"), ("f0", "f1"), ()]


def test_an_unknown_causality_is_refused() -> None:
    with pytest.raises(ModelError, match=r"^int: no causality; those are mixed, integral, derivative$"):
        detectability(UDS4, "int")  # type: ignore[arg-type]
