"""Sensors come and go by name, and the rest of the structure stays."""

import json
from pathlib import Path
from typing import Any

import pytest

from faultline.analysis.model import Differential, ModelError, load_model
from faultline.analysis.structure import Structure, mso_sets, mtes_sets, structure_of
from faultline.analysis.structure.diagnosability import isolability_of
from faultline.analysis.structure.sensors import add_sensors, drop_sensors, sensor_equations

ORACLE: dict[str, Any] = json.loads((Path(__file__).parent / "uds_oracle.json").read_text())
UDS4 = structure_of(load_model("uds"))
BARE = drop_sensors(UDS4, ["y_p_tp", "y_p_ap"])


def contents(structure: Structure) -> dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]]:
    """For every equation its unknowns, known signals and faults."""
    return {
        e: (structure.unknowns_in([e]), structure.known_in([e]), structure.faults_in([e])) for e in structure.equations
    }


def test_a_sensor_is_an_equation_with_its_own_signal() -> None:
    found = add_sensors(BARE, ["p_tp", "q_dos"])
    assert found.equations == (*BARE.equations, "y_p_tp", "y_q_dos")
    assert found.known == (*BARE.known, "y_p_tp", "y_q_dos")
    assert found.faults == BARE.faults
    assert contents(found) == contents(BARE) | {
        "y_p_tp": (("p_tp",), ("y_p_tp",), ()),
        "y_q_dos": (("q_dos",), ("y_q_dos",), ()),
    }


def test_a_faulty_sensor_has_a_fault_of_its_own() -> None:
    found = add_sensors(BARE, ["p_tp"], faulty=True)
    assert found.faults == (*BARE.faults, "fy_p_tp")
    assert found.faults_in(["y_p_tp"]) == ("fy_p_tp",)


def test_a_name_that_is_taken_gets_a_number() -> None:
    found = add_sensors(UDS4, ["p_du", "p_bp", "p_bp"], faulty=True)
    assert found.equations[-3:] == ("y_p_du_2", "y_p_bp", "y_p_bp_2")
    assert found.faults[-3:] == ("fy_p_du_2", "fy_p_bp", "fy_p_bp_2")
    assert len({*found.equations}) == len(found.equations)


@pytest.mark.parametrize(
    ("dropped", "left"),
    [
        (["y_p_tp", "y_p_ap"], "y_p_du"),
        (["y_p_ap"], "y_p_du,y_p_tp"),
        (["y_p_tp"], "y_p_du,y_p_ap"),
    ],
)
def test_fewer_sensors_give_what_the_oracle_says(dropped: list[str], left: str) -> None:
    expected = ORACLE["sensor_sets"][left]
    found = drop_sensors(UDS4, dropped)
    assert [list(s) for s in mso_sets(found)] == expected["mso"]
    assert [list(s) for s in mtes_sets(found)] == expected["mtes"]
    mixed = {f: set(others) for f, others in isolability_of(found, "mixed").items()}
    assert mixed == {f: set(others) for f, others in expected["isolability"]["mixed"].items()}
    integral = {f: set(others) for f, others in isolability_of(found, "integral").items()}
    assert integral == {f: set(others) for f, others in expected["isolability"]["integral"].items()}


def test_dropping_takes_equation_signal_and_fault_and_nothing_else() -> None:
    assert set(UDS4.equations) - set(BARE.equations) == {"e17", "e18"}
    assert set(UDS4.known) - set(BARE.known) == {"y_p_tp", "y_p_ap"}
    assert set(UDS4.faults) - set(BARE.faults) == {"fy_p_tp", "fy_p_ap"}
    assert contents(BARE) == {e: c for e, c in contents(UDS4).items() if e in BARE.equations}


def test_what_is_added_can_be_dropped_again() -> None:
    added = add_sensors(BARE, ["p_bp", "q_ori"], faulty=True)
    assert drop_sensors(added, ["y_p_bp", "y_q_ori"]) == BARE


def test_a_signal_that_other_equations_contain_stays() -> None:
    structure = Structure(
        equations=("sensor", "law"),
        unknowns=("a", "b"),
        known=("y", "u"),
        faults=("f", "g"),
        unknown_rows=(0b01, 0b11),
        known_rows=(0b01, 0b11),
        fault_rows={"f": 1, "g": 0},
        differentials={},
    )
    found = drop_sensors(structure, ["y"])
    assert contents(found) == {"law": (("a", "b"), ("y", "u"), ("f",))}
    assert found.known == ("y", "u")


def test_a_differential_constraint_is_no_sensor() -> None:
    structure = Structure(
        equations=("d",),
        unknowns=("x", "dx"),
        known=(),
        faults=(),
        unknown_rows=(0b11,),
        known_rows=(0,),
        fault_rows={},
        differentials={"d": Differential(name="d", state="x", derivative="dx")},
    )
    assert sensor_equations(structure) == {}
    assert set(sensor_equations(UDS4).values()) == {"y_p_du", "y_p_tp", "y_p_ap"}


def test_an_unknown_name_is_refused_with_those_there_are() -> None:
    with pytest.raises(ModelError, match=r"^p_xx: no unknown, so no sensor can measure it; those are .*p_tp"):
        add_sensors(BARE, ["p_tp", "p_xx"])
    with pytest.raises(
        ModelError, match=r"^n_p: no known signal with a sensor equation; those are y_p_du, y_p_tp, y_p_ap$"
    ):
        drop_sensors(UDS4, ["n_p"])
