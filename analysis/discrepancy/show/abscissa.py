"""What a missing effect depends on, at the cells of its unknown input: so that its curve can be drawn over it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.sections import Section
from faultline.analysis.discrepancy.discover import Discovery
from faultline.analysis.model import Model
from faultline.analysis.simulation import system_of

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Abscissa:
    """`value` (cells,) of what `words` say."""

    words: str
    value: Array


def abscissa_of(found: Discovery) -> Abscissa | None:
    """Of the first feature that was found; None if there is none, or none that is known at the cells.

    What is only in one operating mode is drawn over the signal by which the mode is told.
    """
    if not found.before.findings:
        return None
    model, sections = found.study.model, found.study.training
    feature = found.before.findings[0].parts[0].feature
    course, term = feature.course, feature.term
    place = _place(sections, found.before.suspects[0].t)
    if place is None:
        return None
    inputs, signal = system_of(model, []).inputs, next(iter(model.modes.bounded), "")
    if signal in inputs and set(np.unique(course.value)) <= {0.0, 1.0}:
        column = inputs.index(signal)
        held = [section.drive.inputs[:, column] for section in sections]
        at = [(k, round(time / sections[k].drive.step_s)) for k, time in place]
        return Abscissa(_titled(model, signal), np.array([held[k][min(n, len(held[k]) - 1)] for k, n in at]))
    every = [max(1, round(section.time.period_s / section.drive.step_s)) for section in sections]
    lengths = [len(section.t[::n]) for section, n in zip(sections, every, strict=True)]
    if sum(lengths) != len(course.value):
        return None
    parts = np.split(feature.direction / term.size, np.cumsum(lengths)[:-1])
    times = [section.t[::n] for section, n in zip(sections, every, strict=True)]
    words = f"{term.variable}, {course.words}" if feature.relative else course.words
    return Abscissa(words, _means(place, times, parts))


def _means(place: Sequence[tuple[int, float]], times: Sequence[Array], values: Sequence[Array]) -> Array:
    """The mean in every cell: it goes half of the way to its neighbours."""
    found: list[float] = []
    for k in range(len(times)):
        middle = np.array([time for section, time in place if section == k])
        number = np.searchsorted(0.5 * (middle[1:] + middle[:-1]), times[k])
        count = np.bincount(number, minlength=len(middle))
        found += (np.bincount(number, values[k], len(middle)) / np.maximum(count, 1)).tolist() if len(middle) else []
    return np.array(found)


def _place(sections: Sequence[Section], t: Array) -> list[tuple[int, float]] | None:
    """The section of every cell and its time there: cells come section after section; None if they fit nowhere."""
    found: list[tuple[int, float]] = []
    k, last = 0, -np.inf
    for time in t:
        if time <= last:
            k += 1
        while k < len(sections) and not 0.0 <= time - sections[k].start_s <= sections[k].t[-1]:
            k += 1
        if k == len(sections):
            return None
        found.append((k, float(time - sections[k].start_s)))
        last = time
    return found


def _titled(model: Model, signal: str) -> str:
    known = model.known[signal]
    return f"{signal} [{known.unit}]" if known.unit != "1" else signal
