"""A vehicle by its own drives and what a fleet teaches; a drive with a fault in it is not to become normal."""

from pathlib import Path

import numpy as np

from faultline.analysis.recordings.modes import modes_of, stand_ins
from faultline.analysis.tuning.evidence import named_drifts
from faultline.analysis.tuning.moves import Moves
from faultline.analysis.tuning.plausible import PLAUSIBLE, steady
from faultline.analysis.tuning.prior import Known, load_prior, posterior
from faultline.analysis.tuning.statistics import OfDrive, of_drive
from faultline.analysis.tuning.vehicles import Vehicle
from faultline.service.core.errors import InputError


def statistics(vehicle: Vehicle) -> list[OfDrive]:
    """Return those of the vehicle's drives, by the equations' generators."""
    return [of_drive(drive.seen.only(len(vehicle.runnable.bank.generators))) for drive in vehicle.drives]


def known_of(path: Path, vehicle: Vehicle) -> Known:
    """Return what the fleet in a file and the vehicle's drives say of it.

    Raises:
        InputError: there is no such file, it is of other tests or modes or made with this vehicle's recordings, or the
            drives are implausible of a vehicle without a fault.
    """
    prior, bank = load_prior(path), vehicle.runnable.bank
    if prior.generators != [generator.name for generator in bank.generators]:
        raise InputError(
            f"{path}: its tests are {', '.join(prior.generators)}, not those of {bank.model.name}; "
            "give the fleet of the same model"
        )
    if prior.modes != modes_of(bank.model) or prior.period_s != bank.model.period_s:
        raise InputError(f"{path}: its modes or its period are not those of {bank.model.name}; give its own fleet")
    for drive in vehicle.drives:
        if drive.sha256 in prior.recordings:
            raise InputError(f"{drive.seen.name}: the fleet in {path} has seen it; give a drive that it has not")
    described = stand_ins(bank.model)
    named = named_drifts(bank, [drive.seen for drive in vehicle.drives], described, Moves())
    found = posterior(prior, statistics(vehicle), named)
    far = np.where(np.isin(np.arange(len(found.far)), steady(described))[:, None], found.far, 0.0)
    mode, worst = np.unravel_index(int(far.argmax()), far.shape)
    if far[mode, worst] > PLAUSIBLE:
        raise InputError(
            f"{', '.join(drive.seen.name for drive in vehicle.drives)}: {prior.generators[worst]} lies "
            f"{far[mode, worst]:.1f} standard deviations from the fleet in mode {prior.modes.names[mode]!r} "
            f"({PLAUSIBLE:.0f} are taken): a fault that is there would become normal; repair, or calibrate anew"
        )
    return Known(prior, named, found)
