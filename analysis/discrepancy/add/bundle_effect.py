"""What added effects do to the bundle: both models' tests tuned, exported and judged on the same recordings.

A test tolerates a lasting deviation of nu spreads of its residual. A model that knows the vehicle better leaves less of
it, so its tests tolerate less: smaller faults are seen, and what the model does not know raises no alarm.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from tempfile import TemporaryDirectory

from faultline.analysis.calibration.provenance import check_vehicle
from faultline.analysis.evaluation.judge import Verdict, judge
from faultline.analysis.evaluation.story import tell
from faultline.analysis.evaluation.truth import Truth, load_truth
from faultline.analysis.export import bundle_files
from faultline.analysis.graph.bank import build_bank
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.model import Model
from faultline.analysis.progress import Progress
from faultline.analysis.recordings.observe import open_known
from faultline.analysis.tuning.command import tune
from faultline.service.bundle.load import Bundle, load_bundle, verify_golden
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import CusumDetector, Generator
from faultline.service.core.signals.dbc import NO_BUSES
from faultline.service.core.signals.modes import EDGE
from faultline.service.logs import Log

ALIKE = 0.1
"""A test that tolerates up to so much more or less than it did, of that, tolerates as much."""


@dataclass(frozen=True)
class Judged:
    """A recording's verdict, and for how long it was fault-free [h]; `assumed` if no truth says so."""

    verdict: Verdict
    hours: float
    assumed: bool


@dataclass(frozen=True)
class Bundled:
    """A model's bundle: its generators, what each tolerates [unit of its signal], and its verdicts by recording.

    `reason` says why there is no bundle; None if there is one.
    """

    generators: tuple[Generator, ...] = ()
    tolerated: tuple[float, ...] = ()
    judged: Mapping[str, Judged] = field(default_factory=dict)
    reason: str | None = None

    @property
    def false_alarms(self) -> int:
        """In all recordings, before the faults."""
        return sum(judged.verdict.false_alarms for judged in self.judged.values())

    @property
    def hours(self) -> float:
        """Without a fault, over all recordings."""
        return sum(judged.hours for judged in self.judged.values())

    @property
    def sentence(self) -> str:
        """The bundle in a line."""
        if self.reason is not None:
            return f"there is no bundle: {self.reason}"
        found = f"{len(self.generators)} generators"
        if self.judged:
            found += f", {self.false_alarms} false alarms in {60.0 * self.hours:.3g} min without a fault"
        taken = [name for name, judged in self.judged.items() if judged.assumed]
        return f"{found} ({', '.join(taken)} taken as fault-free: no truth was given)" if taken else found


@dataclass(frozen=True)
class BundleEffect:
    """The bundles of the model before and after the effects were added."""

    before: Bundled
    after: Bundled

    @property
    def tolerances(self) -> dict[str, float]:
        """What every test with the same faults before and after tolerates now, as a fraction of before."""
        was = {(g.test, *g.faults): t for g, t in zip(self.before.generators, self.before.tolerated, strict=True)}
        now = {(g.test, *g.faults): t for g, t in zip(self.after.generators, self.after.tolerated, strict=True)}
        return {key[0]: now[key] / was[key] for key in was if key in now}

    def sentences(self) -> list[str]:
        """Both bundles in words, and what has changed."""
        found = [f"without the effect: {self.before.sentence}", f"with it: {self.after.sentence}"]
        if shares := self.tolerances:
            moved = sorted((test for test in shares if abs(shares[test] - 1.0) > ALIKE), key=lambda test: shares[test])
            told = [f"{test} {shares[test]:.2g} times" for test in moved]
            if len(moved) < len(shares):
                told.append("the others" if moved else "all tests")
            found.append(f"lasting deviation that is tolerated: {', '.join(told)} as much as before")
        for name, judged in self.before.judged.items():
            if name in self.after.judged and judged.verdict.faults:
                was, now = judged.verdict, self.after.judged[name].verdict
                found.append(f"{name}, {', '.join(was.faults)}: {_told(was)} without the effect, {_told(now)} with it")
        return found


@dataclass(frozen=True)
class Trial:
    """Recordings by which bundles are made and judged: fault-free recordings to tune on, and logs with their truths.

    `dbc`, `senders` and the DBC's names of `signals` are those of the first recording.
    """

    tuning: tuple[Path, ...]
    dbc: Path
    senders: Mapping[str, int]
    signals: Mapping[str, str]
    judged: tuple[tuple[Log, Truth | None], ...]


def trial(
    used: Mapping[str, str],
    tuning: Sequence[Path],
    evaluation: Sequence[tuple[Path, Path | None]],
    note: Callable[[str], None],
    vehicle: str | None = None,
) -> Trial:
    """The recordings read; `used` says what those with these SHA-256 were used for, `vehicle` whose model it is.

    A recording without a truth is taken as fault-free.

    Raises:
        InputError: a recording or truth cannot be read, a recording was used before, for tuning, or twice, one to tune
            on is of another vehicle, or one to evaluate on has another DBC than those.
    """
    taken, first, judged = dict(used), None, list[tuple[Log, Truth | None]]()
    for path in tuning:
        log = _unused(path, taken, "tune", note)
        check_vehicle(log, path, vehicle, "the model")
        first = first or log
    if first is None:
        raise InputError("no recording to tune on; give fault-free recordings that neither fit nor choice has seen")
    if first.dbc_path is None:
        raise InputError(
            f"{first.source.path}: has no DBC, which the bundle to be judged needs; give one with a CAN log"
        )
    for path, told in evaluation:
        log = _unused(path, taken, "evaluate", note)
        if first.recording is not None:
            log.check_dbc(first.recording.can_log.dbc_sha256)
        judged.append((log, None if told is None else load_truth(told, log.id)))
    return Trial(tuple(tuning), first.dbc_path, first.senders, first.signals_of_dbc, tuple(judged))


def bundle_effect(before: Model, after: Model, recordings: Trial, progress: Progress) -> BundleEffect:
    """Makes both models' bundles and judges them. A model that has no bundle says why.

    Raises:
        InputError: a recording to evaluate on ends before its signals are there.
    """
    made = []
    for title, model in (("without the effect", before), ("with it", after)):
        progress.say(f"bundle {title}")
        made.append(_bundled(model, recordings, progress))
    return BundleEffect(*made)


def _unused(path: Path, used: dict[str, str], purpose: str, note: Callable[[str], None]) -> Log:
    log = open_known(path, note)
    if log.drive in used:
        raise InputError(f"{path}: this recording was used to {used[log.drive]}; give one of its own to {purpose} on")
    used[log.drive] = purpose
    return log


def _bundled(model: Model, recordings: Trial, progress: Progress) -> Bundled:
    """The model's bundle, or why there is none."""
    try:
        runnable = Runnable(build_bank(model))
        tuned, dbc = tune(runnable, [*recordings.tuning], progress), recordings.dbc
        given = dbc.name, dbc.read_bytes()
        chosen = recordings.senders, NO_BUSES, recordings.signals
        bundle = _written(bundle_files(runnable, tuned, given, model.name, 0, *chosen))
    except InputError as error:
        return Bundled(reason=str(error))
    judged = {}
    for log, truth in recordings.judged:
        progress.say(log.id)
        judged[log.id] = _judged(bundle, log, truth)
    return Bundled(
        generators=runnable.generators,
        tolerated=tuple(
            d.nu * mean(s for k, s in enumerate(d.scale) if k != EDGE)
            for d in tuned.detectors
            if isinstance(d, CusumDetector)
        ),
        judged=judged,
    )


def _written(files: Mapping[str, bytes]) -> Bundle:
    """The bundle of these files, as a vehicle would load it."""
    with TemporaryDirectory(prefix="faultline-") as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        bundle = load_bundle(Path(folder))
    verify_golden(bundle)
    return bundle


def _judged(bundle: Bundle, log: Log, truth: Truth | None) -> Judged:
    log.check_dbc(bundle.dbc_sha256)
    story = tell(bundle, log)
    known = truth or Truth(schema=1, recording=log.id)
    tests = [generator.test for generator in bundle.manifest.generators]
    verdict = judge(known, story.events, tests, story.origin_s, story.end_s)
    stop = min(story.end_s, *(fault.onset_s for fault in known.fault)) if known.fault else story.end_s
    return Judged(verdict, max(stop - story.origin_s, 0.0) / 3600.0, assumed=truth is None)


def _told(verdict: Verdict) -> str:
    if not verdict.detected:
        return "not detected"
    others = [name for name in verdict.isolated if name not in verdict.first]
    behind = f", behind it {', '.join(others)}" if others else ""
    return f"detected after {verdict.delay_s:g} s, ranked first {', '.join(verdict.first)}{behind}"
