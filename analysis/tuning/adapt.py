"""A workshop's act: a tuning of reference vehicles is taken over for this one, which brings where its residuals lie.

Thresholds and how large drifts are come from the base; what a drift does to residuals from this vehicle's own model, as
hypotheses do. The offset of each residual without a fault, and how loud it is within a drive where that is more than
the base knows, come from a short fault-free drive of this vehicle. A fault that is
there already would be adapted away: so an offset is taken only where the reference vehicles make it plausible, and only
where the drive was long enough to know it.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.provenance import recordings_of
from faultline.analysis.graph.bank import Bank
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.model import dump_model
from faultline.analysis.progress import Progress
from faultline.analysis.recordings.modes import modes_of, stand_ins
from faultline.analysis.tuning.evidence import no_surer, with_drifts
from faultline.analysis.tuning.file import Tuning, load_tuning, model_digest
from faultline.analysis.tuning.numbers import widest
from faultline.analysis.tuning.plausible import PLAUSIBLE, of_baselines, of_means, steady
from faultline.analysis.tuning.statistics import of_drive
from faultline.analysis.tuning.thresholds import Seen, edge_last, more_of
from faultline.analysis.tuning.vehicles import Vehicle, offsets, read
from faultline.service.core.decision.consistency import of_evidence
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Detector, Evidence

Array = npt.NDArray[np.float64]

LEAST = 1.0  # settling times in a mode: some visits, or a visit in which all has settled
GOLDEN_TICKS = 150


def adapt(runnable: Runnable, recordings: Sequence[Path], path: Path, progress: Progress) -> Tuning:
    """The base tuning in the file at `path`, with the offsets that these recordings show.

    Raises:
        InputError: base and model have different tests or modes, a recording was used for either or is of another
            vehicle, a mode was not seen for long enough, or an offset looks like a fault.
    """
    base, bank = load_tuning(path), runnable.bank
    _check_base(base, runnable, path)
    calibrated = recordings_of(bank.model)
    if shared := set(calibrated) & set(base.recordings):
        raise InputError(
            f"{path}: its recording {min(shared)[:12]} has made the model; take a base without this vehicle's drives"
        )
    used = dict.fromkeys([*base.recordings, *base.calibrated], "in the base")
    used |= dict.fromkeys(calibrated, "to make the model")
    vehicle = read(runnable, recordings, used, progress)
    described = stand_ins(bank.model)
    _check_length(vehicle, described)
    found = offsets(vehicle.drives, described)
    evidence = with_drifts(base.evidence, base.drift_sizes or [], bank, [d.seen for d in vehicle.drives], described)
    base = msgspec.structs.replace(base, evidence=evidence)
    _check_plausible(vehicle, base, found, described, path)
    names = [generator.name for generator in bank.generators]
    detectors: list[Detector] = [
        msgspec.structs.replace(d, offset=found[names.index(d.generator)].tolist()) for d in base.detectors
    ]
    return msgspec.structs.replace(
        base,
        model_sha256=model_digest(dump_model(bank.model)),
        recordings=[*base.recordings, *(drive.sha256 for drive in vehicle.drives)],
        calibrated=[*base.calibrated, *calibrated],
        detectors=detectors,
        evidence=_evidence(base, detectors[: len(names)], bank, [drive.seen for drive in vehicle.drives]),
        inputs=widest([base.inputs, *(drive.inputs for drive in vehicle.drives)]),
        golden_z=golden(vehicle.drives[0].seen),
        statistics=[of_drive(drive.seen) for drive in vehicle.drives],
        base=hashlib.sha256(path.read_bytes()).hexdigest(),
        claim=base.claim if base.claim is not None and base.claim.vehicles > 1 else None,  # of drives it was else
    )


def golden(s: Seen) -> list[list[float]]:
    """Samples from where the tests begin to tell: before, the pump stands and a graph has little to compute."""
    first = int(np.argmax(s.usable.sum(axis=1)))  # as many as ever: some may still warm up
    return s.z[first : first + GOLDEN_TICKS].tolist()  # type: ignore[no-any-return]


def check_alike(runnable: Runnable, other: Runnable, where: str) -> None:
    """Raises InputError where two models do not have the same tests and operating modes."""
    if runnable.bank.generators != other.bank.generators:
        mine, others = ([g.name for g in each.bank.generators] for each in (runnable, other))
        differ = sorted({*mine} ^ {*others}) or list(mine)
        raise InputError(
            f"{where}: its tests are not those of {runnable.bank.model.name} ({', '.join(differ)}); "
            "give vehicles that were calibrated from the same model"
        )
    if modes_of(runnable.bank.model) != modes_of(other.bank.model):
        raise InputError(f"{where}: its operating modes are others; give vehicles calibrated from the same model")


def _check_base(base: Tuning, runnable: Runnable, path: Path) -> None:
    if base.networks_sha256 is not None:
        raise InputError(f"{path}: has networks, which are of one vehicle only; adapt a base without networks")
    names = [generator.name for generator in runnable.bank.generators]
    theirs = [detector.generator for detector in base.detectors[: len(names)]]
    if theirs != names or not {detector.generator for detector in base.detectors}.issubset(names):
        raise InputError(
            f"{path}: its tests are {', '.join(theirs)}, those of {runnable.bank.model.name} {', '.join(names)}; "
            "adapt a base of the same model"
        )
    problems = [*of_evidence(base.evidence, base.modes.names)]
    if not {*base.evidence.generators}.issubset(names) or [len(row) for row in base.zero] != [
        len(base.modes.names)
    ] * len(names):
        problems.append("its evidence or its offsets are not of these tests")
    if problems:
        raise InputError(f"{path}: damaged: {problems[0]}; run `faultline tune` for it again")
    if [channel.signal for channel in base.inputs] != [channel.signal for channel in runnable.bank.inputs]:
        raise InputError(f"{path}: its signals are not the model's; adapt a base of the same model")
    if base.modes != modes_of(runnable.bank.model) or base.period_s != runnable.bank.model.period_s:
        raise InputError(f"{path}: its operating modes or period are not the model's; adapt a base of the same model")
    if base.drift_sizes is None:
        raise InputError(f"{path}: does not say how large its drifts are; run `faultline tune` for it again")
    model = runnable.bank.model
    named = sum(bool(p.drift) for p in model.parameters.values()) + sum(bool(k.drift) for k in model.known.values())
    if len(base.drift_sizes) != named or named > len(base.evidence.drifts):
        raise InputError(f"{path}: its drifts are not the model's; adapt a base of the same model")


def _check_length(vehicle: Vehicle, described: Sequence[int]) -> None:
    names = ", ".join(drive.seen.name for drive in vehicle.drives)
    short, remedies, time = [], [], vehicle.drives[0].seen.time
    for mode in dict.fromkeys(stand_in for _, stand_in in edge_last(described)):
        ticks = sum(drive.seen.usable[drive.seen.mode == mode].all(axis=1).sum() for drive in vehicle.drives)
        if (seconds := float(ticks) * time.period_s) < LEAST * time.settling_s:
            short.append(f"{vehicle.drives[0].seen.modes[mode]!r} for {seconds:.0f} s")
            remedies.append(more_of(mode))
    if short:
        raise InputError(
            f"{names}: saw mode {', '.join(short)}, {LEAST * time.settling_s:.0f} s are needed; "
            f"add a fault-free drive {' and '.join(dict.fromkeys(remedies))}"
        )


def _check_plausible(vehicle: Vehicle, base: Tuning, found: Array, described: Sequence[int], path: Path) -> None:
    """A fault that is there already is not to become normal."""
    evidence = base.evidence
    names = [generator.name for generator in vehicle.runnable.bank.generators]
    rows = [names.index(name) for name in evidence.generators]
    for mode in steady(described):
        variance = np.array(base.zero)[rows, mode] ** 2 + of_baselines(evidence, mode)
        variance += of_means(evidence, mode, [drive.seen for drive in vehicle.drives])
        far = np.abs(found[rows, mode]) / np.sqrt(variance)
        worst = int(np.argmax(far))
        if far[worst] > PLAUSIBLE:
            drives = ", ".join(drive.seen.name for drive in vehicle.drives)
            raise InputError(
                f"{drives}: {evidence.generators[worst]} lies {found[rows[worst], mode]:.3g} off in mode "
                f"{vehicle.drives[0].seen.modes[mode]!r}, {far[worst]:.1f} standard deviations of what {path} makes "
                f"plausible ({PLAUSIBLE:.0f} are taken): a fault that is there would be adapted away; repair, or "
                "calibrate anew"
            )


def _evidence(base: Tuning, detectors: Sequence[Detector], bank: Bank, recordings: Sequence[Seen]) -> Evidence:
    """The base's evidence around this vehicle's offsets, and no surer than what its own drives show.

    A vehicle of which the model lacks something is louder within a drive than those of the base are.
    """
    offset_of = {detector.generator: detector.offset for detector in detectors}
    offset = np.array([offset_of[name] for name in base.evidence.generators]).T
    followers = [msgspec.structs.replace(f, offset=list(offset_of[f.generator])) for f in base.evidence.followers]
    moved = msgspec.structs.replace(base.evidence, offset=offset.tolist(), followers=followers)
    return no_surer(moved, bank, recordings, stand_ins(bank.model))
