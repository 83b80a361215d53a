"""Shapes that follow a signal at the same instant: power, inverse, sign, level, step of an operating mode, product."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.propose.shape import Shape, Tables, nice, scale
from faultline.analysis.model.model import Mode

Array = npt.NDArray[np.float64]

LEVELS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)
"""Where in a signal's usual range a kink is tried; its place is fitted then, within that range."""

RARE = 0.01
"""Of all instants, either way: what lies beyond is a start or a stop, and not the signal's usual range."""

STEADY = 0.1
"""A signal whose least size is above this part of its largest never comes near zero: its inverse is a shape."""

SOFT = 0.03
"""Part of a signal's largest size that counts as zero where its sign changes."""


def linear(operation: Operation, name: str, *, foreign: bool = False) -> Shape:
    """A signal, in parts of its largest size."""
    s, unit = operation.values[name], operation.unit(name)
    s_0 = nice(float(np.abs(s).max()))
    tables = {"s_0": scale(unit, s_0, f"scale of {name}")}
    return Shape("linear", f"in proportion to {name}", f"{name}/s_0", s / s_0, f"linear {name}", foreign, False, tables)


def powers(operation: Operation, name: str) -> Iterator[Shape]:
    """A signal, its square and root, and its inverse or sign."""
    first, s = linear(operation, name), operation.values[name]
    yield first
    x, tables = first.value, first.parameters
    for form, words, formula, value in (
        ("square", f"with the square of {name}", f"{name}*abs({name})/s_0**2", x * np.abs(x)),
        ("root", f"with the root of {name}", f"sgsqrt({name}/s_0)", np.sign(x) * np.sqrt(np.abs(x))),
    ):
        yield Shape(form, words, formula, value, f"{form} {name}", parameters=tables)
    least, most = float(np.abs(s).min()), float(np.abs(s).max())
    w = nice(SOFT * most)
    soft = {"w": scale(operation.unit(name), w, f"size of {name} that counts as zero")}
    if least > STEADY * most:
        words, formula, value = f"with one over {name}", f"s_0*{name}/({name}**2 + w**2)", 1.0 / x
        yield Shape("inverse", words, formula, value, f"inverse {name}", parameters={**tables, **soft})
    else:
        formula, value = f"{name}/({name}**2 + w**2)**(1/2)", s / np.hypot(s, w)
        yield Shape("sign", f"as large at any {name}, with its sign", formula, value, f"sign {name}", parameters=soft)


def levels(operation: Operation, name: str) -> Iterator[Shape]:
    """What of a signal is above or below a level."""
    s, unit = operation.values[name], operation.unit(name)
    least, most = np.quantile(s, (RARE, 1.0 - RARE)).tolist()
    width = most - least
    if width <= 0.0:
        return
    s_0 = nice(width)
    for share in LEVELS:
        level = nice(least + share * width, 3)
        tables = {
            "s_0": scale(unit, s_0, f"scale of {name}"),
            "L": {
                "unit": unit,
                "description": f"level of {name}",
                "value": level,
                "spread": nice(0.1 * width),
                "min": nice(least, 3),
                "max": nice(most, 3),
            },
        }
        for words, d, side in (("above", s - level, f"{name} - L"), ("below", level - s, f"L - {name}")):
            formula, value = f"({side} + abs({side}))/(2*s_0)", np.maximum(d, 0.0) / s_0
            text = f"with how far {name} is {words} a level"
            yield Shape("level", text, formula, value, f"{words} {name}", parameters=tables)


def modes(operation: Operation, name: str, *, foreign: bool) -> Iterator[Shape]:
    """Steps at the bounds of operating modes, softened over half the way to the signal's range."""
    known = operation.model.known.get(name)
    if known is None or name not in operation.model.modes.bounded:
        return
    s = operation.values[name]
    ends = {b: down for mode in operation.model.modes.steady for b, down in _ends(mode, name)}
    bounds = {b: _width(b, known.min, known.max) for b in ends}
    steps = {b: (_ramp(s, b, w), _ramp_text(name, k)) for k, (b, w) in enumerate(bounds.items())}
    tables = {
        f"{end}{k}": scale(operation.unit(name), b + side * w, f"{what} of the step of {name} near {b:g}")
        for k, (b, w) in enumerate(bounds.items())
        for end, side, what in (("a", -1.0, "begin"), ("b", 1.0, "end"))
    }

    def of(*numbers: int) -> Tables:
        return {own: table for own, table in tables.items() if int(own[1:]) in numbers}

    for k, (b, (value, text)) in enumerate(steps.items()):
        words, formula, course = f"only at {name} above {b:g}", text, value
        if ends[b]:
            words, formula, course = f"only at {name} below {b:g}", f"1 - {text}", 1.0 - value
        yield Shape("step", words, formula, course, f"step {name} {k}", foreign, False, of(k))
    levels = sorted(steps)
    for low, high in pairwise(levels):
        numbers, (one, text), (two, beyond) = [[*steps].index(low), [*steps].index(high)], steps[low], steps[high]
        words, formula = f"only at {name} between {low:g} and {high:g}", f"{text} - {beyond}"
        family = f"between {name} {numbers}"
        yield Shape("step", words, formula, one - two, family, foreign, False, of(*numbers))


def _ends(mode: Mode, name: str) -> list[tuple[float, bool]]:
    """The bounds of a signal in a mode, and whether the mode is below."""
    above, below = mode.where.get(name, (None, None))
    return [(bound, down) for bound, down in ((above, False), (below, True)) if bound is not None]


def _width(bound: float, least: float, most: float) -> float:
    """Half of the softened step's width."""
    ends = [abs(bound - end) for end in (least, most) if bound != end]
    return nice(min(0.5 * min(ends), 0.05 * (most - least)))


def _ramp(s: Array, bound: float, w: float) -> Array:
    return np.clip((s - bound + w) / (2.0 * w), 0.0, 1.0)


def _ramp_text(name: str, k: int) -> str:
    return f"(abs({name} - a{k}) - abs({name} - b{k}) + b{k} - a{k})/(2*(b{k} - a{k}))"


def products(operation: Operation, one: str, other: str) -> Iterator[Shape]:
    """Two signals' product."""
    first, second = linear(operation, one), linear(operation, other)
    tables = {
        "u_0": first.parameters["s_0"],
        "s_0": second.parameters["s_0"],
    }
    formula = f"{one}*{other}/(u_0*s_0)"
    words = f"in proportion to {one} times {other}"
    yield Shape("product", words, formula, first.value * second.value, f"{one}*{other}", parameters=tables)
