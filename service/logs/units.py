"""Conversion of any unit to one of its dimension: by the vehicle's table, and by pint where that is installed.

The vehicle has the table alone; what a DBC needs besides, export writes into the bundle (docs/decisions/025-units.md).
"""

import re
from functools import cache
from importlib.util import find_spec
from math import isclose
from tokenize import TokenError
from typing import Any

from faultline.service.core.signals.units import Conversion, plain_unit
from faultline.service.core.signals.units import conversion as by_table

_SPELLINGS = {"1": "dimensionless", "": "dimensionless", "Nm": "N*m", "PS": "metric_horsepower", "Ohm": "ohm"}
_PER = re.compile(r"/\s*(\d+)\s*([A-Za-z]+)")
_POWER = re.compile(r"([A-Za-z])\^?(-?\d+)(?![A-Za-z\d])")
_AFAR = 1e3
"""A value by which the factor is found: the offset of a scale would blur it in that of 1."""
_NO_UNIT = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    SyntaxError,
    TokenError,
    TypeError,
    ValueError,
)
"""What pint raises, besides its own errors, of texts that are no units."""


def conversion(given: str, wanted: str) -> Conversion | None:
    """Return how a value in the unit `given` becomes one in `wanted`; None where that is not known.

    An angle is only converted to an angle: whether a speed in rpm is wanted in turns or in radians, `wanted` must say.

    >>> conversion("kPa", "Pa"), conversion("psi", "K")
    (Conversion(factor=1000.0, offset=0.0), None)
    """
    found = by_table(given, wanted)
    if found is not None or find_spec("pint") is None:
        return found
    written = plain_unit(given)
    return _by_library(written if _is_unit(written) else written.lower(), wanted)


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


@cache
def _is_unit(text: str) -> bool:
    """Whether this is a unit as it is written; A is, and is no year (a)."""
    import pint

    try:
        _parsed(text)
    except (pint.PintError, *_NO_UNIT):
        return False
    return True


@cache
def _by_library(given: str, wanted: str) -> Conversion | None:
    """The conversion by pint; None where a text is no unit, or has another dimension or no straight scale."""
    import pint

    try:
        size, unit = _parsed(given)
        _, target = _parsed(wanted)
        if _root(unit) != _root(target):
            return None
        zero, one, far = (_registry().Quantity(each, unit).to(target).magnitude for each in (0.0, 1.0, _AFAR))
    except (pint.PintError, *_NO_UNIT):
        return None
    factor = one if zero == 0.0 else (far - zero) / _AFAR
    if not isclose(zero + factor, one, rel_tol=1e-9):
        return None  # a logarithm, as decibels
    return Conversion(float(size * factor), float(zero))


def _root(unit: Any) -> Any:
    return _registry().Quantity(1.0, unit).to_root_units().units


def _parsed(text: str) -> tuple[float, Any]:
    """A unit, and the number before it: of L/100km that is L/km and 0.01."""
    formula = _POWER.sub(r"\1**\2", _PER.sub(r"/(\1*\2)", _SPELLINGS.get(text, text)))
    try:
        return 1.0, _registry().parse_units(formula)
    except ValueError:  # it has a number
        found = _registry().parse_expression(formula)
        return float(found.magnitude), found.units
