"""Whether what was found may be added to the model: a right name in a wrong form can make a model worse.

The model with the effects has to predict the held-out recordings better in free runs, or as well where there was no gap
to close; and nothing in it may have run into a bound, which would be the form's way to say that it does not fit.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from faultline.analysis.calibration.problem import DELAY
from faultline.analysis.calibration.validate import STEADY
from faultline.analysis.discrepancy.add.adopt import adopted
from faultline.analysis.discrepancy.add.held_out import Gap, Shown
from faultline.analysis.discrepancy.data import Data
from faultline.analysis.discrepancy.discover import Discovery
from faultline.analysis.model import Model
from faultline.analysis.model.display import units_of
from faultline.service.core.display import Display
from faultline.service.core.manifest import EDGE

WORSE = 1.05
"""A free run's error in a mode may grow by this factor, and to what noise lets expect; more, and nothing is added."""

GROWN = 1.01
"""A free run's steady error over all outputs (geometric mean) that grows by this factor is not better, however much
evidence the training has and whatever noise lets expect; less does not tell one model from another."""

FORETOLD, SLIGHT = 5.0, 1.02
"""The factor may be as large as `SLIGHT` where the held-out recordings have `FORETOLD` nats of evidence for the effect:
transients count in it, and what acts while pressures change hardly shows in steady errors."""

UNEVEN = 1.03
"""The mean must shrink by this factor where one output's steady error grows by more than it: a blocked vent takes one
error to a quarter and another up by a tenth, but small gains do not pay for losses."""

UNLIKELY = 3.0
"""Standard deviations of a prior: a sensor's lag or a command's delay beyond them does another thing's work."""


@dataclass(frozen=True)
class Adoption:
    """The model with the effects, or the reasons why it should not be; without effects there is neither."""

    model: Model | None
    reasons: tuple[str, ...]


def adoption(data: Data, found: Discovery, shown: Shown) -> Adoption:
    """The model with the chosen effects of a discovery, and why it should not be taken, if there are reasons.

    Raises:
        ModelError: an effect has no place in the model any more.
    """
    chosen = found.outcome.chosen
    if not chosen.effects:
        return Adoption(None, ())
    facts = {
        "vehicle": data.vehicle,
        "recordings": [log.drive for log in data.training],
        "held_out": [log.drive for log in data.held],
        "evidence_nats": round(found.verdict.gain, 1),
        "verdict": found.verdict.kind,
        "rivals": [list(names[1:]) for names in found.verdict.sets],
    }
    effects = [found.study.library[name] for name in chosen.effects]
    model = adopted(
        data.model, effects, chosen.values, {name: fact for name, fact in facts.items() if fact is not None}
    )
    return Adoption(model, tuple(reasons(found, shown)))


def reasons(found: Discovery, shown: Shown) -> Iterator[str]:
    """Why the chosen effects should not be added to the model."""
    chosen = found.outcome.chosen
    against = {
        "unnamed": f"with {', '.join(chosen.effects)} in it the model misses as much again: that is not its name",
        "recordings differ": "the held-out recordings show it and the training ones do not: no physics of the vehicle",
    }
    if found.verdict.kind in against:
        yield against[found.verdict.kind]
    model = found.study.model
    units = {name: units_of(model).of(known.unit, signal=name) for name, known in model.known.items()}
    if _grown(found, shown):
        told = [f"{gap.output} {_change(gap, units[gap.output])}" for gap in shown.gaps if gap.mode == STEADY]
        yield f"the held-out free run is not better, by its RMS error in steady operation ({', '.join(told)})"
    for gap in shown.gaps:
        if gap.mode != EDGE and gap.after.rms > max(WORSE * gap.before.rms, gap.expected):
            yield (f"the held-out free run of {gap.output} grows worse ({gap.mode}): {_change(gap, units[gap.output])}")
    for name, inside in zip(chosen.unknowns.parameters, chosen.inside.tolist(), strict=False):
        if not inside:
            yield f"{name} has run into its bound"
    nuisance = chosen.unknowns.nuisance(chosen.x)
    for what, of_each in (
        ("lag", {name: (s, model.lag_s(name)) for name, s in nuisance.lag.items()}),
        ("delay", {name: (s, DELAY * model.period_s) for name, s in nuisance.delay.items()}),
    ):
        for name, (seconds, usual) in of_each.items():
            if abs(seconds) > UNLIKELY * usual:
                yield f"the {what} of {name} has gone to {seconds:.2g} s, {usual:g} s is usual"


def _grown(found: Discovery, shown: Shown) -> bool:
    """True if the steady errors of the held-out free run have grown too much."""
    grown = np.log([gap.after.rms / gap.before.rms for gap in shown.gaps if gap.mode == STEADY])
    if not len(grown):
        return False
    foretold = found.outcome.chosen.predicted - found.outcome.nominal.predicted > FORETOLD
    allowed = -np.log(UNEVEN) if grown.max() > np.log(UNEVEN) else np.log(SLIGHT if foretold else GROWN)
    return bool(grown.mean() > allowed)


def _change(gap: Gap, shown: Display) -> str:
    before, after = (float(f"{error.rms / shown.size:.4g}") for error in (gap.before, gap.after))
    return f"{before:g} -> {after:g} {shown.unit}"
