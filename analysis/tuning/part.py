"""Evidence from a part of the drives, with the hypotheses of all of them.

What a fault does to the residuals is predicted by the model and hardly hangs on whose samples it is predicted from, and
it takes nearly all the time. How far fault-free means stray is what a part is asked for.
"""

from collections.abc import Sequence
from dataclasses import replace

import msgspec

from analysis.graph.bank import Bank
from analysis.tuning.evidence import gather
from analysis.tuning.thresholds import Seen
from service.core.manifest import Detector, Evidence


def evidence_of_part(
    bank: Bank, detectors: Sequence[Detector], part: Sequence[Seen], stand_ins: Sequence[int], whole: Evidence
) -> Evidence:
    """As `gather` of the part would, but for the hypotheses; generators are among those of `whole`."""
    names = [generator.name for generator in bank.generators]
    rows = [names.index(name) for name in whole.generators]
    some = [Seen(name=s.name, z=s.z, r=s.r[:, rows], usable=s.usable[:, rows], mode=s.mode) for s in part]
    found = gather(_hardly_faulty(bank.only(rows)), [detectors[row] for row in rows], some, stand_ins)
    columns = [whole.generators.index(name) for name in found.generators]
    hypotheses = [
        msgspec.structs.replace(h, shift=[[of_mode[column] for column in columns] for of_mode in h.shift])
        for h in whole.hypotheses
    ]
    return msgspec.structs.replace(found, hypotheses=hypotheses)


def _hardly_faulty(bank: Bank) -> Bank:
    """With the first size of the first fault alone."""
    first, *others = bank.model.faults.values()
    sizes = {first.name: first.sizes[:1]} | {fault.name: () for fault in others}
    equations = {
        name: equation
        if (fault := equation.fault) is None
        else replace(equation, fault=replace(fault, sizes=sizes[fault.name]))
        for name, equation in bank.model.equations.items()
    }
    return replace(bank, model=replace(bank.model, equations=equations))
