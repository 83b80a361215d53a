"""Hypotheses of the evidence: the model's faults in all sizes, with their consequences, and the units of sizes."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.network_bank import biased_signals
from faultline.analysis.model import Fault, Known, Model, Parameter, Unknown
from faultline.analysis.model.display import units_of
from faultline.analysis.recordings.modes import where_of
from faultline.service.core.display import Display
from faultline.service.core.manifest import Consequence, Hypothesis, SizeUnit

Array = npt.NDArray[np.float64]

BIASES = (1 / 16, 1 / 2, 4.0)
"""Sizes are parts of the range in which a signal lies without a fault; that of a pressure behind a filter is narrow."""
RANGE = (0.01, 0.99)
"""The range lies between these quantiles."""


def biases_of(model: Model, samples: Array) -> list[Hypothesis]:
    """Return the biases of signals that are faults of a model without formulas; `samples` (K, nz) have no fault."""
    low, high = np.quantile(samples, RANGE, axis=0)
    signals = [*model.known]
    return [
        Hypothesis(fault=fault, size=float(sign * part * (high - low)[signals.index(signal)]))
        for fault, signal in biased_signals(model).items()
        for sign in (1.0, -1.0)
        for part in BIASES
    ]


def hypotheses_of(model: Model) -> list[Hypothesis]:
    """Return the faults and disturbances of all sizes and forms, then the severe ones with their consequences."""
    simple = [
        Hypothesis(fault=each.name, size=size, share_of=share_of)
        for each in model.assumable.values()
        for share_of, sizes in ((None, each.sizes), (each.share_of, each.shares))
        for size in sizes
    ]
    return simple + [
        Hypothesis(fault=each.name, size=size, brought=brought)
        for each in model.faults.values()
        if each.consequence is not None
        for size in each.consequence.sizes or _severe(each.sizes)
        for brought in _second_form(model.faults[each.consequence.fault])
    ]


def _severe(sizes: Sequence[float]) -> list[float]:
    """The larger half of the sizes: smaller ones have no consequence."""
    return sorted(sizes, key=abs)[len(sizes) // 2 :]


def _second_form(fault: Fault) -> Sequence[float]:
    return fault.shares or fault.sizes


def sizes_of(model: Model) -> list[SizeUnit]:
    """Return how people read the sizes of each form of a fault."""
    units, percent = units_of(model), Display(unit="%", size=0.01, digits=1)
    if model.without_formula:
        read = {fault: model.known[signal].unit for fault, signal in biased_signals(model).items()}
        return [SizeUnit(fault=fault, display=units.of(unit, shifted=False)) for fault, unit in read.items() if unit]
    found = []
    for each in model.assumable.values():
        if each.relative_to is not None:
            found.append(SizeUnit(fault=each.name, display=percent, of=model.parameters[each.relative_to].description))
        else:
            shown = units.of(_unit_of(model, each.enters), max(map(abs, each.sizes)), shifted=False)
            found.append(SizeUnit(fault=each.name, display=shown))
        if each.share_of is not None:
            of = model.parameters[each.share_of].description
            found.append(SizeUnit(fault=each.name, share_of=each.share_of, display=percent, of=of))
    return found


def _unit_of(model: Model, name: str) -> str:
    tables: tuple[Mapping[str, Known | Unknown | Parameter], ...] = (model.known, model.unknown, model.parameters)
    return next(table[name].unit for table in tables if name in table)


def consequences_of(model: Model) -> list[Consequence]:
    """Return the consequences of faults."""
    return [
        Consequence(fault=fault.name, brings=brings.fault, where=where_of(brings.where))
        for fault in model.faults.values()
        if (brings := fault.consequence) is not None
    ]
