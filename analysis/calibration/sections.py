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

from faultline.analysis.calibration.inputs import interpolated, is_command, misread, renewed, sample_noise, uncertain
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


BLIND = 2.5
"""Periods. From a sample before a command's step until so long after it no sample counts: when it
acted is not known so well."""

FEWEST = 20
"""Samples of an output in a section; with fewer there is nothing to compare."""

SHORTEST = 150.0
"""Periods beyond the warm-up; less is not worth a run."""


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
    `time` is that of the model; `commands` are the inputs that hold still between steps. `uncertain` (J, 4), by input
    and output, are the intervals over which its mean has an error of its own (see `inputs`).
    """

    number: int
    start_s: float
    drive: Drive
    noise: Array
    samples: Mapping[str, Samples]
    sensed: Mapping[str, Array]
    time: TimeScale
    commands: tuple[str, ...] = ()
    uncertain: Mapping[str, Array] = field(default_factory=dict)

    @property
    def t(self) -> Array:
        """The instants of the free run [s], after the section's start."""
        return np.asarray(np.arange(len(self.drive.inputs)) * self.drive.step_s)


def fitting(section: Section, system: System) -> Section:
    """The section for another system with the same inputs and outputs: the states are its own."""
    states = _states(system, section.sensed, len(section.t))
    return replace(section, drive=replace(section.drive, start=states[0], guess=states))


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
    tracks = {name: renewed(track) for name, track in tracks.items()}
    shortest_s = model.warm_up_s + SHORTEST * model.period_s
    found = [(low, high) for low, high in _stretches(model, system, tracks) if high - low >= shortest_s]
    if not found:
        raise InputError(
            f"{where}: in no {shortest_s:g} s on end (the model's warm_up_s of {model.warm_up_s:g} s and "
            f"{SHORTEST * model.period_s:g} s more) do all inputs tell and all signals keep within their ranges"
            f"{_beyond(model, tracks)}; record longer undisturbed operation"
        )
    made = [_section(model, system, tracks, k, low, high, step * model.period_s) for k, (low, high) in enumerate(found)]
    empty = [name for name in system.outputs if any(len(section.samples[name].t) < FEWEST for section in made)]
    if empty:
        raise InputError(
            f"{where}: commands step so often that {' and '.join(empty)} hardly tells between the steps, of which "
            f"{BLIND * model.period_s:g} s each are left out; record longer holds, or check which signals are commands "
            f"({', '.join(made[0].commands)})"
        )
    return made


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
    commands = tuple(name for name in system.inputs if is_command(tracks[name].value))
    gap_s, time = GAP * model.period_s, time_of(model)
    measured = {name: tracks[name].at(t) for name in system.outputs}
    states = _states(system, measured, len(t))
    mode = _modes(model, tracks, t)
    stepped = np.concatenate(
        [[-np.inf], *(tracks[name].t[1:][np.diff(tracks[name].value) != 0.0] for name in commands)]
    )
    stepped.sort()
    samples = {}
    for name in system.outputs:
        track = tracks[name]
        last = stepped[np.searchsorted(stepped, track.t + model.period_s, side="right") - 1]
        inside = (track.t >= low + model.warm_up_s) & (track.t <= t[-1]) & (track.t > last + BLIND * model.period_s)
        at = np.searchsorted(t, track.t[inside], side="right") - 1
        samples[name] = Samples(track.t[inside] - low, track.value[inside], mode[at])
    noise = np.tile([model.known[name].noise for name in system.inputs], (len(t), 1))
    inputs, intervals = np.column_stack([tracks[name].at(t) for name in system.inputs]), {}
    for k, name in enumerate(system.inputs):
        if name not in commands:
            noise[:, k] = sample_noise(model.known[name].noise, tracks[name], t, mode)
            inputs[:, k] = interpolated(tracks[name], t, gap_s)
            intervals[name] = uncertain(tracks[name], t, noise[:, k], time)
    for name in system.outputs:
        found = misread(tracks[name], model.known[name].noise, time)
        intervals[name] = found[(found[:, 1] > low) & (found[:, 0] < t[-1])] - np.array([low, low, 0.0, 0.0])
    return Section(
        number, low, Drive(step_s, inputs, states[0], states), noise, samples, measured, time, commands, intervals
    )


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
