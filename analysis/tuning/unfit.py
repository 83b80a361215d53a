"""Networks that are left out: on drives that no training saw they err more than their equations, or run away.

Judged is the RMS of each residual over the drives, in all modes but the edge. Beside the equations it is that less the
mean of each drive: where a drive lies the decision's baseline takes off, of both kinds alike.
"""

import numpy as np
import numpy.typing as npt

from faultline.analysis.tuning.vehicles import Vehicle
from faultline.service.core.signals.modes import EDGE

Array = npt.NDArray[np.float64]

OUTDONE = 1.3
"""Times the error of the same test's equations beyond which a network only adds noise."""
AWAY = 10.0
"""Times the error where it was held out in training, beyond which a network has left what it was trained for: more
than drives are apart."""


def errors(vehicle: Vehicle, *, centred: bool) -> Array:
    """The RMS (T,) of each generator's residual, as above; infinite where it is no number, NaN where it never tells."""
    square, count = np.zeros((2, len(vehicle.runnable.generators)))
    for drive in vehicle.drives:
        inside = drive.seen.usable & (drive.seen.mode != EDGE)[:, None]
        ticks = inside.sum(axis=0)
        r = np.where(inside, drive.seen.r, 0.0)
        with np.errstate(all="ignore"):
            mean = r.sum(axis=0) / ticks if centred else 0.0
            square += np.where(ticks > 0, (np.where(inside, r - mean, 0.0) ** 2).sum(axis=0), 0.0)
        count += ticks
    with np.errstate(all="ignore"):
        found = np.sqrt(square / count)
    return np.asarray(np.where((count > 0) & np.isnan(found), np.inf, found))


def unfit(vehicle: Vehicle) -> dict[str, str]:
    """The networks to leave out, with the reason; none where there are none."""
    runnable = vehicle.runnable
    if runnable.networks is None:
        return {}
    raw, within = errors(vehicle, centred=False), errors(vehicle, centred=True)
    description = runnable.networks.description
    promised = dict(zip((g.name for g in description.generators), description.error, strict=True))
    names = [generator.name for generator in runnable.generators]
    equations = {runnable.generators[k].test: within[k] for k, name in enumerate(names) if name not in promised}
    found = {}
    for k, name in enumerate(names):
        beside = equations.get(runnable.generators[k].test, np.inf)
        if name not in promised or np.isnan(raw[k]):
            continue
        if not raw[k] <= AWAY * promised[name]:
            found[name] = (
                f"off by {raw[k]:.3g} {runnable.units[k]} (RMS) in these drives, by {promised[name]:.3g} where it was "
                "held out in training: it runs away"
            )
        elif within[k] > OUTDONE * beside:
            found[name] = (
                f"off by {within[k]:.3g} {runnable.units[k]} (RMS within a drive), {within[k] / beside:.1f} times as "
                "much as the equations"
            )
    return found
