"""Faults of a family's plant, from an onset on: those of `faultline.testbench.faults` that its structure has."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from faultline.testbench.errors import RigError
from faultline.testbench.families.circuit import Circuit
from faultline.testbench.faults import Fault
from faultline.testbench.units import ML

LOSES = {"fA_t": "k_t", "fA_p": "k_p", "fA_du": "k_f", "fA_ori": "k_o", "fA_dos": "k_v", "fq_pump": "displacement"}
"""What of the circuit each fault takes a part of: turbulent flow goes with the area."""
ADDS = {"fy_p_tp": "y_p_tp", "fy_p_ap": "y_p_ap", "fy_p_du": "y_p_du"}
"""The sensor whose reading each fault adds to."""
LEAK = "leak_ap"


def check(faults: Sequence[Fault]) -> None:
    """Check that the families have these faults.

    Raises:
        RigError: one is not of them.
    """
    for fault in faults:
        if fault.name not in {*LOSES, *ADDS, LEAK}:
            raise RigError(f"{fault.name}: plants of the families have {', '.join([*LOSES, *ADDS, LEAK])}")


def circuit_at(circuit: Circuit, faults: Sequence[Fault], t: float) -> Circuit:
    """The circuit at a time [s] after the start, with the faults that have begun."""
    there = {fault.name: fault.size for fault in faults if fault.onset_s <= t}
    lost = {LOSES[name]: getattr(circuit, LOSES[name]) * (1.0 - size) for name, size in there.items() if name in LOSES}
    return replace(circuit, **lost, leak=circuit.leak + there.get(LEAK, 0.0) * ML)


def errors_at(faults: Sequence[Fault], t: float) -> Mapping[str, float]:
    """What the sensors read too much at a time, by signal [Pa]."""
    return {ADDS[fault.name]: fault.size for fault in faults if fault.name in ADDS and fault.onset_s <= t}
