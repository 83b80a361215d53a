"""Check modes, edges, operating ranges and maximum ages of a model against recordings; propose what would fit."""

from collections.abc import Iterator, Mapping, Sequence
from math import ceil, floor, sqrt
from typing import NamedTuple

import msgspec
import numpy as np

from faultline.analysis.model import Model
from faultline.analysis.model.model import Known, Mode
from faultline.analysis.recordings.modes import modes_at
from faultline.analysis.recordings.new_system import PERIODS, rounded
from faultline.analysis.recordings.track import Mask, Track
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import FloatArray, Indices

SHORT = 50.0
"""Periods: a mode that is visited for less says little of itself."""
USUAL = 0.95
"""Quantile of a signal's changes from tick to tick: steps are rarer."""
CLEAR = 3.0
"""Times the usual change, and twice as many times the sensor's noise, from which on a change is clearly a step."""
ROOM = 1.5
"""Times a threshold that a step has to be, so that none is missed when two samples come between two ticks."""
FEW, PART = 2, 0.25
"""How many steps that are smaller, and which part of all, are remarkable."""
BESIDE = 2
"""Ticks within which a step of another signal makes one an edge anyway."""
MOSTLY = 0.5
"""Part of the time in the edge, from which on a threshold that noise exceeds is too low."""
OUTSIDE = 0.05
"""Part of the time outside an operating range, between the first and the last time within, that is remarkable."""
INSIDE = 0.001, 0.999
"""Quantiles of a signal that a proposed range covers, and a margin besides."""
MARGIN = 0.05


class Finding(msgspec.Struct, frozen=True):
    """What does not fit, in words, and a line of TOML that would, with the file and the table that it belongs in."""

    what: str
    where: str
    line: str

    @property
    def text(self) -> str:
        """Both in one line."""
        return f"{self.what}; {self.where}: {self.line}" if self.line else f"{self.what}; {self.where}"


class _Seen(NamedTuple):
    """A recording at its ticks: values (N,) by signal, the mode (N,) and whether all signals are within range (N,)."""

    values: Mapping[str, FloatArray]
    mode: Indices
    inside: Mask


def findings(model: Model, recordings: Sequence[Mapping[str, Track]]) -> list[Finding]:
    """Return what does not fit recordings of a model's known signals, or of some of them; nothing where all does.

    Signals that one of the recordings does not have are left out, and modes and edges with those that they need.
    """
    names = [name for name in model.known if all(name in each and len(each[name].t) > 1 for each in recordings)]
    if not names or not recordings:
        return []
    recordings = [{name: tracks[name] for name in names} for tracks in recordings]
    knows_modes = all(name in names for mode in model.modes.steady for name in mode.where)
    seen = [_seen(model, tracks, knows_modes=knows_modes) for tracks in recordings]
    found = [each for name in names for each in _of_age(model, name, [tracks[name] for tracks in recordings])]
    found += [each for name in names for each in _of_range(name, model.known[name], [one.values[name] for one in seen])]
    if not knows_modes:
        return found
    found += [each for name in names if name in model.modes.edges for each in _of_edge(model, name, seen)]
    return found + list(_of_modes(model, seen))


def _seen(model: Model, tracks: Mapping[str, Track], *, knows_modes: bool) -> _Seen:
    begin, end = max(track.t[0] for track in tracks.values()), min(track.t[-1] for track in tracks.values())
    ticks = np.arange(begin, max(end, begin + model.period_s), model.period_s)
    values = {name: track.held(ticks) for name, track in tracks.items()}
    inside = [(value >= model.known[name].min) & (value <= model.known[name].max) for name, value in values.items()]
    mode = modes_at(model, tracks, ticks) if knows_modes else np.full(len(ticks), EDGE)
    return _Seen(values, mode, np.all(inside, axis=0))


def _of_age(model: Model, name: str, tracks: Sequence[Track]) -> Iterator[Finding]:
    """A signal whose samples are usually too old before the next one comes."""
    period_s, age_s = max(track.period_s for track in tracks), model.maximum_age_s(name)
    if period_s > age_s:
        yield Finding(
            f"{name} comes every {period_s:.3g} s, and is not used when older than {age_s:g} s",
            "system.toml, [signal]",
            f"{name}.maximum_age_s = {PERIODS * period_s:.3g}",
        )


def _of_range(name: str, known: Known, values: Sequence[FloatArray]) -> Iterator[Finding]:
    """A signal that leaves its range for long; what comes before it is within for the first time is no operation."""
    found = []
    for value in values:
        within = np.flatnonzero((value >= known.min) & (value <= known.max))
        found.append(value[within[0] : within[-1] + 1] if len(within) else value)
    value = np.concatenate(found)
    low, high = (float(each) for each in np.quantile(value, INSIDE))
    margin = MARGIN * (high - low)
    sides = (
        ("below", known.min, value < known.min, f"min = {rounded(low - margin, floor)}"),
        ("above", known.max, value > known.max, f"max = {rounded(high + margin, ceil)}"),
    )
    for side, bound, is_out, line in sides:
        if (share := float(np.mean(is_out))) > OUTSIDE:
            seen = f"it goes from {value.min():.4g} to {value.max():.4g}"
            yield Finding(
                f"{name} is {side} {bound:g} {known.unit} for {100 * share:.0f} % of the time: {seen}",
                f"if the model holds there, model.toml, [known.{name}]",
                line,
            )


def _of_edge(model: Model, name: str, seen: Sequence[_Seen]) -> Iterator[Finding]:
    """A threshold that clear steps do not reach, or that noise exceeds."""
    known, threshold = model.known[name], model.modes.edges[name]
    changes = [np.abs(np.diff(one.values[name], prepend=one.values[name][0])) for one in seen]
    each = list(zip(changes, seen, strict=True))
    everything = np.concatenate([change[one.inside] for change, one in each])
    if not len(everything):
        return
    clear = max(CLEAR * float(np.quantile(everything, USUAL)), 2.0 * CLEAR * known.noise)
    steps = np.concatenate([change[_starts(model, name, one, change > clear)] for change, one in each])
    weak = steps[steps <= ROOM * threshold]
    if ROOM * clear <= threshold and len(weak) >= max(FEW, PART * len(steps)):
        yield Finding(
            f"{len(weak)} of {len(steps)} steps of {name}, by {weak.min():.3g} to {weak.max():.3g} {known.unit}, "
            f"hardly exceed the edge's {threshold:g}, or do not; else it moves by less than {clear / CLEAR:.2g}",
            "system.toml, [edges]",
            _steps(model, name, sqrt(float(weak.min()) * clear / CLEAR)),  # between the smallest step and what is usual
        )
    in_edge = float(np.mean(np.concatenate([one.mode[one.inside] == EDGE for one in seen])))
    if in_edge > MOSTLY and float(np.mean(everything > threshold)) > 1.0 - USUAL:
        yield Finding(
            f"{name} moves by more than {threshold:g} {known.unit} all the time: {100 * in_edge:.0f} % of it is edge",
            "system.toml, [edges]",
            _steps(model, name, clear),
        )


def _starts(model: Model, name: str, seen: _Seen, is_clear: Mask) -> Mask:
    """The ticks (N,) of clear steps that no step of another signal, and no edge before, makes an edge already."""
    near = np.zeros(len(is_clear), dtype=np.bool_)
    for other, size in model.modes.edges.items():
        if other != name and other in seen.values:
            near |= np.abs(np.diff(seen.values[other], prepend=seen.values[other][0])) > size
    near = np.convolve(near, np.ones(2 * BESIDE + 1), mode="same") > 0
    before = np.concatenate([[EDGE], seen.mode[:-1]])
    return np.asarray(is_clear & seen.inside & (before != EDGE) & ~near)


def _steps(model: Model, name: str, threshold: float) -> str:
    steps = {**{each: f"{size:g}" for each, size in model.modes.edges.items()}, name: rounded(threshold, round)}
    return f"steps = {{ {', '.join(f'{each} = {size}' for each, size in steps.items())} }}"


def _of_modes(model: Model, seen: Sequence[_Seen]) -> Iterator[Finding]:
    """Modes that are visited never, or hardly."""
    mode = np.concatenate([one.mode[one.inside] for one in seen])
    for number, each in enumerate(model.modes.steady, EDGE + 1):
        seconds = float(np.sum(mode == number)) * model.period_s
        if seconds < SHORT * model.period_s:
            bounds = _rest(each, seen)
            yield Finding(
                f"mode {each.name} is visited for {seconds:.3g} s only"
                if seconds
                else f"mode {each.name} is never visited",
                f"system.toml, [[mode]] {each.name}" if bounds else "record it, or take it out of system.toml",
                bounds,
            )


def _rest(mode: Mode, seen: Sequence[_Seen]) -> str:
    """A bound for a mode of one bound at the end of a signal's range, where the signal rests near that end."""
    if len(mode.where) != 1:
        return ""
    [(name, (above, below))] = mode.where.items()
    value = np.concatenate([one.values[name][one.inside] for one in seen])
    if not len(value) or (above is None) == (below is None):
        return ""
    near = MARGIN * float(np.ptp(value))
    bound = float(value.min()) + near if above is None else float(value.max()) - near
    resting = value < bound if above is None else value > bound
    if not near or float(np.sum(resting)) < SHORT:
        return ""
    return f"where = {{ {name} = {{ {'below' if above is None else 'above'} = {rounded(bound, round)} }} }}"
