"""Cuts a recording into sections in which a model can be run freely and compared.

A section is a stretch in which every input tells and every signal that tells is within its range; at its start the
measured pressures say where the states are, and the model's warm-up passes before a sample counts. Inputs are
interpolated, outputs are compared at their own times: nothing is filtered.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import sympy as sp
from scipy.interpolate import CubicSpline

from faultline.analysis.model import Model
from faultline.analysis.recordings.modes import modes_at, time_of
from faultline.analysis.recordings.track import Track, tracks_of
from faultline.analysis.simulation import Drive, System
from faultline.service.core.errors import InputError
from faultline.service.core.signals.received import Signals
from faultline.service.core.time_scale import TimeScale

Array = npt.NDArray[np.float64]

STEP = 0.25
"""Of the free run, in periods. At twice the step the hose of the dosing system comes out 0.2 % stiffer."""

GAP = 5.0
"""Periods: an input that is silent for longer is unknown."""

LONGEST = 1500.0
"""Periods. A longer stretch is cut: the memory that its noise takes grows with the square."""

STILL = 0.5
"""An input that moves in a smaller part of all samples is a command."""

BLIND = 2.5
"""Periods. From a sample before a command's step until so long after it no sample counts: when it
acted is not known so well."""

SHORTEST = 150.0
"""Periods beyond the warm-up; less is not worth a run."""

ROUGH = 3.0
"""Times the noise of its mode, from which an input's third difference is a jump: noise alone is one in 3 of 1,000."""

JUMP = 1.0 / np.sqrt(12.0)
"""Standard deviation of the mean over an interval in which the input jumps, in parts of the jump's height; its instant
within the interval is unknown. It comes at any with the same probability, and the mean is anywhere between before and
after.
"""


@dataclass(frozen=True)
class Samples:
    """An output as measured: times `t` (N,) [s] after the section's start, values (N,), operating modes (N,)."""

    t: Array
    value: Array
    mode: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Section:
    """What a free run from `start_s` [s] after the log's first frame needs, and what it is compared with.

    `number` counts the sections of one log from zero on; `noise` (K, inputs) is the standard deviation of a sample of
    each input at the run's instants; `sensed` (K,) are the measured outputs there, which say where the states begin.
    `time` is that of the model. `jumps` (J, 3), by input, are the intervals between samples in which it jumps: begin
    and end [s] after the section's start, and the standard deviation of its mean over them.
    """

    number: int
    start_s: float
    drive: Drive
    noise: Array
    samples: Mapping[str, Samples]
    sensed: Mapping[str, Array]
    time: TimeScale
    jumps: Mapping[str, Array] = field(default_factory=dict)

    @property
    def t(self) -> Array:
        """The instants of the free run [s], after the section's start."""
        return np.asarray(np.arange(len(self.drive.inputs)) * self.drive.step_s)


def fitting(section: Section, system: System) -> Section:
    """The section for another system with the same inputs and outputs: the states are its own."""
    states = _states(system, section.sensed, len(section.t))
    return replace(section, drive=replace(section.drive, start=states[0], guess=states))


def is_command(value: Array) -> bool:
    """Whether an input (K,) holds still between its steps: a command, no measurement."""
    return bool(np.mean(np.diff(value) != 0.0) < STILL)


def sections(model: Model, system: System, signals: Signals, where: str, step: float = STEP) -> list[Section]:
    """The sections of a log, whose times are from its start on, for free runs of this step [periods].

    Raises:
        InputError: a signal of the model never tells, or no stretch is long enough; the message starts with `where`.
    """
    return cut(model, system, known_tracks(model, signals, where), where, step)


def cut(model: Model, system: System, tracks: Mapping[str, Track], where: str, step: float = STEP) -> list[Section]:
    """The sections of signals, by name, as they were sampled or as an experiment plans them.

    Raises:
        InputError: no stretch is long enough; the message starts with `where`.
    """
    if not system.inputs:
        raise InputError(
            f"{where}: the model {model.name} has no input, and a free run without one says nothing of the parameters; "
            "make a signal that drives the system a known variable"
        )
    shortest_s = model.warm_up_s + SHORTEST * model.period_s
    found = [(low, high) for low, high in _stretches(model, system, tracks) if high - low >= shortest_s]
    if not found:
        raise InputError(
            f"{where}: in no {shortest_s:g} s on end (the model's warm_up_s of {model.warm_up_s:g} s and "
            f"{SHORTEST * model.period_s:g} s more) do all inputs tell and all signals keep within their ranges"
            f"{_beyond(model, tracks)}; record longer undisturbed operation"
        )
    return [_section(model, system, tracks, k, low, high, step * model.period_s) for k, (low, high) in enumerate(found)]


def _beyond(model: Model, tracks: Mapping[str, Track]) -> str:
    """Which signals leave the ranges of the model, and how far, in words."""
    told = []
    for name, known in model.known.items():
        value = tracks[name].value
        low, high = float(value.min()), float(value.max())
        if low < known.min or high > known.max:
            told.append(
                f"{name} goes from {low:.4g} to {high:.4g} {known.unit}, its range is {known.min:g} to {known.max:g}"
            )
    return f" ({'; '.join(told)})" if told else ""


def known_tracks(model: Model, signals: Signals, where: str) -> dict[str, Track]:
    """The samples of the model's known signals in a log.

    Raises:
        InputError: a signal never tells; the message starts with `where`.
    """
    tracks = tracks_of(signals, model.known)
    silent = [name for name, track in tracks.items() if len(track.t) < 2]
    if silent:
        strangers = "".join(f"; {text}" for text in signals.strangers())
        raise InputError(
            f"{where}: {', '.join(silent)} never tells; calibrate on a recording that has all signals{strangers}"
        )
    return tracks


def _stretches(model: Model, system: System, tracks: Mapping[str, Track]) -> list[tuple[float, float]]:
    """Times between which nothing is missing or out of range, at most `LONGEST` apart, if that is not too short."""
    start = max(track.t[0] for track in tracks.values())
    end = min(tracks[name].t[-1] for name in system.inputs)
    bad = [(-np.inf, start), (end, np.inf)]
    for name in system.inputs:
        bad += tracks[name].gaps()
    for name, known in model.known.items():
        track = tracks[name]
        bad += [(float(t), float(t)) for t in track.t[(track.value < known.min) | (track.value > known.max)]]
    found = []
    last = -np.inf
    for low, high in sorted(bad):
        if low - last > model.period_s and np.isfinite(last):
            whole = int((low - last) // (model.warm_up_s + SHORTEST * model.period_s))
            pieces = min(int(np.ceil((low - last) / (LONGEST * model.period_s))), max(1, whole))
            edges = np.linspace(last, low, pieces + 1)
            found += [(float(a), float(b)) for a, b in pairwise(edges)]
        last = max(last, high)
    return found


def _section(
    model: Model, system: System, tracks: Mapping[str, Track], number: int, low: float, high: float, step_s: float
) -> Section:
    t = np.arange(low, high, step_s)
    inputs = np.column_stack([_input(tracks[name], t, GAP * model.period_s) for name in system.inputs])
    measured = {name: tracks[name].at(t) for name in system.outputs}
    states = _states(system, measured, len(t))
    mode = _modes(model, tracks, t)
    commands = [tracks[name] for name in system.inputs if is_command(tracks[name].value)]
    stepped = np.concatenate([[-np.inf], *(track.t[1:][np.diff(track.value) != 0.0] for track in commands)])
    stepped.sort()
    samples = {}
    for name in system.outputs:
        track = tracks[name]
        last = stepped[np.searchsorted(stepped, track.t + model.period_s, side="right") - 1]
        inside = (track.t >= low + model.warm_up_s) & (track.t <= t[-1]) & (track.t > last + BLIND * model.period_s)
        at = np.searchsorted(t, track.t[inside], side="right") - 1
        samples[name] = Samples(track.t[inside] - low, track.value[inside], mode[at])
    noise = np.column_stack([_noise(model, name, tracks[name], t, mode) for name in system.inputs])
    jumps = {name: _jumps(tracks[name], t, noise[:, k]) for k, name in enumerate(system.inputs)}
    return Section(
        number, low, Drive(step_s, inputs, states[0], states), noise, samples, measured, time_of(model), jumps
    )


def _noise(model: Model, name: str, track: Track, t: Array, mode: npt.NDArray[np.int64]) -> Array:
    """The standard deviation (K,) of a sample of an input at the times `t`, at least the sensor's.

    A speed that follows the valve's pulses, or what its own controller makes of noise, is sampled too seldom to be
    known in between: to a free run that is noise. It shows in second differences, where slower changes hardly do.
    """
    found = np.full(len(t), model.known[name].noise)
    if not is_command(track.value):
        middle = track.t[1:-1]
        inside = (middle >= t[0]) & (middle <= t[-1])
        flicker = np.abs(track.value[:-2] - 2.0 * track.value[1:-1] + track.value[2:])[inside] / np.sqrt(6.0)
        at = mode[np.searchsorted(t, middle[inside], side="right") - 1]
        for k in np.unique(at):
            found[mode == k] = max(by_median(flicker[at == k]), model.known[name].noise)
    return found


def _jumps(track: Track, t: Array, noise: Array) -> Array:
    """The intervals (J, 3) in which an input jumps, see `Section`; `noise` (K,) is that of its samples at `t`.

    A set point's step moves the input between two samples by more than the median of a mode shows. Its height is half
    the third difference around the interval: all of it after a jump, and nothing where the input bends slowly.
    """
    if is_command(track.value):
        return np.zeros((0, 3))
    begin, end, rough = track.t[1:-2], track.t[2:-1], np.abs(np.diff(track.value, 3))
    usual = np.sqrt(20.0) * noise[np.clip(np.searchsorted(t, begin, side="right") - 1, 0, None)]
    found = (rough > ROUGH * usual) & (end > t[0]) & (begin < t[-1])
    return np.asarray(np.column_stack([begin - t[0], end - t[0], JUMP * rough / 2.0])[found])


def by_median(e: Array) -> float:
    """The standard deviation of (N,) zero-mean noise, or of its magnitudes, in which there may be steps."""
    return 1.4826 * float(np.median(np.abs(e)))


def _input(track: Track, t: Array, gap_s: float) -> Array:
    """A command on straight lines, a measurement on a cubic spline: chords would flatten each of its swings."""
    if is_command(track.value):
        return track.at(t)
    near = (track.t > t[0] - gap_s) & (track.t < t[-1] + gap_s)
    return np.asarray(CubicSpline(track.t[near], track.value[near])(t))


def _states(system: System, measured: Mapping[str, Array], count: int) -> Array:
    return np.column_stack([_state(system.model, name, measured, count) for name in system.states])


def _state(model: Model, name: str, measured: Mapping[str, Array], count: int) -> Array:
    """A state's values where the sensors see it, by the first of its initial expressions that they can give."""
    at_hand = {**{parameter: p.value for parameter, p in model.parameters.items()}, **measured}
    for expression in model.unknown[name].initial:
        needed = sorted(symbol.name for symbol in expression.free_symbols)
        if set(needed) <= at_hand.keys():
            value = sp.lambdify(needed, expression)(*(at_hand[symbol] for symbol in needed))
            return np.broadcast_to(value, count)
    raise InputError(
        f"{model.name}: unknown.{name}.initial: no expression uses only sensors' signals; add one, a parameter will do"
    )


def _modes(model: Model, tracks: Mapping[str, Track], t: Array) -> npt.NDArray[np.int64]:
    """The operating mode at the times `t`, as the vehicle's own tracker follows it."""
    mode = modes_at(model, tracks, np.arange(t[0], t[-1] + model.period_s, model.period_s))
    return np.asarray(mode[np.minimum(np.round((t - t[0]) / model.period_s).astype(int), len(mode) - 1)])
