"""The families by name, and their plants by number."""

from collections.abc import Mapping
from dataclasses import replace

from faultline.testbench.errors import RigError
from faultline.testbench.families.circuit import HIDDEN
from faultline.testbench.families.development import DEVELOPMENT
from faultline.testbench.families.parts import Family
from faultline.testbench.families.plant import Plant
from faultline.testbench.families.verification import VERIFICATION
from faultline.testbench.streams import stream

FAMILIES: dict[str, Family] = {**DEVELOPMENT, **VERIFICATION}


def plant_of(family: str, number: int, effects: Mapping[str, float] | None = None) -> Plant:
    """The plant with a number, with `effects` of its circuit by name.

    Raises:
        RigError: there is no such family.
    """
    if family not in FAMILIES:
        raise RigError(f"there is no family {family!r}; choose one of {', '.join(FAMILIES)}")
    plant = FAMILIES[family].draw(stream(number, family, "plant"))
    circuit = replace(plant.circuit, **{name: (effects or {}).get(name, 0.0) for name in HIDDEN})
    return replace(plant, family=family, number=number, circuit=circuit)
