"""Entries of the fault memory, and the episodes that they are made of."""

import numpy as np
from msgspec import structs

from faultline.service.core.memory.debounce import Debounce
from faultline.service.core.memory.rules import Rules
from faultline.service.core.memory.system import System
from faultline.service.core.records.event import Event
from faultline.service.core.records.fault import Fault, Seen, Status


class Episode:
    """Diagnosis of a system now. `number` is its entry once it counts, `before` the entry until then."""

    def __init__(self, system: System, rules: Rules) -> None:
        self.system = system
        self.told: Event | None = None
        self.modes: list[str] = []
        self.number: int | None = None
        self.before: Fault | None = None
        looks = (max(1, round(s / system.time.period_s)) for s in (rules.failed_after_s, rules.passed_after_s))
        self.debounce = Debounce(*looks)
        self.quiet = np.zeros(
            (len(system.modes), len(system.tests)), dtype=np.int64
        )  # ticks, since it failed, or the cycle
        self.ticks = 0


def in_new_cycle(fault: Fault) -> Fault:
    """Return the entry as it is when an operation cycle begins: it has neither failed nor been completed in it."""
    status = structs.replace(fault.status, test_failed_this_cycle=False, not_completed_this_cycle=True)
    return structs.replace(fault, status=status, mask=status.mask)


def fresh(number: int, episode: Episode, cycle: int) -> Fault:
    """An entry in which nothing counts yet."""
    assert episode.told is not None
    seen = Seen(id=episode.told.id, wall=episode.told.wall, cycle=cycle)
    status = Status(
        test_failed=False,
        test_failed_this_cycle=False,
        pending=False,
        confirmed=False,
        not_completed_since_clear=False,
        failed_since_clear=True,
        not_completed_this_cycle=True,
        warning=False,
    )
    return Fault(
        number=number,
        system=episode.system.name,
        bundle=episode.system.bundle,
        diagnoses=[],
        components=[],
        dtcs=[],
        tests=[],
        modes=[],
        status=status,
        mask=status.mask,
        fdc=0,
        occurrences=1,
        trips=0,
        healing=0,
        aging=0,
        first=seen,
        latest=seen,
    )


def with_told(fault: Fault, episode: Episode, cycle: int) -> Fault:
    """Return the entry with the present diagnosis."""
    told, system = episode.told, episode.system
    assert told is not None
    components = (system.components.get(name, name) for one in told.diagnoses for name in one.faults)
    return structs.replace(
        fault,
        bundle=system.bundle,
        diagnoses=told.diagnoses,
        components=[*dict.fromkeys(components)],
        dtcs=system.codes(told.diagnoses),
        tests=sorted({*fault.tests, *told.alarm} if fault.status.test_failed else told.alarm),
        modes=[*dict.fromkeys([*fault.modes, *episode.modes])] if fault.status.test_failed else episode.modes,
        latest=Seen(id=told.id, wall=told.wall, cycle=cycle),
    )
