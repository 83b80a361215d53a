"""Conversion of units for display: pressures in bar, ratios in percent."""

UNITS = {"Pa": ("bar", 1e5, 3), "1": ("%", 0.01, 1), "1/s": ("1/s", 1.0, 2)}
"""Of a unit of the bundle: what is shown, how much of the bundle's unit that is, and digits behind the point."""


def scaled(value: float, unit: str) -> float:
    """Return the value in the unit that is shown."""
    return value / UNITS.get(unit, (unit, 1.0, 3))[1]


def unit_shown(unit: str) -> str:
    """Return the unit that is shown."""
    return UNITS.get(unit, (unit, 1.0, 3))[0]


def shown(value: float | None, unit: str) -> str:
    """Return the value with the unit that is shown.

    >>> shown(1012345.0, "Pa"), shown(0.5, "1"), shown(None, "Pa")
    ('10.123 bar', '50.0 %', '- bar')
    """
    name, size, digits = UNITS.get(unit, (unit, 1.0, 3))
    return f"{'-' if value is None else f'{value / size:.{digits}f}'} {name}"
