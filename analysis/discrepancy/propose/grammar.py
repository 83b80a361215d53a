"""The grammar of missing terms: the shapes that a term of an equation may follow.

Constant, power, inverse, sign, level, step, product, rate, late rate, time and integral. Each shape is a formula in the
model's names and names of its own, beside its course along a run, by which it is screened before any fit.
"""

from itertools import product

import numpy as np

from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.propose.dynamic import rates, sums, times
from faultline.analysis.discrepancy.propose.shape import Shape
from faultline.analysis.discrepancy.propose.static import levels, linear, modes, powers, products


def shapes(operation: Operation, equation: str) -> list[Shape]:
    """Return the shapes that a term of an equation may follow."""
    own = operation.own(equation)
    found = [Shape("constant", "always", "1", np.ones(len(operation.time)), "constant", bare=True)]
    for name in _signals(operation):
        foreign = name not in own
        if not foreign:
            found += powers(operation, name)
            found += levels(operation, name)
        elif name in operation.inputs:
            found += [linear(operation, name, foreign=True)]
        found += modes(operation, name, foreign=foreign)
        if not foreign or name in operation.inputs:
            found += sums(operation, name, foreign=foreign)
    inside = [name for name in _signals(operation) if name in own]
    for one, other in product([n for n in inside if n in operation.inputs], inside):
        found += products(operation, one, other) if one != other else []
    for d in operation.model.differentials:
        if d.state in own:
            found += rates(operation, d.state, d.derivative)
    return [shape for shape in [*found, *times(operation)] if np.ptp(shape.value) > 0.0 or shape.bare]


def _signals(operation: Operation) -> list[str]:
    """Inputs and unknowns that vary, but for derivatives."""
    derivatives = {d.derivative for d in operation.model.differentials}
    names = [*operation.inputs, *(n for n in operation.model.unknown if n in operation.values and n not in derivatives)]
    return [name for name in names if np.ptp(operation.values[name]) > 0.0]
