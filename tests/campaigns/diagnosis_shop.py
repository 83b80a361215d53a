"""A vehicle's workshop: from fault-free recordings to its bundle, and what that bundle then tells of other drives."""

import io
import json
import shutil
from collections.abc import Iterable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import diagnosis_plants
import numpy as np
from diagnosis_cases import PLANTS, Case, Set, request, seed_of

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.compiled.decision import NATIVE
from faultline.analysis.compiled.evaluator import CompiledEvaluator, kernels_of_bundle
from faultline.analysis.export import main as export
from faultline.analysis.tuning.command import main as tune
from faultline.service.bundle.load import Bundle, load_bundle
from faultline.service.core.decision.decision import Decision
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Diagnosis, Event
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.columns import CanSignals
from faultline.service.logs.batch import batch_of
from faultline.service.logs.report import Frame as LogFrame
from faultline.testbench.bus import load_dbc
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.simulation import Run, simulate
from faultline.testbench.traffic import Frame, frames

Record = dict[str, Any]

DOUBT = "the model does NOT describe these data: "

TRAINING_S, TUNING_S = 600.0, 600.0
TUNING = (2, 3)
"""The drives that a workshop makes besides the one that calibrates."""


@dataclass(frozen=True)
class Workshop:
    """A vehicle's recordings and its bundle, in a folder of its own.

    `base` is the tuning of other vehicles that this one's is adapted from (`diagnosis_reference`); None tunes it anew.
    `training_s` [s] is how long the recording is that calibrates, and that networks are trained with.
    """

    number: int
    effects_set: Set
    folder: Path
    base: Path | None = None
    training_s: float = TRAINING_S

    def made(self, cycle: str, k: int, seconds: float) -> Path:
        """A fault-free recording of the vehicle, on a day of its own."""
        if self.number in PLANTS:
            name = f"{cycle}-{k}"
            return diagnosis_plants.recorded(self.number, name, seed_of(self.number, k), seconds, self.folder / "logs")
        wanted = request(self.number, self.effects_set, cycle, seed_of(self.number, k), seconds)
        where = self.folder / "logs", self.folder / "truth"
        return record(wanted, load_dbc(), *where, force=True, progress=lambda _: None)[0]

    def bundle(self) -> Bundle:
        """What the vehicle runs; made once for a folder."""
        out = self.folder / "bundle"
        if not out.exists():
            model, training = self.calibrated()
            drives = [self.made("drive", k, TUNING_S) for k in TUNING]
            tuned = self.folder / "tuning.json"
            code, told = tuning(model, drives, tuned, self.base)
            if self.number in PLANTS and diagnosis_plants.with_edges(self.folder / "sheet.toml", told):
                for old in (model, tuned):
                    old.unlink(missing_ok=True)
                model, training = self.calibrated()
                code, told = tuning(model, drives, tuned, self.base)
            if code:
                raise InputError(told.splitlines()[-1])
            dbc = str(training / "uds.dbc")
            must(export, [str(model), "--tuning", str(tuned), "--dbc", dbc, "--out", str(out)])
            for folder in ("logs", "truth"):
                shutil.rmtree(self.folder / folder, ignore_errors=True)
        return load_bundle(out)

    def calibrated(self) -> tuple[Path, Path]:
        """The model file, and the recording that it was calibrated on."""
        training = self.made("training", 1, self.training_s)
        model = self.folder / "model.toml"
        given = "uds"
        if self.number in PLANTS:
            sheet = self.folder / "sheet.toml"
            given = str(sheet if sheet.exists() else diagnosis_plants.sheet(self.number, sheet))
        words = [given, str(training), "--out", str(model)]
        code, told = quietly(calibrate, words)
        if self.number in PLANTS and diagnosis_plants.with_edges(Path(given), told):
            model.unlink(missing_ok=True)
            code, told = quietly(calibrate, words)
        if code:  # it doubts that the model describes the vehicle: hidden effects and days do that, and it must run
            self._doubts.write_text("\n".join(line for line in told.splitlines() if line.startswith(DOUBT)))
            must(calibrate, [*words, "--force"])
        return model, training

    @property
    def claim(self) -> str:
        """What the tuning says of its false alarms; a tuning that claims nothing has none in its own drives."""
        told = json.loads((self.folder / "tuning.json").read_text()).get("claim")
        return told["said"] if told else f"none in the {len(TUNING)} drives of {TUNING_S:.0f} s that it was tuned on"

    @property
    def doubts(self) -> list[str]:
        """Why calibration would rather not have written the model; known once there is a bundle."""
        return self._doubts.read_text().splitlines() if self._doubts.exists() else []

    @property
    def _doubts(self) -> Path:
        return self.folder / "doubts.txt"


def tuning(model: Path, drives: Sequence[Path], out: Path, base: Path | None) -> tuple[int, str]:
    """The vehicle's thresholds, as its workshop sets them: the one place that says how. Code and what was said."""
    adapted = [] if base is None else ["--adapt", str(base)]
    return quietly(tune, [str(model), *map(str, drives), *adapted, "--out", str(out)])


def must(command: Any, words: list[str]) -> None:
    """Runs a command that must succeed."""
    code, told = quietly(command, words)
    if code:
        raise RuntimeError(told)


def quietly(command: Any, words: list[str]) -> tuple[int, str]:
    """A command's exit code and what it said."""
    with redirect_stdout(io.StringIO()) as told, redirect_stderr(told):
        code: int = command(words)
    return code, told.getvalue()


@dataclass(frozen=True)
class Watched:
    """What a vehicle saw and told: events with their log times, and by tick (K,) what rivals are given as well.

    `t` (K,) [s] log time, `z` (K, nz) samples, `r` (K, T) residuals, `usable` (K, T), `mode` (K,). `dosing` (K,) says
    where the dose was above idle: operation that excites. `alarms` are the tests' alarms as (log time [s], test),
    `blind` (K,) the share of tests that could not tell.
    """

    events: list[tuple[float, Event]]
    alarms: list[tuple[float, str]]
    blind: np.ndarray[tuple[int], np.dtype[np.float64]]
    t: np.ndarray[tuple[int], np.dtype[np.float64]]
    z: np.ndarray[tuple[int, int], np.dtype[np.float64]]
    r: np.ndarray[tuple[int, int], np.dtype[np.float64]]
    usable: np.ndarray[tuple[int, int], np.dtype[np.bool_]]
    mode: np.ndarray[tuple[int], np.dtype[np.int64]]
    dosing: np.ndarray[tuple[int], np.dtype[np.bool_]]

    def save(self, path: Path) -> None:
        """Keeps the series, in single precision."""
        path.parent.mkdir(parents=True, exist_ok=True)
        z, r = self.z.astype(np.float32), self.r.astype(np.float32)
        np.savez_compressed(path, t=self.t, z=z, r=r, usable=self.usable, mode=self.mode, dosing=self.dosing)


def run_of(asked: Request) -> Run:
    """The rig's run of a request."""
    vehicle, cycle, faults = asked.vehicle, asked.cycle, asked.faults
    return simulate(vehicle, cycle, faults, asked.seed, asked.duration, effects=asked.effects, day=asked.day)


def sent(case: Case) -> Iterable[Frame]:
    """The frames of a case's drive."""
    if case.number in PLANTS:
        return diagnosis_plants.frames_of(case)
    return frames(case.request, load_dbc(), [run_of(case.request)])


def watched(bundle: Bundle, name: str, drive: Iterable[Frame], native: bool = False) -> Watched:
    """What the vehicle's monitor makes of a log of these frames, without writing one.

    The decision's costly parts are native code, and with `native` the residuals, which networks' are not: events are
    the same.
    """
    manifest, ticks, blind = bundle.manifest, [], []
    alarms: list[tuple[float, str]] = []
    standing: set[str] = set()

    def watch(tick: Tick, decision: Decision) -> None:
        now = set(decision.alarm)
        alarms.extend((tick.t_s, test) for test in sorted(now - standing))
        standing.clear()
        standing.update(now)
        blind.append(len(decision.cannot_tell))
        ticks.append(tick)

    evaluator = CompiledEvaluator(manifest, kernels_of_bundle(bundle)) if native else bundle.bank()
    monitor = Monitor(manifest, evaluator, bundle.table, name, bundle.id, watch, parts=NATIVE)
    batch = batch_of(LogFrame(f.t, f.frame_id, True, f.data) for f in drive)
    told = list(monitor.signals(CanSignals(bundle.table, lambda: iter([batch]))))
    origin_s = ticks[0].t_s
    dose = [channel.signal for channel in manifest.inputs].index("dc_dose")
    z = np.array([tick.z for tick in ticks])
    return Watched(
        events=[(origin_s + event.t_s, event) for event in told],
        alarms=alarms,
        blind=np.array(blind) / len({generator.test for generator in manifest.generators}),
        t=np.array([tick.t_s for tick in ticks]),
        z=z,
        r=np.array([tick.residuals.r for tick in ticks]),
        usable=np.array([tick.residuals.usable for tick in ticks]),
        mode=np.array([tick.mode for tick in ticks]),
        dosing=z[:, dose] >= 0.02,
    )


def said(diagnosis: Diagnosis) -> list[Any]:
    """A diagnosis as a row of the records (`diagnosis_judged.Said`)."""
    name = "+".join(diagnosis.faults) or "unknown"
    sizes = [[size.low, size.high, size.unit] for size in diagnosis.sizes]
    return [name, diagnosis.rank, diagnosis.p, [*diagnosis.near], sizes]


def told_of(case: Case, seen: Watched, period_s: float) -> Record:
    """What is kept of a judged recording: who told what when; what it means is `diagnosis_judged`'s matter.

    Of each event: log time [s], exciting operation since the onset [s], transition, diagnoses as `said`.
    """
    onset = case.onset_s if case.faults else case.seconds
    exciting = period_s * np.cumsum(seen.dosing & (seen.t >= onset))
    there = seen.t >= onset

    def row(t: float, event: Event) -> list[Any]:
        since = exciting[max(int(np.searchsorted(seen.t, t, side="right")) - 1, 0)]
        return [round(t, 1), round(float(since), 1), event.transition, [said(d) for d in event.diagnoses]]

    return {
        "case": case.name,
        "kind": case.kind,
        "label": case.label,
        "faults": dict(case.faults),
        "onset_s": case.onset_s if case.faults else None,
        "seconds": case.seconds,
        "exciting_s": round(float(exciting[-1]), 1),
        "cannot_tell": round(float(seen.blind[there].mean()) if there.any() else float(seen.blind.mean()), 4),
        "alarms": [[round(t, 1), test] for t, test in seen.alarms if t < onset],
        "events": [row(t, event) for t, event in seen.events if event.transition != "cannot_tell"],
    }
