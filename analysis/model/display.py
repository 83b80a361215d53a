"""The units in which people read the quantities of a model, where its system says others than the model's own."""

from collections.abc import Mapping, Sequence
from math import floor, inf, log10

import msgspec

from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.model import Known, Model
from faultline.analysis.model.units import parse_unit
from faultline.service.core.display import Display, fitting
from faultline.service.core.manifest import Input
from faultline.service.core.signals.units import conversion as by_table
from faultline.service.logs.units import conversion

MOST_DIGITS = 12


class Units(msgspec.Struct, frozen=True):
    """Units that people read: `by` a unit of the model, and by a signal, coarse to fine."""

    by: Mapping[str, tuple[Display, ...]] = {}

    def of(self, unit: str, size: float = inf, signal: str = "", *, shifted: bool = True) -> Display:
        """Return how values up to `size` of a quantity are read; one of which nothing is said in its own unit.

        Not `shifted`: in a unit with the same zero, as what may be a difference is read.
        """
        own = Display(unit=unit)
        found = fitting(self.by.get(signal) or self.by.get(unit) or (own,), size)
        return found if shifted or not found.zero else own


def units_of_inputs(inputs: Sequence[Input]) -> Units:
    """Return the units that people read the signals of a bundle in, and others of the same units."""
    return Units(
        {one.unit: tuple(one.display) for one in reversed(inputs)} | {one.signal: tuple(one.display) for one in inputs}
    )


def units_of(model: Model, where: str = "") -> Units:
    """Return the units that people read the model's quantities in; a message begins with `where`.

    Raises:
        ModelError: one is not of the model's dimension.
    """
    by = {
        unit: tuple(_display(unit, one, f"{where}: display.{unit}") for one in wanted)
        for unit, wanted in model.display.items()
    }
    return Units(by | {name: _of_signal(model, name, known, where) for name, known in model.known.items()})


def _of_signal(model: Model, name: str, known: Known, where: str) -> tuple[Display, ...]:
    """Return the units of a signal: its own, or those of its unit; with a digit more than its noise leaves."""
    wanted = known.display or model.display.get(known.unit) or (known.unit,)
    found = [_display(known.unit, one, f"{where}: known.{name}.display") for one in wanted]
    return tuple(msgspec.structs.replace(one, digits=_digits(known.noise / one.size)) for one in found)


def _display(unit: str, wanted: str, place: str) -> Display:
    """Return the unit `wanted` as one for values in `unit`; raises ModelError if it is none."""
    if how := by_table(wanted, unit):
        return Display(unit=wanted, size=how.factor, zero=how.offset)
    try:
        (own, dimension), (size, shown) = parse_unit(unit), parse_unit(wanted)
    except ValueError as error:
        if how := conversion(wanted, unit):
            return Display(unit=wanted, size=how.factor, zero=how.offset)
        raise ModelError(f"{place}: {error}") from error
    if shown != dimension:
        raise ModelError(f"{place}: {wanted} is no unit for values in {unit}; give one of the same dimension")
    return Display(unit=wanted, size=float(size / own))


def _digits(noise: float) -> int | None:
    if noise <= 0.0:
        return None
    return min(max(floor(-log10(noise) + 1e-9) + 1, 0), MOST_DIGITS)
