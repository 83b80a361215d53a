"""How large the effects of an attempt are, with 95 % intervals, in the model's units and in those that people read."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.name.attempt import Attempt
from faultline.analysis.discrepancy.name.profile import Ends
from faultline.analysis.model.display import Units
from faultline.service.core.display import Display

SURE = 1.96
"""Standard deviations either way, for 95 %."""


@dataclass(frozen=True)
class Size:
    """A parameter that an effect brings, with its 95 % interval, None for one at its bound; `null` is no effect.

    An end of the interval that is None is open.

    People read it in the unit `shown`. Of a parameter without a null value, a time constant for example, it is None.
    """

    effect: str
    parameter: str
    description: str
    unit: str
    value: float
    interval: Ends | None
    null: float | None
    shown: Display

    @property
    def words(self) -> str:
        """For example "additional flow when held open, as a fraction: 0.17 (95 %: 0.16 to 0.18)"."""
        value = f"{self.description}: {self.shown.short(self.value)}"
        if self.interval is None:
            return f"{value}, the end of what is possible"
        low, high = (None if end is None else self.shown.short(end) for end in self.interval)
        if low is None and high is None:
            return f"{value} (these recordings say nothing against another)"
        if low is None or high is None:
            return f"{value} (95 %: {f'at most {high}' if low is None else f'at least {low}'}; beyond, they do not say)"
        return f"{value} (95 %: {low} to {high})"


def sizes(
    attempt: Attempt, library: Mapping[str, Effect], units: Units, profiled: Mapping[str, Ends] = MappingProxyType({})
) -> tuple[Size, ...]:
    """Return the sizes of all effects in an attempt, in the `units` that people read; `profiled` are known intervals.

    What is left even of the best model may be more than the noise; then the intervals are as much wider.
    """
    unknowns = attempt.unknowns
    scale = dict(zip(unknowns.parameters, np.abs(unknowns.theta_by_x(attempt.x)).tolist(), strict=True))
    found = []
    for effect in (library[name] for name in attempt.effects):
        for own, p in effect.parameters.items():
            name = effect.prefixed(own)
            if name in unknowns.parameters:
                k = unknowns.parameters.index(name)
                sd = attempt.spreads[name] / scale[name] * np.sqrt(max(attempt.dispersion, 1.0))
                ends = (_moved(attempt, k, side * SURE * sd, p.min, p.max) for side in (-1.0, 1.0))
                low, high = profiled.get(name) or ends
                found.append(
                    Size(
                        effect=effect.name,
                        parameter=name,
                        description=p.description,
                        unit=p.unit,
                        value=attempt.values[name],
                        interval=(low, high) if attempt.inside[k] or name in profiled else None,
                        null=p.null,
                        shown=units.of(p.unit, shifted=False),
                    )
                )
    return tuple(found)


def _moved(attempt: Attempt, k: int, by: float, least: float | None, most: float | None) -> float:
    """The parameter so many prior standard deviations from where it was found, within its bounds."""
    x = attempt.x.copy()
    x[k] += by
    value = attempt.unknowns.theta(x)[attempt.unknowns.parameters[k]]
    return float(np.clip(value, -np.inf if least is None else least, np.inf if most is None else most))
