"""Cases: what recordings have in common that are counted together, the same fault of the same size."""

from collections.abc import Sequence

import msgspec

from faultline.analysis.evaluation.truth import Truth

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


def cases_of(truths: Sequence[Truth]) -> dict[str, Case]:
    """The case of each recording, by its id."""
    by_name = {truth.recording: sorted(truth.fault, key=lambda fault: fault.name) for truth in truths}
    names = {recording: tuple(fault.name for fault in there) for recording, there in by_name.items()}
    sizes = {recording: " ".join(size_text(fault.size) for fault in there) for recording, there in by_name.items()}
    found = {}
    for recording, faults in names.items():
        alike = {sizes[other] for other, theirs in names.items() if theirs == faults}
        found[recording] = Case(faults, sizes[recording] if 1 < len(alike) <= SIZES else "")
    return found


def size_text(size: float) -> str:
    """A size with its unit: fractions are below 1, an error of a sensor is in pascal.

    >>> size_text(0.65), size_text(-20000.0)
    ('65 %', '-200 mbar')
    """
    return f"{100 * size:g} %" if abs(size) <= 1.0 else f"{size / 100:g} mbar"
