"""Set thresholds and ranking evidence from fault-free recordings."""

import argparse
from pathlib import Path

import msgspec
import numpy as np

from analysis.calibration.provenance import check_vehicle, recordings_of, vehicle_of
from analysis.graph.bank import build_bank
from analysis.graph.networks import load_networks
from analysis.graph.runnable import Runnable
from analysis.model import dump_model
from analysis.progress import Progress
from analysis.recordings.modes import modes_of, stand_ins
from analysis.recordings.observe import START_WITHIN_S, open_known, ticks_of
from analysis.structure.lint import sound_model
from analysis.tuning.evidence import gather
from analysis.tuning.file import SCHEMA, Tuning, model_digest
from analysis.tuning.thresholds import Seen, seen, tune_detectors
from service.core.decode import compile_dbc
from service.core.errors import InputError
from service.core.manifest import brief

GOLDEN_TICKS = 150

EXAMPLE = """example:
  faultline tune calibrated.toml logs/bench-drive-s2 logs/bench-drive-s3 --out tuning.json
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        "faultline tune", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="the calibrated model file")
    parser.add_argument(
        "recording", type=Path, nargs="+", help="instrumented, fault-free, none that the model was made from"
    )
    parser.add_argument(
        "--networks", type=Path, metavar="DIR", help="networks besides, as `faultline train` wrote them"
    )
    parser.add_argument("--out", type=Path, required=True, help="where to write the tuning file")
    parser.add_argument("--json", action="store_true", help="print the detectors as JSON")
    options = parser.parse_args(argv)
    bank = build_bank(sound_model(options.model))
    runnable = Runnable(bank, load_networks(options.networks, bank.model) if options.networks else None)
    with Progress(f"tuning {bank.model.name}") as progress:
        tuning = tune(runnable, options.recording, progress)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_bytes(msgspec.json.encode(tuning))
    print(msgspec.json.encode(tuning.detectors).decode() if options.json else _table(runnable, tuning, options.out))
    return 0


def tune(runnable: Runnable, recordings: list[Path], progress: Progress) -> Tuning:
    """The tuning of generators from fault-free recordings.

    Ranking looks at the residuals of the model's equations only: what a fault does to them can be predicted.

    Raises:
        InputError: a recording was used for calibration or training, is named twice or is of another vehicle, its
            tests could hardly ever tell, or an operating mode is missing.
    """
    bank = runnable.bank
    calibrated, trained = recordings_of(bank.model), runnable.trained_on
    units = {channel.signal: channel.unit for channel in bank.inputs}
    watched: list[Seen] = []
    digests: list[str] = []
    for path in recordings:
        log = open_known(path, progress.note)
        used = {"to make the model": calibrated, "to train the networks": trained, "twice": digests}
        if (how := next((how for how, known in used.items() if log.sha256 in known), None)) is not None:
            raise InputError(f"{path}: this recording is used {how}; tune on fault-free recordings of their own")
        check_vehicle(log, path, vehicle_of(bank.model), f"the calibration of {bank.model.name}")
        if runnable.networks:
            check_vehicle(log, path, runnable.networks.description.vehicle, "the training of the networks")
        progress.say(log.id)
        table = compile_dbc(log.dbc, units, str(path))
        ticks = ticks_of(bank.model, bank.inputs, table, log.relative(), runnable.fresh())
        watched.append(seen(log.id, ticks))
        digests.append(log.sha256)
    described = stand_ins(bank.model)
    detectors = tune_detectors([g.name for g in runnable.generators], watched, runnable.sigma, described)
    own = len(bank.generators)
    progress.say("fault hypotheses")
    return Tuning(
        schema=SCHEMA,
        model_sha256=model_digest(dump_model(bank.model)),
        recordings=digests,
        modes=modes_of(bank.model),
        start_within_s=START_WITHIN_S,
        sensor_set="instrumented",
        detectors=detectors,
        evidence=gather(bank, detectors[:own], [s.only(own) for s in watched], described),
        networks_sha256=runnable.networks.description.graph_sha256 if runnable.networks else None,
        golden_z=_golden(watched[0]),
    )


def _golden(s: Seen) -> list[list[float]]:
    """Samples from where the tests begin to tell: before, the pump stands and a graph has little to compute."""
    first = int(np.argmax(s.usable.sum(axis=1)))  # as many as ever: networks may find some operation novel
    return s.z[first : first + GOLDEN_TICKS].tolist()  # type: ignore[no-any-return]


def _table(runnable: Runnable, tuning: Tuning, out: Path) -> str:
    units = {g.name: unit for g, unit in zip(runnable.generators, runnable.units, strict=True)}
    lines = [f"{'generator':<12}{'detector, nu, J':<26}   spread idle / partial / maximum / edge"]
    lines += [
        f"{d.generator:<12}{brief(d)}   " + " / ".join(f"{s:.3g}" for s in d.scale) + f" {units[d.generator]}"
        for d in tuning.detectors
    ]
    lines.append(f"ranking looks at {', '.join(tuning.evidence.generators)}: numerically independent")
    lines.append(f"wrote {out}, from {len(tuning.recordings)} fault-free recordings")
    return "\n".join(lines)
