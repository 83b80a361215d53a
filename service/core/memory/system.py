"""Watched system in the fault memory: the meaning of its faults' names, and their J1939 codes."""

from collections.abc import Sequence
from typing import NamedTuple

from faultline.service.core.manifest import Manifest
from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Dtc
from faultline.service.core.time_scale import TimeScale

AMBIGUOUS, UNKNOWN = Dtc(spn=520192, fmi=11), Dtc(spn=520192, fmi=31)
"""The watched system as a whole, of a manufacturer's numbers: root cause not known (it is one of several components),
condition exists (it is no component that the model knows)."""


class System(NamedTuple):
    """Watched system: its name, the manifest's SHA-256, time scale and modes, and what its names mean."""

    name: str
    bundle: str
    time: TimeScale
    modes: tuple[str, ...]
    tests: tuple[str, ...]  # of every generator
    components: dict[str, str]  # by fault
    dtcs: dict[str, Dtc]  # by fault, those that have one

    @classmethod
    def of(cls, manifest: Manifest, bundle: str) -> "System":
        """The system of a bundle."""
        return cls(
            manifest.name,
            bundle,
            manifest.time,
            manifest.modes.names,
            tuple(generator.test for generator in manifest.generators),
            {fault.name: fault.component for fault in manifest.faults},
            {
                fault.name: Dtc(spn=fault.spn, fmi=fault.fmi)
                for fault in manifest.faults
                if fault.spn is not None and fault.fmi is not None
            },
        )

    def codes(self, diagnoses: Sequence[Diagnosis]) -> list[Dtc]:
        """Return the codes of its faults if one explanation is left; the system's if several or none are."""
        if not any(one.faults for one in diagnoses):
            return [UNKNOWN]
        if len(diagnoses) > 1:
            return [AMBIGUOUS]
        return [self.dtcs[name] for name in diagnoses[0].faults if name in self.dtcs]
