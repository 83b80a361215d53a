"""From the fault memory, as the control socket tells it, to trouble codes: active ones and previously active ones.

Of faults that are confirmed only: active is one that is there now (`test_failed`), previously active one that is not.
Codes of an ambiguity group are all sent. A code that several faults have is sent once, with the largest count, and as
active if any of them is.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from faultline.service.core.j1939.dm1 import MOST, MOST_FMI, MOST_OC, MOST_SPN, Code
from faultline.service.core.records.fault import Dtc, Fault


class Known(NamedTuple):
    """What is on the bus: codes, the oldest fault's first, and whether the amber lamp is lit.

    The lamp is lit while any confirmed fault is there, one without a code too.
    """

    active: tuple[Code, ...]
    previous: tuple[Code, ...]
    amber: bool

    @property
    def state(self) -> tuple[bool, frozenset[tuple[int, int]]]:
        """What is a change of state when it changes; a count alone is none."""
        return self.amber, frozenset((code.spn, code.fmi) for code in self.active)


def known(faults: Iterable[Fault]) -> Known:
    """What the faults are on the bus."""
    confirmed = [fault for fault in faults if fault.status.confirmed]
    there = [fault for fault in confirmed if fault.status.test_failed]
    active = _codes(there)
    gone = _codes(fault for fault in confirmed if not fault.status.test_failed)
    previous = {dtc: code for dtc, code in gone.items() if dtc not in active}
    counts = {dtc: max(code.oc, gone[dtc].oc) if dtc in gone else code.oc for dtc, code in active.items()}
    return Known(
        tuple(Code(dtc.spn, dtc.fmi, count) for dtc, count in counts.items()), tuple(previous.values()), bool(there)
    )


def unsent(faults: Sequence[Fault]) -> dict[int, str]:
    """By number, what of confirmed faults is not on the bus, in words."""
    told: dict[int, str] = {}
    for fault in faults:
        if not fault.status.confirmed:
            continue
        name = f"fault {fault.number} ({', '.join(fault.components) or 'unknown'})"
        bad = [f"SPN {dtc.spn} FMI {dtc.fmi}" for dtc in fault.dtcs if not _is_valid(dtc)]
        if not fault.dtcs:
            told[fault.number] = f"{name} has no SPN and FMI: no code of it is sent"
        elif bad:
            told[fault.number] = f"{name} has no valid code in {', '.join(bad)}: not sent"
    return told


def left_out(one: Known) -> int:
    """How many codes are too many for a message."""
    return max(0, len(one.active) - MOST) + max(0, len(one.previous) - MOST)


def _codes(faults: Iterable[Fault]) -> dict[Dtc, Code]:
    codes: dict[Dtc, Code] = {}
    for fault in faults:
        count = min(max(fault.occurrences, 0), MOST_OC)
        for dtc in fault.dtcs:
            if _is_valid(dtc):
                before = codes.get(dtc)
                codes[dtc] = Code(dtc.spn, dtc.fmi, max(count, before.oc if before else 0))
    return codes


def _is_valid(dtc: Dtc) -> bool:
    """SPN 0 and the largest one mean that there is no code."""
    return 0 < dtc.spn < MOST_SPN and 0 <= dtc.fmi <= MOST_FMI
