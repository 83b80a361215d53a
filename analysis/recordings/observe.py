"""A log through the vehicle's own sampler, mode tracker and generators: what calibration and tuning look at."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from analysis.graph.bank import PERIOD_S, Bank
from analysis.graph.runnable import Runnable
from analysis.model import Model
from analysis.recordings.modes import modes_of
from service.core.decode import DecodeTable
from service.core.generators import Generators
from service.core.manifest import Input
from service.core.modes import ModeTracker
from service.core.observer import Decoder, Observer, Tick
from service.core.sampling import Sampler
from service.logs import Frame, Log, LogError, open_log

START_WITHIN_S = 5.0


def open_known(path: Path, say: Callable[[str], None]) -> Log:
    """The log at `path`, whose loss, if there is one, is said.

    Raises:
        LogError: it is no log, or a bare one: without a recording's folder its DBC is not known.
    """
    log = open_log(path)
    if log.dbc_path is None:
        raise LogError(f"{path}: a bare log names no DBC; give its recording's folder")
    if log.report.lost:
        say(f"{path}: {log.report.summary()}")
    return log


def observe(bank: Bank, table: DecodeTable, frames: Iterable[Frame]) -> list[Tick]:
    """Every tick of a log, up to its last frame."""
    return ticks_of(bank.model, bank.inputs, table, frames, Runnable(bank).fresh())


def ticks_of(
    model: Model, inputs: Sequence[Input], table: Decoder, frames: Iterable[Frame], generators: Generators
) -> list[Tick]:
    """The same with any generators."""
    modes = ModeTracker(modes_of(model), inputs)
    observer = Observer(table, Sampler(inputs), modes, generators, PERIOD_S, START_WITHIN_S)
    ticks: list[Tick] = []
    t_s = None
    for t_s, can_id, is_extended, data in frames:
        ticks += observer.frame(t_s, can_id, is_extended, data)
    return ticks if t_s is None else ticks + observer.advance(t_s)
