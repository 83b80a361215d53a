"""How large effects are and how large the gap is, as parts of the document."""

from collections.abc import Mapping
from math import isfinite

from faultline.analysis.discrepancy.add.held_out import Gap, Shown
from faultline.analysis.discrepancy.add.whiteness import Whiteness
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.name.attempt import Attempt
from faultline.analysis.discrepancy.name.profile import Ends
from faultline.analysis.discrepancy.show import document
from faultline.analysis.discrepancy.show.sizes import Size, sizes
from faultline.analysis.model import Model
from faultline.analysis.model.display import Units


def strengths_of(
    attempt: Attempt, library: Mapping[str, Effect], units: Units, profiled: Mapping[str, Ends]
) -> tuple[document.Strength, ...]:
    """The sizes of an attempt's effects."""
    return tuple(strength_of(size) for size in sizes(attempt, library, units, profiled))


def strength_of(size: Size) -> document.Strength:
    """A size of an effect for the document."""
    return document.Strength(
        effect=size.effect,
        parameter=size.parameter,
        description=size.description,
        unit=size.unit,
        value=size.value,
        interval=size.interval,
        no_effect=size.null,
        words=size.words,
    )


def regimes_of(model: Model, shown: Shown) -> tuple[document.Regime, ...]:
    """The free runs' errors by output and mode."""
    return tuple(_regime(gap, model.known[gap.output].unit) for gap in shown.gaps)


def _regime(gap: Gap, unit: str) -> document.Regime:
    return document.Regime(
        output=gap.output,
        unit=unit,
        mode=gap.mode,
        samples=gap.after.samples,
        rms_before=gap.before.rms,
        rms_after=gap.after.rms,
        bias_before=gap.before.bias,
        bias_after=gap.after.bias,
        floor=known(gap.after.floor),
        expected=known(gap.expected),
        closure=gap.closure,
        white_before=_white(gap.white_before),
        white_after=_white(gap.white_after),
    )


def known(value: float) -> float | None:
    """A number; None for what is not known."""
    return value if isfinite(value) else None


def _white(found: Whiteness | None) -> document.White | None:
    return None if found is None else document.White(lag1=found.lag1, probability=found.probability)
