"""What a missing effect depends on, at the cells of its unknown input: so that its curve can be drawn over it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.calibration.sections import Section
from analysis.discrepancy.discover import Discovery
from analysis.discrepancy.disturbed import STEP_S
from analysis.model import Model
from analysis.simulation import system_of

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
    model, sections, t = found.study.model, found.study.training, found.before.suspects[0].t
    feature, place = found.before.findings[0].parts[0].feature, _place(sections, t)
    signal = model.modes.signal if model.modes else ""
    if place is None:
        return None
    if set(np.unique(feature.course.value)) <= {0.0, 1.0} and signal in system_of(model, []).inputs:
        column = system_of(model, []).inputs.index(signal)
        value = [_at(sections[k], s.drive.inputs[:, column], 1, time) for k, time in place for s in [sections[k]]]
        return Abscissa(_titled(model, signal), np.array(value))
    every = [max(1, round(STEP_S / section.drive.step_s)) for section in sections]
    lengths = [len(section.t[::n]) for section, n in zip(sections, every, strict=True)]
    if sum(lengths) != len(feature.course.value):
        return None
    parts = np.split(feature.course.value, np.cumsum(lengths)[:-1])
    return Abscissa(
        f"{feature.course.words} (1: all of it)",
        np.array([_at(sections[k], parts[k], every[k], time) for k, time in place]),
    )


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


def _at(section: Section, value: Array, every: int, time: float) -> float:
    return float(value[min(round(time / (every * section.drive.step_s)), len(value) - 1)])


def _titled(model: Model, signal: str) -> str:
    known = model.known[signal]
    return f"{signal} [{known.unit}]" if known.unit != "1" else signal
