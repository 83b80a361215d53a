"""Units as DBC files write them, to the SI units of models and bundles."""

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from faultline.service.core.manifest import Unit


class Conversion(NamedTuple):
    """`value * factor + offset` is in the other unit."""

    factor: float
    offset: float = 0.0


Convert = Callable[[str, str], Conversion | None]
"""How a value in one unit becomes one in another; None where that is not known."""


UNITS: Mapping[str, tuple[str, Conversion]] = {
    "": ("1", Conversion(1.0)),
    "hPa": ("Pa", Conversion(1e2)),
    "mbar": ("Pa", Conversion(1e2)),
    "kPa": ("Pa", Conversion(1e3)),
    "MPa": ("Pa", Conversion(1e6)),
    "bar": ("Pa", Conversion(1e5)),
    "%": ("1", Conversion(1e-2)),
    "percent": ("1", Conversion(1e-2)),
    "ratio": ("1", Conversion(1.0)),
    "rpm": ("1/s", Conversion(1 / 60)),
    "1/min": ("1/s", Conversion(1 / 60)),
    "Hz": ("1/s", Conversion(1.0)),
    "degC": ("K", Conversion(1.0, 273.15)),
    "km/h": ("m/s", Conversion(1 / 3.6)),
    "kph": ("m/s", Conversion(1 / 3.6)),
    "um": ("m", Conversion(1e-6)),
    "mm": ("m", Conversion(1e-3)),
    "cm": ("m", Conversion(1e-2)),
    "km": ("m", Conversion(1e3)),
    "us": ("s", Conversion(1e-6)),
    "ms": ("s", Conversion(1e-3)),
    "min": ("s", Conversion(60.0)),
    "h": ("s", Conversion(3600.0)),
    "g": ("kg", Conversion(1e-3)),
    "mg": ("kg", Conversion(1e-6)),
    "l": ("m3", Conversion(1e-3)),
    "ml": ("m3", Conversion(1e-6)),
    "l/h": ("m3/s", Conversion(1e-3 / 3600)),
    "l/min": ("m3/s", Conversion(1e-3 / 60)),
    "g/h": ("kg/s", Conversion(1e-3 / 3600)),
    "g/min": ("kg/s", Conversion(1e-3 / 60)),
    "g/s": ("kg/s", Conversion(1e-3)),
    "kg/h": ("kg/s", Conversion(1 / 3600)),
    "uV": ("V", Conversion(1e-6)),
    "mV": ("V", Conversion(1e-3)),
    "uA": ("A", Conversion(1e-6)),
    "mA": ("A", Conversion(1e-3)),
    "kW": ("W", Conversion(1e3)),
    "kN": ("N", Conversion(1e3)),
}
"""By a unit's name in ASCII: the SI unit, and how to get there."""

MORE = " (any unit is known where pint is installed, extra `units`)"
"""What an error about a unit adds."""

_SPELLINGS = {
    "-": "",
    "deg C": "degC",
    "Deg C": "degC",
    "DegC": "degC",
    "C": "degC",
    "L": "l",
    "L/h": "l/h",
    "L/min": "l/min",
}
_SIGNS = {"µ": "u", "μ": "u", "°": "deg", "º": "deg", "²": "2", "³": "3", "·": " "}  # both signs of micro


def plain_unit(text: str) -> str:
    """Return the unit in ASCII, where there is a name for it.

    >>> plain_unit("°C"), plain_unit(" µA"), plain_unit("kPa"), plain_unit("-")
    ('degC', 'uA', 'kPa', '')
    """
    name = "".join(_SIGNS.get(each, each) for each in text.strip())
    return _SPELLINGS.get(name, name)


def conversion(given: str, wanted: str) -> Conversion | None:
    """Return how a value in the unit `given` becomes one in `wanted`; None where that is not known.

    Where no unit is wanted it stays as it is.

    >>> conversion("°C", "K"), conversion("Pa", ""), conversion("kPa", "K")
    (Conversion(factor=1.0, offset=273.15), Conversion(factor=1.0, offset=0.0), None)
    """
    if not wanted or given == wanted or plain_unit(given) == plain_unit(wanted):
        return Conversion(1.0)
    target, how = UNITS.get(plain_unit(given), ("", None))
    return how if target == wanted else None


def with_units(units: Iterable[Unit]) -> Convert:
    """Return the conversion that knows these units besides the table's, as a bundle brings them."""
    more = {(given, wanted): Conversion(factor, offset) for given, wanted, factor, offset in units}
    return lambda given, wanted: conversion(given, wanted) or more.get((given, wanted))
