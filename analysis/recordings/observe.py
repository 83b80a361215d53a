"""A log through the vehicle's own sampler, mode tracker and generators: what calibration and tuning look at."""

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from faultline.analysis.graph.bank import Bank
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.model import Model
from faultline.analysis.recordings.modes import modes_of
from faultline.service.core.manifest import Input, Manifest
from faultline.service.core.residuals.evaluator import Evaluator, TickByTick
from faultline.service.core.residuals.generators import FRESH, Generators, Residuals
from faultline.service.core.residuals.observer import Observer, Tick
from faultline.service.core.signals.arrivals import known_jitter
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.received import Signals
from faultline.service.core.signals.sampling import Sampler
from faultline.service.core.signals.values import FloatArray, Mask
from faultline.service.logs import Log, LogError, open_log

START_WITHIN_S, START_PERIODS = 5.0, 25.0
"""How long after the first frame tick 0 waits for a signal that never appears [s, periods]: the longer of both."""
NO_FRAMES = DecodeTable({})
"""The decode table of an observer that is given signals: it is asked for no frame."""


class Blind:
    """Generators that compute nothing: only the samples are wanted."""

    def step(self, z: FloatArray, usable: Mask, ages: FloatArray = FRESH) -> Residuals:
        """Nothing of nothing."""
        del z, usable, ages
        none = np.zeros(0)
        return Residuals(none, none, none, np.zeros(0, dtype=np.bool_))


def open_known(path: Path, say: Callable[[str], None]) -> Log:
    """The log at `path`, whose loss, if there is one, is said.

    Raises:
        LogError: it is no log, or a bare one: without a recording's folder its DBC is not known.
    """
    log = open_log(path)
    if not log.buses:
        log.check_channels()
    if log.recording is None:
        raise LogError(f"{path}: a bare log names no DBC; give its recording's folder")
    if log.report.lost:
        say(f"{path}: {log.report.summary()}")
    return log


def open_for(model: Model, path: Path, say: Callable[[str], None]) -> Log:
    """The same of a log that has the sensors which the model needs.

    Raises:
        LogError: it has not.
    """
    log = open_known(path, say)
    if log.recording is not None:
        log.recording.check_sensors(path, model.sensor_set, f"the model {model.name}")
    return log


def trusted(log: Log, units: Mapping[str, str], where: str) -> tuple[Signals, dict[str, float]]:
    """The signals of a recording that is vouched for, and its jitter [s] by signal, which is borne and not doubted.

    Raises:
        InputError: its DBC does not give them; `where` names it.
    """
    table = log.table(units, where)
    signals = log.signals(table)
    found = jitters(signals, table)
    table.bear(found)
    return signals, found


def jitters(signals: Signals, table: DecodeTable) -> dict[str, float]:
    """By how much the frames of each signal are known to come too soon [s], where it is more than the rule bears."""
    periods = {name: period for name in table.units if (period := table.period_s(name)) is not None}
    times: dict[str, list[FloatArray]] = {name: [] for name in periods}
    for piece in signals.pieces(judged=False) if periods else ():
        for name in periods.keys() & piece.columns.keys():
            times[name].append(piece.time[piece.columns[name].row])
    found = {name: known_jitter(np.concatenate(of), periods[name]) for name, of in times.items() if of}
    return {name: each for name, each in found.items() if each > 0.0}


def observe(bank: Bank, signals: Signals) -> list[Tick]:
    """Every tick of a log, up to its last frame."""
    return ticks_of(bank.model, bank.inputs, signals, Runnable(bank).fresh())


def start_within_s(model: Model) -> float:
    """How long tick 0 waits for all signals of the model [s]."""
    return max(START_WITHIN_S, START_PERIODS * model.period_s)


def ticks_of(model: Model, inputs: Sequence[Input], signals: Signals, generators: Generators) -> list[Tick]:
    """The same with any generators."""
    modes = ModeTracker(modes_of(model), inputs, model.period_s)
    return evaluated(model, inputs, signals, TickByTick(generators, modes))


def evaluated(model: Model, inputs: Sequence[Input], signals: Signals, evaluator: Evaluator) -> list[Tick]:
    """The same with any evaluator."""
    return _ticks(Observer(NO_FRAMES, Sampler(inputs), evaluator, model.period_s, start_within_s(model)), signals)


def samples_of(manifest: Manifest, signals: Signals) -> list[Tick]:
    """Every tick of a log as a bundle takes its samples and modes, without running its generators."""
    modes = ModeTracker(manifest.modes, manifest.inputs, manifest.period_s)
    sampler, period_s, start_within_s = Sampler(manifest.inputs), manifest.period_s, manifest.start_within_s
    return _ticks(Observer(NO_FRAMES, sampler, TickByTick(Blind(), modes), period_s, start_within_s), signals)


def _ticks(observer: Observer, signals: Signals) -> list[Tick]:
    ticks: list[Tick] = []
    last_s = None
    for piece in signals.pieces():
        last_s = piece.last_s
        ticks += chain.from_iterable(observer.take(piece))
    return ticks if last_s is None else [*ticks, *chain.from_iterable(observer.advance(last_s))]
