"""The tuning file: what `faultline tune` finds and `faultline export` builds in."""

import hashlib
from pathlib import Path

import msgspec

from faultline.analysis.tuning.statistics import OfDrive
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Claim, Detector, Evidence, Input, Modes, PerMode

SCHEMA = "faultline.tuning/6"


class Tuning(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Detectors and evidence of one calibrated model, and of the networks beside it if there are any.

    `model_sha256` is that of the model file, `networks_sha256` that of the networks' graph, `recordings` those of the
    drives used (`Log.drive`), `calibrated` those that made the models of all vehicles, `golden_z` (K, nz) samples from
    the beginning of the first of the logs, `period_s` [s] apart. `inputs` have the limits of what is believed of a
    sensor (`analysis.tuning.numbers`). `zero` (T, modes) [unit of r] is how far from zero the vehicles' offsets lie,
    root mean square; `base` the SHA-256 of the tuning that this one was adapted from. `drift_sizes` are those of
    the first drifts of the evidence, which the model names, in parts of what it says. `left_out` are networks that
    have no part in it, with the reason (`analysis.tuning.unfit`). `statistics` are what this vehicle's drives show,
    for a fleet to be pooled from; `fleet` is the SHA-256 of the fleet's file that it was tuned with.
    """

    schema: str
    model_sha256: str
    recordings: list[str]
    calibrated: list[str]
    modes: Modes
    period_s: float
    start_within_s: float
    detectors: list[Detector]
    evidence: Evidence
    inputs: list[Input]
    golden_z: list[list[float]]
    zero: list[PerMode[float]]
    networks_sha256: str | None = None
    claim: Claim | None = None
    base: str | None = None
    drift_sizes: list[float] | None = None
    left_out: dict[str, str] = {}
    statistics: list[OfDrive] = []
    fleet: str | None = None


def model_digest(text: str) -> str:
    """The SHA-256 by which tuning and bundle know the model file."""
    return hashlib.sha256(text.encode()).hexdigest()


def load_tuning(path: Path) -> Tuning:
    """The tuning in a file.

    Raises:
        InputError: the file is absent, or not a tuning of this version.
    """
    if not path.is_file():
        raise InputError(f"{path}: not found; `faultline tune` writes it")
    try:
        tuning = msgspec.json.decode(path.read_bytes(), type=Tuning)
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: not a tuning file: {error}; run `faultline tune` again") from error
    if tuning.schema != SCHEMA:
        raise InputError(f"{path}: schema: this is {tuning.schema!r}, wanted is {SCHEMA!r}; run `faultline tune` again")
    return tuning
