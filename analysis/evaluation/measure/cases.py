"""Cases: what recordings have in common that are counted together, the same fault of the same size."""

from collections.abc import Sequence

import msgspec

from faultline.analysis.evaluation.truth import TrueFault, Truth
from faultline.analysis.model.display import Units

SIZES = 3
"""A fault recorded in more sizes than this is one case: a column for each would hold a recording each."""


class Case(msgspec.Struct, frozen=True):
    """The names of the faults that are there together, sorted (none: fault-free), and the label of their size."""

    faults: tuple[str, ...]
    size: str

    @property
    def label(self) -> str:
        """As it heads a column."""
        return " ".join(filter(None, ["+".join(self.faults) or "fault-free", self.size]))


def cases_of(truths: Sequence[Truth], units: Units) -> dict[str, Case]:
    """The case of each recording, by its id; sizes are in the `units` that people read."""
    by_name = {truth.recording: sorted(truth.fault, key=lambda fault: fault.name) for truth in truths}
    names = {recording: tuple(fault.name for fault in there) for recording, there in by_name.items()}
    sizes = {recording: " ".join(size_text(fault, units) for fault in there) for recording, there in by_name.items()}
    found = {}
    for recording, faults in names.items():
        alike = {sizes[other] for other, theirs in names.items() if theirs == faults}
        found[recording] = Case(faults, sizes[recording] if 1 < len(alike) <= SIZES else "")
    return found


def size_text(fault: TrueFault, units: Units) -> str:
    """A size with its unit: parts in per cent, nothing where the truth says no unit."""
    if fault.unit == "1":
        return f"{100 * fault.size:g} %"
    return units.of(fault.unit, abs(fault.size)).difference(fault.size)
