"""Where a fit puts the parameters without an effect and with it: those that did its work come back to the datasheet.

All distances are in standard deviations of the prior, from the values of the model file that was given.
"""

from dataclasses import dataclass

import numpy as np

from faultline.analysis.discrepancy.name.attempt import Attempt
from faultline.analysis.model import Model, Parameter

MOVED = 0.5
"""Standard deviations of the prior by which a parameter must come nearer or go further to be named."""


@dataclass(frozen=True)
class Drift:
    """A parameter in `unit`: the `datasheet`'s value, and those that were fitted `without` the effect and `with_it`.

    `before` and `after` are their distances from the datasheet, signed; `scaled` whether these are of the logarithm.
    """

    name: str
    description: str
    unit: str
    datasheet: float
    without: float
    with_it: float
    before: float
    after: float
    scaled: bool

    @property
    def nearer(self) -> float:
        """By how much it has come nearer to the datasheet; negative for what has gone further."""
        return abs(self.before) - abs(self.after)

    @property
    def sentence(self) -> str:
        """The two values, against the datasheet's."""
        name = f"{self.name} ({self.description})"
        if self.scaled:
            without, with_it = (f"{value / self.datasheet:.3g}x" for value in (self.without, self.with_it))
            return f"{name}: {without} the datasheet without the effect, {with_it} with it"
        unit = "" if self.unit == "1" else f" {self.unit}"
        told = f"{name}: {self.without:.3g}{unit} without the effect, {self.with_it:.3g}{unit} with it"
        return f"{told}; the datasheet says {self.datasheet:.3g}{unit}"


@dataclass(frozen=True)
class Drifts:
    """All parameters of the model that was given, in its order."""

    parameters: tuple[Drift, ...]

    @property
    def back(self) -> tuple[Drift, ...]:
        """Those that have moved back towards the datasheet, the furthest first."""
        return tuple(sorted((d for d in self.parameters if d.nearer >= MOVED), key=lambda d: -d.nearer))

    @property
    def away(self) -> tuple[Drift, ...]:
        """Those that have moved away from it, the furthest first."""
        return tuple(sorted((d for d in self.parameters if d.nearer <= -MOVED), key=lambda d: d.nearer))

    @property
    def distances(self) -> tuple[float, float]:
        """Root mean square over the parameters, without the effect and with it."""
        both = np.array([[d.before, d.after] for d in self.parameters]).reshape(-1, 2)
        without, with_it = np.sqrt((both**2).sum(axis=0) / max(len(both), 1)).tolist()
        return without, with_it

    def sentences(self) -> list[str]:
        """What has moved, in words; the whole first."""
        without, with_it = self.distances
        whole = (
            f"the {len(self.parameters)} parameters are {without:.2g} standard deviations of their priors from the "
            f"datasheet without the effect, {with_it:.2g} with it (root mean square)"
        )
        named = ((self.back, "moved back towards the datasheet"), (self.away, "moved away from the datasheet"))
        return [whole, *(f"{d.sentence}: {verdict}" for found, verdict in named for d in found)]


def drifts(model: Model, nominal: Attempt, chosen: Attempt) -> Drifts:
    """The drifts of the parameters of `model`, from the attempt without effects to the one that was chosen."""
    without, with_it = nominal.values, chosen.values
    return Drifts(
        tuple(
            Drift(
                name=name,
                description=p.description,
                unit=p.unit,
                datasheet=p.value,
                without=without[name],
                with_it=with_it[name],
                before=_distance(p, without[name]),
                after=_distance(p, with_it[name]),
                scaled=p.prior is not None,
            )
            for name, p in model.parameters.items()
            if p.calibrated and name in without and name in with_it
        )
    )


def _distance(parameter: Parameter, value: float) -> float:
    if parameter.prior is not None:
        return float(np.log(value / parameter.value)) / parameter.prior
    return (value - parameter.value) / (parameter.spread or 1.0)
