"""The recordings of a study: to fit and held out, with what makes them unfit for it said before a minute is spent."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from faultline.analysis.calibration.provenance import check_id, check_vehicle, recordings_of, vehicle_of
from faultline.analysis.calibration.sections import Section, sections
from faultline.analysis.discrepancy.effects.compiled import system_with
from faultline.analysis.model import Model, dump_model
from faultline.analysis.recordings.observe import open_for
from faultline.analysis.simulation import System
from faultline.service.core.errors import InputError
from faultline.service.logs import Log

STEP = 0.5
"""Of the free runs, in periods: models are compared on the same grid, and half the calibration's takes half."""

LEAST = 3.0
"""Settling times in a mode, over all recordings of a kind: less shows little of what happens there only."""


@dataclass(frozen=True)
class Data:
    """The logs and their sections; `key` is a hash of the model and of all logs.

    With `same_conditions` nothing that has a drift in the model changed from one recording to the next.
    """

    model: Model
    system: System
    training: tuple[Log, ...]
    held: tuple[Log, ...]
    training_sections: tuple[Section, ...]
    held_sections: tuple[Section, ...]
    same_conditions: bool = False

    @property
    def studied(self) -> Model:
        """The model as these recordings are compared with it."""
        return self.model.without_drifts() if self.same_conditions else self.model

    @property
    def key(self) -> str:
        """A hash of what was measured and of the model that is studied."""
        logs = [*(log.sha256 for log in self.training), "held out", *(log.sha256 for log in self.held)]
        text = "\n".join([dump_model(self.studied), *logs])
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def vehicle(self) -> str | None:
        """The vehicle of the first recording."""
        return self.training[0].recording.vehicle if self.training[0].recording else None

    @property
    def sources(self) -> list[str]:
        """Where the recordings are from, as they say."""
        return sorted({log.recording.source for log in (*self.training, *self.held) if log.recording})

    def gaps(self) -> Iterator[str]:
        """What the recordings lack, in sentences: nothing can be found where nothing was measured."""
        least_s = LEAST * self.model.settling_s
        for title, found in (("training", self.training_sections), ("held-out", self.held_sections)):
            for k, name in enumerate(self.model.modes.names[1:], start=1):
                seconds = sum(_seconds(section, k) for section in found)
                if seconds < least_s:
                    yield f"the {title} recordings have {seconds:.0f} s of mode {name}; record {least_s:.0f} s of it"


def _seconds(section: Section, mode: int) -> float:
    """How long an output that tells was compared in a mode [s]."""
    s = next(iter(section.samples.values()))
    return float(np.sum(s.mode == mode) * np.median(np.diff(s.t)))


def load(
    model: Model,
    training: Sequence[Path],
    held: Sequence[Path],
    note: Callable[[str], None],
    *,
    same_conditions: bool = False,
) -> Data:
    """The study's recordings, which may have been made under the same conditions.

    Raises:
        InputError: one cannot be read, is given twice, is of another vehicle, or has nothing to fit a model to.
    """
    if not model.calibrated:
        raise InputError(f"{model.name}: no parameter has a prior; give `prior` to those that shall be calibrated")
    system = system_with(model, ())
    logs: dict[str, Path] = {}
    found: list[tuple[Log, list[Section]]] = []
    for path in (*training, *held):
        log = open_for(model, path, note)
        if log.drive in logs:
            raise InputError(
                f"{path}: the same recording as {logs[log.drive]}; evidence needs recordings that the fit has not "
                "seen, record another drive"
            )
        if path in held and log.drive in recordings_of(model):
            raise InputError(
                f"{path}: {model.name} was made from this recording, so it is no evidence; hold another one out"
            )
        check_id(log, path, (other.id for other, _ in found))
        logs[log.drive] = path
        first = found[0][0] if found else log
        check_vehicle(log, path, first.recording.vehicle if first.recording else None, str(training[0]))
        check_vehicle(log, path, vehicle_of(model), f"the calibration of {model.name}")
        signals = log.signals(log.table({name: known.unit for name, known in model.known.items()}, str(path)))
        found.append((log, sections(model, system, signals, str(path), STEP)))
    fitted, kept = found[: len(training)], found[len(training) :]
    return Data(
        model=model,
        system=system,
        training=tuple(log for log, _ in fitted),
        held=tuple(log for log, _ in kept),
        training_sections=tuple(section for _, part in fitted for section in part),
        held_sections=tuple(section for _, part in kept for section in part),
        same_conditions=same_conditions,
    )
