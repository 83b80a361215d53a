"""`OUT/fleet.json` holds what a fleet's tunings say of another vehicle: statistics are added, logs never held."""

from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec

from faultline.analysis.recordings.modes import time_of
from faultline.analysis.structure.lint import sound_model
from faultline.analysis.tuning.file import Tuning, load_tuning
from faultline.analysis.tuning.prior import Prior, pooled
from faultline.service.core.errors import InputError
from faultline.writing import write_file

FILE = "fleet.json"


def pool(tuned: Mapping[str, Path], model: str, out: Path, note: Callable[[str], None]) -> str:
    """Write what these tunings, by vehicle, say of another one; return a sentence.

    `model` is a vehicle's model file, for its time scale. A vehicle that was tuned with a fleet or a base itself has no
    part in it, as its thresholds are theirs.
    """
    own: dict[str, Tuning] = {}
    for vehicle, path in tuned.items():
        tuning = load_tuning(path)
        if tuning.fleet is None and tuning.base is None:
            own[vehicle] = tuning
    left_out = len(tuned) - len(own)
    if left_out:
        note(f"{left_out} vehicles were tuned with a fleet or a base: they have no part in {FILE}")
    if not own:
        return f"no {FILE}"
    try:
        prior = pooled(own, time_of(sound_model(model, formulas=False)))
    except InputError as error:
        return f"no {FILE}: {error}"
    write_file(out / FILE, msgspec.json.encode(prior))
    return said(prior, out / FILE)


def said(prior: Prior, path: Path) -> str:
    """Return what is in it, as a sentence."""
    return (
        f"{path}: {prior.vehicles} vehicles, {prior.drives} drives, {prior.hours:.1f} h; "
        f"`faultline tune MODEL DRIVE --fleet {path}` tunes another vehicle with one drive"
    )
