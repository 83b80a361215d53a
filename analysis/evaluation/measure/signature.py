"""The realised fault signature matrix beside the structural one: how often each generator alarms under each fault.

Structure says which tests *can* see a fault. Data say which do, at the sizes that were there, with the bundle's
thresholds: the share of faulty blocks with an alarm, and besides that its cause, the fault-free share.
"""

from collections.abc import Sequence
from statistics import median
from typing import Protocol

import msgspec
import numpy as np

from faultline.analysis.evaluation.blocks import joined
from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.measure.intervals import Share, share
from faultline.analysis.evaluation.measure.roc import area
from faultline.service.core.manifest import Generator


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """One generator and one case.

    `sensitive`: the structure says that the test sees the fault; None for faults that the bundle does not know.
    `alarm`: blocks with an alarm among those in which it could tell. `delays_s` from the onset to the first alarm that
    began after it, one for each recording in which there was one, of `recordings`; in `standing` of them a false alarm
    stood at the onset already, which hides the true one and is counted in `alarm`. `cannot_tell`: share of the faulty
    time. `auc` by `analysis.evaluation.blocks.scored`, None where there are no blocks to compare.
    """

    generator: str
    case: str
    sensitive: bool | None
    alarm: Share
    recordings: int
    standing: int
    delays_s: list[float]
    median_delay_s: float | None
    cannot_tell: float | None
    auc: dict[str, float | None]


class Sees(Protocol):
    """What has a row of the structural fault signature matrix."""

    @property
    def faults(self) -> list[str]:
        """The faults that it is sensitive to."""


def sensitive(generator: Sees, faults: Sequence[str], known: Sequence[str]) -> bool | None:
    """Whether the structure says that the generator sees any of `faults`; None if one of them is not known.

    One that is not among the faults that the bundle knows may or may not move the test: structure cannot say.
    """
    if any(fault in generator.faults for fault in faults):
        return True
    return False if set(faults) <= set(known) else None


def cells(
    of: Sequence[Facts], generators: Sequence[Generator], known: Sequence[str], scored: Sequence[str]
) -> list[Cell]:
    """All generators times all faulty cases, in the order of the bundle and of the recordings."""
    free = joined([one.blocks for one in of])
    free_scores = np.where((~free.faulty)[:, None, None], free.scores, np.nan)
    found = []
    for case in dict.fromkeys(one.case for one in of if one.case.faults):
        here = [one for one in of if one.case == case]
        all_blocks = joined([one.blocks for one in here])
        faulty, ticks = all_blocks.faulty, sum(int(one.ticks[1]) for one in here)
        for column, generator in enumerate(generators):
            tells = all_blocks.tells[faulty, column]
            alarms = all_blocks.alarms[faulty, column] & tells
            delays = [float(one.delays_s[column]) for one in here if np.isfinite(one.delays_s[column])]
            usable = sum(int(one.usable[1, column]) for one in here)
            found.append(
                Cell(
                    generator=generator.name,
                    case=case.label,
                    sensitive=sensitive(generator, case.faults, known),
                    alarm=share(int(alarms.sum()), int(tells.sum())),
                    recordings=len(here),
                    standing=sum(bool(one.standing[column]) for one in here),
                    delays_s=[round(delay, 1) for delay in delays],
                    median_delay_s=round(median(delays), 1) if delays else None,
                    cannot_tell=round(1.0 - usable / ticks, 4) if ticks else None,
                    auc={
                        name: area(free_scores[:, row, column], all_blocks.scores[faulty, row, column])
                        for row, name in enumerate(scored)
                    },
                )
            )
    return found
