"""Fit a model's parameters to fault-free recordings of one vehicle; 1 if the model does not describe them."""

import argparse
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from faultline.analysis.calibration.fit import Fit, fit, nuisances
from faultline.analysis.calibration.identify import identify
from faultline.analysis.calibration.problem import Nuisance
from faultline.analysis.calibration.provenance import check_id, check_vehicle, entry, vehicle_of
from faultline.analysis.calibration.pulses import pulses
from faultline.analysis.calibration.report import Report, draw, page, report, sentences
from faultline.analysis.calibration.sections import Section, cut, known_tracks
from faultline.analysis.calibration.validate import Validation, validate
from faultline.analysis.model import Model, dump_model
from faultline.analysis.progress import Progress
from faultline.analysis.recordings.check import findings
from faultline.analysis.recordings.observe import open_for
from faultline.analysis.recordings.track import Track
from faultline.analysis.simulation import system_of
from faultline.analysis.structure.lint import sound_model
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.service.logs import Log
from faultline.writing import check_file, check_folder, write_files

EXAMPLE = """example:
  faultline calibrate uds logs/bench-training-s1 --validate logs/bench-validation-s2 --out calibrated.toml --report out
"""

PICTURE = "free-run.png"


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser(
        "faultline calibrate", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="a model file, or the name of a shipped model")
    parser.add_argument("recording", type=Path, nargs="+", help="an instrumented, fault-free recording")
    parser.add_argument("--validate", type=Path, nargs="+", default=[], help="others, which the fit does not see")
    parser.add_argument("--out", type=Path, required=True, help="where to write the calibrated model file")
    parser.add_argument("--report", type=Path, help="folder for report.md, its picture and calibration.json")
    parser.add_argument("--beside", help="another calibrated model, drawn beside this one")
    parser.add_argument("--force", action="store_true", help="write it even if it does not describe the data")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    options = parser.parse_args(argv)
    check_file(options.out)
    if options.report:
        check_folder(options.report)
    model = sound_model(options.model)
    other = sound_model(options.beside) if options.beside else None
    with Progress(f"calibrating {model.name}") as progress:
        data = _Data(model, options.recording, options.validate, progress)
        beside = _Data(other, options.recording, options.validate, progress) if other else None
        result = fit(data.system, data.fitted, progress.say)
        calibrated = model.with_parameters(result.values, entry(data.logs, len(data.fitted)))
        progress.say("free runs")
        own = data.nuisances(result)
        runs = data.run(calibrated, own)
        told = report(model, data.vehicle, data.sources, result, identify(result), runs, data.misfits)
        text = dump_model(calibrated)
        good = options.force or not told.doubts
        files = {options.out: text.encode()} if good else {}
        if options.report:
            progress.say("report")
            drawn = {model.name: runs}
            if other and beside:  # what is of valve and sensors is not of a model
                drawn[other.name] = beside.run(other, own)
            told = msgspec.structs.replace(told, pulses=pulses(calibrated, data.logs[0]))
            files |= _report(told, model, drawn, options.report)
        write_files(files)
    if options.json:
        print(msgspec.json.encode(told).decode())
    else:
        print("\n".join(sentences(told, model.known)))
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        print(f"wrote {options.out} (sha256 {digest})" if good else f"{options.out} is not written (--force does)")
    return 0 if good else 1


class _Data:
    """The recordings' sections for a model's system, those to fit and the rest."""

    def __init__(self, model: Model, fitted: Sequence[Path], others: Sequence[Path], progress: Progress) -> None:
        if model.residuals:
            raise InputError(
                f"{model.name}: residuals of another tool have no parameters; `faultline tune` takes it as it is"
            )
        if not model.calibrated:
            raise InputError(f"{model.name}: no parameter has a prior; give `prior` to those that shall be calibrated")
        self.system = system_of(model, model.varying)
        self.logs: list[Log] = []
        tracks: dict[str, tuple[Path, dict[str, Track]]] = {}
        for path in (*fitted, *others):
            progress.say(str(path))
            log = open_for(model, path, progress.note)
            if log.drive in (other.drive for other in self.logs):
                raise InputError(f"{path}: this recording is given twice; validate on recordings that are not fitted")
            check_id(log, path, tracks)
            self.logs.append(log)
            check_vehicle(log, path, self.vehicle, str(fitted[0]))
            check_vehicle(log, path, vehicle_of(model), f"the calibration of {model.name}")
            table = log.table({name: known.unit for name, known in model.known.items()}, str(path))
            tracks[log.id] = path, known_tracks(model, log.signals(table), str(path))
        self.sources = sorted({log.recording.source for log in self.logs if log.recording})
        self.misfits = [each.text for each in findings(model, [each for _, each in tracks.values()])]
        for text in self.misfits:
            progress.note(f"{model.name}: {text}")
        self._found: dict[str, list[Section]] = {
            name: cut(model, self.system, each, str(path)) for name, (path, each) in tracks.items()
        }
        del self.logs[len(fitted) :]
        self.fitted = [section for log in self.logs for section in self._found[log.id]]

    @property
    def vehicle(self) -> str | None:
        """The vehicle of the first recording."""
        return self.logs[0].recording.vehicle if self.logs[0].recording else None

    def nuisances(self, found: Fit) -> dict[str, list[Nuisance]]:
        """What is of every recording's own day, sensors and clocks."""
        return {name: nuisances(found, sections) for name, sections in self._found.items()}

    def run(self, model: Model, own: Mapping[str, Sequence[Nuisance]]) -> dict[str, Validation]:
        """The free runs of a calibrated model over every recording."""
        values = {name: model.parameters[name].value for name in self.system.parameters}
        return {name: validate(self.system, found, values, own[name]) for name, found in self._found.items()}


def _report(told: Report, model: Model, drawn: dict[str, dict[str, Validation]], folder: Path) -> dict[Path, bytes]:
    """Content of the report's files."""
    by_recording = {r: {name: runs[r] for name, runs in drawn.items()} for r in drawn[model.name]}
    return {
        folder / PICTURE: draw(told, model, by_recording),
        folder / "report.md": page(told, model.known, PICTURE).encode(),
        folder / "calibration.json": msgspec.json.format(msgspec.json.encode(told)) + b"\n",
    }
