"""Set thresholds and ranking evidence from fault-free recordings."""

import argparse
import hashlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.provenance import is_fitted, recordings_of, vehicle_of
from faultline.analysis.graph.runnable import Runnable, runnable_of
from faultline.analysis.model import dump_model
from faultline.analysis.progress import Progress
from faultline.analysis.recordings.modes import modes_of, stand_ins
from faultline.analysis.recordings.observe import start_within_s
from faultline.analysis.structure.lint import sound_model
from faultline.analysis.tuning.adapt import adapt, check_alike, golden
from faultline.analysis.tuning.claim import Found, claim, count, folds, thresholds, why_no_folds
from faultline.analysis.tuning.evidence import gather, with_networks, with_sigma
from faultline.analysis.tuning.few import static_rows
from faultline.analysis.tuning.file import SCHEMA, Tuning, model_digest
from faultline.analysis.tuning.kinds import LEVEL_KINDS, Kind
from faultline.analysis.tuning.known import known_of, statistics
from faultline.analysis.tuning.manifest import manifest_of
from faultline.analysis.tuning.moves import Moves
from faultline.analysis.tuning.numbers import widest
from faultline.analysis.tuning.plausible import doubts
from faultline.analysis.tuning.prior import Known
from faultline.analysis.tuning.target import Rule
from faultline.analysis.tuning.unfit import unfit
from faultline.analysis.tuning.vehicles import Vehicle, check_modes, offsets, pooled, pooled_left_out, read
from faultline.options import Parser
from faultline.service.core.detectors.kinds import brief
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Evidence
from faultline.writing import check_file, write_file

Array = npt.NDArray[np.float64]

EXAMPLE = """example:
  faultline tune calibrated.toml logs/bench-drive-s2 logs/bench-drive-s3 --out tuning.json
  faultline tune one.toml logs/one-a logs/one-b --also two.toml logs/two-a logs/two-b --target 0.2 --out tuning.json
  faultline tune this.toml logs/this-short --adapt tuning.json --out adapted.json
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    options = _parser().parse_args(argv)
    _check(options)
    runnable = _runnable(options.model, options.networks)
    also = [(_runnable(model, None), [Path(path) for path in paths]) for model, *paths in options.also]
    with Progress(f"tuning {runnable.bank.model.name}") as progress:
        for path in (options.model, *(path for path, *_ in options.also)):
            if (model := sound_model(path, formulas=False)).parameters and not is_fitted(model):
                progress.note(
                    f"{path}: calibrated on no recording: its residuals are off by as much as its parameters; give "
                    "the model that `faultline calibrate` wrote"
                )
        if options.adapt is not None:
            tuning = adapt(runnable, options.recording, options.adapt, progress)
        else:
            kinds: tuple[Kind, ...] = (options.detector, "spread") if options.spread else (options.detector,)
            given = Given(also=also, target=options.target, kinds=kinds, claim=True, fleet=options.fleet)
            tuning = tune(runnable, options.recording, progress, given)
    write_file(options.out, msgspec.json.encode(tuning))
    for line in runnable.bank.notes() if options.json else []:
        print(line, file=sys.stderr)
    print(msgspec.json.encode(tuning.detectors).decode() if options.json else _table(runnable, tuning, options.out))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        "faultline tune", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="the calibrated model file")
    parser.add_argument(
        "recording", type=Path, nargs="+", help="instrumented, fault-free, none that the model was made from"
    )
    parser.add_argument(
        "--also",
        nargs="+",
        action="append",
        default=[],
        metavar=("MODEL", "RECORDING"),
        help="another vehicle of the kind: its own calibrated model file and its fault-free recordings (repeatable)",
    )
    parser.add_argument(
        "--target", type=float, metavar="RATE", help="suspicions per hour without a fault (default: 0.1, by changes)"
    )
    parser.add_argument("--detector", choices=LEVEL_KINDS, default="cusum", help="what tests a level (default: cusum)")
    parser.add_argument("--spread", action="store_true", help="test the variance besides: it raises suspicion only")
    parser.add_argument(
        "--adapt",
        type=Path,
        metavar="BASE",
        help="keep this tuning of other vehicles, find this one's offsets and drifts only",
    )
    parser.add_argument(
        "--fleet",
        type=Path,
        metavar="FILE",
        help="what `faultline fleet tune` has learned of other vehicles: one drive of this one is enough",
    )
    parser.add_argument(
        "--networks", type=Path, metavar="DIR", help="networks besides, as `faultline train` wrote them"
    )
    parser.add_argument("--out", type=Path, required=True, help="where to write the tuning file")
    parser.add_argument("--json", action="store_true", help="print the detectors as JSON")
    return parser


def _check(options: argparse.Namespace) -> None:
    check_file(options.out)
    if options.target is not None and not 0.0 < options.target < np.inf:
        raise InputError(f"--target {options.target:g}: a rate is a positive number of suspicions per hour; give one")
    for also in options.also:
        if len(also) < 2:
            raise InputError(f"--also {also[0]}: no recording of that vehicle; give its model file and its drives")
    if options.also and options.networks:
        raise InputError("--also with --networks: networks are of one vehicle only; leave one of them out")
    if options.also and options.fleet:
        raise InputError("--also with --fleet: the fleet says what other vehicles show; leave one of them out")
    set_by_base = {
        "--also": options.also,
        "--fleet": options.fleet,
        "--target": options.target,
        "--spread": options.spread,
        "--networks": options.networks,
        "--detector": options.detector != "cusum",
    }
    if options.adapt is not None and (given := [name for name, value in set_by_base.items() if value]):
        raise InputError(f"--adapt with {given[0]}: the base says that; leave it out, or tune the base anew")


def _runnable(model: str, networks: Path | None) -> Runnable:
    return runnable_of(sound_model(model, formulas=networks is None), networks)


@dataclass(frozen=True)
class Given:
    """What may be asked of a tuning besides.

    Other vehicles with their recordings, a target of suspicions [1/h], the kinds of detectors, whether to count
    false alarms on drives left out, and the file of a fleet that says what to expect of the vehicle.
    """

    also: Sequence[tuple[Runnable, Sequence[Path]]] = ()
    target: float | None = None
    kinds: Sequence[Kind] = ("cusum",)
    claim: bool = False
    fleet: Path | None = None


def tune(runnable: Runnable, recordings: Sequence[Path], progress: Progress, given: Given = Given()) -> Tuning:
    """The tuning of generators from fault-free recordings.

    Ranking looks at the residuals of the model's equations only: what a fault does to them can be predicted. Networks
    that err too much on these drives are left out (`analysis.tuning.unfit`).

    Raises:
        InputError: a recording was used for calibration or training, is named twice or is of another vehicle, its
            tests could hardly ever tell, an operating mode is missing, or another vehicle's model has other tests.
    """
    vehicles = _vehicles(runnable, recordings, given.also, progress)
    if not (left_out := unfit(vehicles[0])):
        return tune_on(vehicles, given, progress)
    for name, why in left_out.items():
        progress.note(f"{name} is left out: {why}")
    vehicles = _vehicles(runnable.without(left_out), recordings, given.also, progress)
    whole = runnable.networks.description.graph_sha256 if runnable.networks else None
    return msgspec.structs.replace(tune_on(vehicles, given, progress), left_out=left_out, networks_sha256=whole)


def tune_on(vehicles: Sequence[Vehicle], given: Given, progress: Progress) -> Tuning:
    """The same of drives that have been read; ranking looks at few tests if drives left out have fewer false alarms."""
    tuning, bank = _tune_on(vehicles, given, progress), vehicles[0].runnable.bank
    if tuning.claim is None or _false(tuning) == (0, 0) or bank.has_equations or not static_rows(bank):
        return tuning
    few = _tune_on(vehicles, given, progress, few=True)
    return min(tuning, few, key=_false)


def _false(tuning: Tuning) -> tuple[int, int]:
    """False diagnoses and suspicions in the drives that were left out."""
    return (tuning.claim.diagnoses.count, tuning.claim.suspicions.count) if tuning.claim is not None else (0, 0)


def _tune_on(vehicles: Sequence[Vehicle], given: Given, progress: Progress, *, few: bool = False) -> Tuning:
    runnable = vehicles[0].runnable
    described = stand_ins(runnable.bank.model)
    to = offsets(vehicles[0].drives, described)
    known = None
    if given.fleet is not None:
        known = known_of(given.fleet, vehicles[0])
        to[: len(runnable.bank.generators)] = known.posterior.offset[list(described)].T
    rule = Rule(
        [g.name for g in runnable.generators],
        runnable.sigma,
        described,
        given.kinds,
        partial(_evidence, given, known, Moves(), few),
        known.prior if known else None,
    )
    left_out = folds(vehicles, described) if given.claim or given.target is not None else []
    if given.claim and not left_out:
        progress.note(why_no_folds(vehicles[0], described))
    progress.say("thresholds")
    found = thresholds(vehicles, left_out, rule, given.target, to)
    tuning = _tuning(vehicles, found.whole, to)
    if given.fleet is not None:
        tuning = msgspec.structs.replace(tuning, fleet=hashlib.sha256(given.fleet.read_bytes()).hexdigest())
    if not given.claim:
        return tuning
    manifests = []
    for fold, of_fold in zip(left_out, found.of_folds, strict=True):
        for doubt in doubts(fold, of_fold.evidence, rule.generators, described):
            progress.note(doubt)
        part = msgspec.structs.replace(tuning, detectors=of_fold.detectors, evidence=of_fold.evidence)
        manifests.append(manifest_of(runnable, part, {}, "none"))
    counts = count(left_out, manifests, to, progress.say)
    promised = claim(vehicles, left_out, counts, given.target, found.extrapolated)
    return msgspec.structs.replace(tuning, claim=promised)


def _vehicles(
    runnable: Runnable, recordings: Sequence[Path], also: Sequence[tuple[Runnable, Sequence[Path]]], progress: Progress
) -> list[Vehicle]:
    """All vehicles, this one first."""
    everything = [(runnable, recordings), *also]
    used = dict.fromkeys(runnable.trained_on, "to train the networks")
    for each, _ in everything:
        used |= dict.fromkeys(recordings_of(each.bank.model), "to make the model")
    vehicles: list[Vehicle] = []
    for index, (each, paths) in enumerate(everything):
        check_alike(runnable, each, f"--also {index}: {each.bank.model.name}")
        names = [name for name in (vehicle_of(v.runnable.bank.model) for v in vehicles) if name is not None]
        if (name := vehicle_of(each.bank.model)) in names:
            raise InputError(f"--also {index}: its model is of {name!r} again; name the drives of a vehicle together")
        vehicles.append(read(each, paths, used, progress))
        check_modes(vehicles[-1], stand_ins(each.bank.model))
        used |= {drive.sha256: "twice" for drive in vehicles[-1].drives}
    return vehicles


def _evidence(
    given: Given, known: Known | None, moves: Moves, few: bool, vehicles: Sequence[Vehicle], to: Array
) -> tuple[Evidence, list[float]]:
    """Evidence and sizes of drifts, by the equations of the first vehicle; its networks move with these."""
    runnable, bank = vehicles[0].runnable, vehicles[0].runnable.bank
    described, own = stand_ins(bank.model), len(bank.generators)
    everything, others = (together(vehicles, to, described) for together in (pooled, pooled_left_out))
    seen, apart = ([s.only(own) for s in each] for each in (everything, others))
    by_these = known.of(statistics(vehicles[0])) if known else None
    evidence, sizes = gather(bank, to[:own], seen, described, apart, by_these, moves, few=few)
    evidence = with_networks(evidence, runnable.generators, everything, to, runnable.sigma, described)
    trained = [each.name for each in runnable.networks.description.generators] if runnable.networks else []
    evidence = with_sigma(evidence, runnable.generators, trained, everything, described)
    if given.target is not None:
        evidence = msgspec.structs.replace(evidence, run_length_h=1.0 / given.target)
    return evidence, sizes


def _tuning(vehicles: Sequence[Vehicle], found: Found, to: Array) -> Tuning:
    """The tuning of the first vehicle."""
    runnable, bank = vehicles[0].runnable, vehicles[0].runnable.bank
    described = stand_ins(bank.model)
    zero = np.sqrt(np.mean([offsets(v.drives, described, to) ** 2 for v in vehicles], axis=0))
    return Tuning(
        schema=SCHEMA,
        model_sha256=model_digest(dump_model(bank.model)),
        recordings=[drive.sha256 for vehicle in vehicles for drive in vehicle.drives],
        calibrated=[sha256 for vehicle in vehicles for sha256 in recordings_of(vehicle.runnable.bank.model)],
        modes=modes_of(bank.model),
        period_s=bank.model.period_s,
        start_within_s=start_within_s(bank.model),
        detectors=found.detectors,
        evidence=found.evidence,
        drift_sizes=found.drift_sizes,
        inputs=widest([drive.inputs for vehicle in vehicles for drive in vehicle.drives]),
        zero=zero.tolist(),
        networks_sha256=runnable.networks.description.graph_sha256 if runnable.networks else None,
        golden_z=golden(vehicles[0].drives[0].seen),
        statistics=statistics(vehicles[0]),
    )


def _table(runnable: Runnable, tuning: Tuning, out: Path) -> str:
    units = {g.name: unit for g, unit in zip(runnable.generators, runnable.units, strict=True)}
    lines = [f"{'generator':<12}{'detector, nu, J':<26}   spread {' / '.join(tuning.modes.names)}"]
    lines += [
        f"{d.generator:<12}{brief(d)}   " + " / ".join(f"{s:.3g}" for s in d.scale) + f" {units[d.generator]}"
        for d in tuning.detectors
    ]
    lines += runnable.bank.notes()
    lines.append(f"ranking looks at {', '.join(tuning.evidence.generators)}: numerically independent")
    if tuning.claim is not None:
        lines.append(tuning.claim.said)
    elif tuning.base is not None:
        lines.append("false alarms: nothing is claimed of this vehicle: the base has no claim of several vehicles")
    lines.append(f"wrote {out}, from {len(tuning.recordings)} fault-free recordings")
    return "\n".join(lines)
