"""What the service answers (docs/control.md), as far as the workshop's test needs it."""

from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from faultline.service.core.errors import InputError
from faultline.service.core.events import Diagnosis
from faultline.service.core.faults import Fault as Remembered
from faultline.service.core.health import Standing
from faultline.service.core.manifest import Disturbance, Equation, Fault
from faultline.service.core.separating import Separation

T = TypeVar("T")


class Channel(msgspec.Struct, frozen=True):
    """A signal with its unit; `lower` and `upper` bound where the model holds."""

    signal: str
    unit: str
    lower: float
    upper: float


class Row(msgspec.Struct, frozen=True):
    """A residual generator: the test it belongs to, the signal it predicts, those it needs, the faults it knows."""

    name: str
    test: str
    predicts: str
    inputs: list[str]
    faults: list[str]


class System(msgspec.Struct, frozen=True):
    """What the names of a bundle mean; `period_s` [s] is a tick, `bundle` the SHA-256 of its manifest."""

    name: str
    bundle: str
    version: int
    sensor_set: str
    period_s: float
    inputs: list[Channel]
    generators: list[Row]
    faults: list[Fault]
    disturbances: list[Disturbance] = []
    equations: list[Equation] = []

    @property
    def tests(self) -> list[str]:
        """The tests, each once."""
        return list(dict.fromkeys(row.test for row in self.generators))


class Tick(msgspec.Struct, frozen=True):
    """A live line: samples `z` of the inputs in their units, and of each generator `y_hat`, `sums` and `usable`."""

    tick: int
    t_s: float
    mode: str
    z: list[float | None]
    quality: list[str]
    y_hat: list[float | None]
    sums: list[float | None]
    usable: list[bool]
    alarm: list[str]
    cannot_tell: list[str]
    suspected: bool
    diagnoses: list[Diagnosis]
    separating: list[Separation] = []
    bundle: str = ""

    def fits(self, system: System) -> bool:
        """Whether it is of that bundle, and has a value of each signal and generator."""
        signals, rows = len(system.inputs), len(system.generators)
        return (
            self.bundle in ("", system.bundle)
            and len(self.z) == len(self.quality) == signals
            and len(self.y_hat) == len(self.sums) == len(self.usable) == rows
        )


class Watched(msgspec.Struct, frozen=True):
    """A system that the service watches, and the bundle that decides."""

    name: str
    bundle: str


class State(msgspec.Struct, frozen=True):
    """How the service stands: vehicle, version, wall clock, what keeps it from telling, and its systems."""

    source: str
    version: str
    wall: str
    conditions: list[Standing]
    systems: list[Watched]
    is_recording: bool = False


class Memory(msgspec.Struct, frozen=True):
    """The fault memory."""

    faults: list[Remembered]


def read(answer: Mapping[str, Any], kind: type[T]) -> T:
    """The answer as what it should be.

    Raises:
        InputError: another version of faultline answers.
    """
    try:
        return msgspec.convert(answer, kind)
    except msgspec.ValidationError as error:
        raise InputError(
            f"the service answers as another version of faultline: {error}; use the `faultline` of its version"
        ) from error
