"""Live ticks, the ticks of a recording, and the meaning of the names in both."""

from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.display import Display
from faultline.service.core.manifest import EDGE
from faultline.service.core.records.discrimination import Separation
from faultline.service.core.records.event import Diagnosis
from faultline.service.core.time_scale import TimeScale

LIVE = "faultline.live/2"
"""Schema of `LiveTick`; in 1 `suspected` was what `anomaly` is now."""

SUSPECTED = "as in an event: something is suspected, and nothing is confirmed"
ANOMALY = "a test alarms, or the residuals together have changed, whether that is confirmed or not"


class Signal(msgspec.Struct, frozen=True, kw_only=True):
    """An input, a column of `z`."""

    signal: Annotated[str, Meta(description="its name")]
    unit: Annotated[str, Meta(description="its unit")]
    lower: Annotated[float, Meta(description="the model holds from here")] = float("-inf")
    upper: Annotated[float, Meta(description="to here")] = float("inf")
    label: Annotated[str, Meta(description="its name for people, empty where there is none")] = ""
    display: Annotated[list[Display], Meta(description="units that people read it in, coarse to fine")] = []


class GeneratorMeaning(msgspec.Struct, frozen=True, kw_only=True):
    """A residual generator, a column of `y_hat`, `r`, `sigma`, `sums` and `usable`."""

    name: Annotated[str, Meta(description="its name")] = ""
    test: Annotated[str, Meta(description="the test it belongs to")]
    predicts: Annotated[str, Meta(description="the signal that it predicts")]
    inputs: Annotated[list[str], Meta(description="the signals it needs")] = []
    faults: Annotated[list[str], Meta(description="its row of the fault signature matrix")]


class FaultMeaning(msgspec.Struct, frozen=True, kw_only=True):
    """Meaning of a fault's name."""

    name: Annotated[str, Meta(description="its name")]
    component: Annotated[str | None, Meta(description="the component that fails")] = None
    description: Annotated[str | None, Meta(description="how")] = None
    spn: Annotated[int | None, Meta(description="suspect parameter number (SAE J1939-73)")] = None
    fmi: Annotated[int | None, Meta(description="failure mode identifier")] = None
    place: Annotated[str, Meta(description="where the component is, empty where that is not said")] = ""


class EquationMeaning(msgspec.Struct, frozen=True, kw_only=True):
    """Meaning of an equation's name."""

    name: Annotated[str, Meta(description="its name")]
    description: Annotated[str, Meta(description="what it balances")]


class DisturbanceMeaning(msgspec.Struct, frozen=True, kw_only=True):
    """Disturbance of an equation that is no component's fault."""

    name: Annotated[str, Meta(description="its name")]
    equation: Annotated[str, Meta(description="the equation it enters")]
    description: Annotated[str, Meta(description="what it is")]


class SystemDescription(msgspec.Struct, frozen=True, kw_only=True):
    """Meaning of the names of a bundle."""

    name: Annotated[str, Meta(description="of the system")]
    bundle: Annotated[str, Meta(description="SHA-256 of the manifest")]
    version: Annotated[int, Meta(description="of the bundle")] = 0
    sensor_set: Annotated[str, Meta(description="which sensors the vehicle has")] = ""
    period_s: Annotated[float, Meta(description="time between two samples [s]")]
    settling_s: Annotated[float, Meta(description="time after which the slowest state has forgotten its start [s]")] = (
        0.0
    )
    modes: Annotated[
        list[str], Meta(description="names of the operating modes, as in lists by mode; `edge` first")
    ] = []
    instructions: Annotated[dict[str, str], Meta(description="what brings a mode about, for a technician")] = {}
    inputs: Annotated[list[Signal], Meta(description="signals, in the order of `z` and `quality`")]
    generators: Annotated[list[GeneratorMeaning], Meta(description="in the order of `y_hat` to `usable`")]
    detectors: Annotated[list[dict[str, object]], Meta(description="with their thresholds, as in the manifest")] = []
    faults: Annotated[list[FaultMeaning], Meta(description="those that the model knows")]
    disturbances: Annotated[list[DisturbanceMeaning], Meta(description="what may enter equations besides")] = []
    equations: Annotated[list[EquationMeaning], Meta(description="those that what is unknown can be near")] = []

    @property
    def time(self) -> TimeScale:
        """Ticks and settling times."""
        return TimeScale(self.period_s, self.settling_s)

    @property
    def steady(self) -> list[str]:
        """The operating modes but the edge."""
        return [mode for mode in self.modes if mode != EDGE]

    @property
    def tests(self) -> list[str]:
        """The tests, each once."""
        return list(dict.fromkeys(row.test for row in self.generators))


class LiveTick(msgspec.Struct, frozen=True, kw_only=True):
    """One sample of a system, with what its generators, tests and decision make of it."""

    schema: Annotated[str, Meta(description=f"`{LIVE}`")] = LIVE
    system: Annotated[str, Meta(description="its name")]
    bundle: Annotated[str, Meta(description="SHA-256 of the manifest: its names are those of that one")]
    tick: Annotated[int, Meta(description="number of the sample, from 0")]
    t_s: Annotated[float, Meta(description="the same in seconds of log time")]
    mode: Annotated[str, Meta(description="operating mode")]
    z: Annotated[list[float | None], Meta(description="each input in its unit; null: it never came")]
    quality: Annotated[list[str], Meta(description="of each input: `good`, or why it cannot be used")]
    y_hat: Annotated[list[float | None], Meta(description="of each generator its prediction, in that signal's unit")]
    r: Annotated[list[float | None], Meta(description="its residual, in the same unit")]
    sigma: Annotated[list[float | None], Meta(description="the residual's spread without a fault, in the same unit")]
    sums: Annotated[
        list[float | None], Meta(description="its largest detector in parts of the threshold, with the residual's sign")
    ]
    usable: Annotated[list[bool], Meta(description="it can tell")]
    alarm: Annotated[list[str], Meta(description="as in an event")]
    cannot_tell: Annotated[list[str], Meta(description="as in an event")]
    suspected: Annotated[bool, Meta(description=SUSPECTED)]
    anomaly: Annotated[bool, Meta(description=ANOMALY)]
    diagnoses: Annotated[list[Diagnosis], Meta(description="as in an event")]
    separating: Annotated[
        list[Separation], Meta(description="of each pair of the best explanations the tests that tell them apart")
    ] = []

    def fits(self, system: SystemDescription) -> bool:
        """True if it is of that bundle, and has a value of each signal and generator."""
        signals, rows = len(system.inputs), len(system.generators)
        return (
            self.bundle == system.bundle
            and len(self.z) == len(self.quality) == signals
            and len(self.y_hat) == len(self.sums) == len(self.usable) == rows
        )


class Stand(msgspec.Struct, frozen=True, kw_only=True):
    """Decision from a tick of a recording on, until the next one."""

    tick: Annotated[int, Meta(description="the first")]
    alarm: Annotated[list[str], Meta(description="as in an event")]
    cannot_tell: Annotated[list[str], Meta(description="as in an event")]
    suspected: Annotated[bool, Meta(description=SUSPECTED)]
    anomaly: Annotated[bool, Meta(description=ANOMALY)]
    diagnoses: Annotated[list[Diagnosis], Meta(description="as in an event")]
    separating: Annotated[list[Separation], Meta(description="as in a live tick")] = []


Column = dict[str, list[float | None]]


class History(msgspec.Struct, frozen=True, kw_only=True):
    """Ticks of a recording as columns; null where a signal could not be used, or a generator could not tell."""

    name: Annotated[str | None, Meta(description="of the system, as asked")]
    every: Annotated[int, Meta(description="of so many ticks one is here, that with the largest sum")]
    latest: Annotated[int | None, Meta(description="the last tick of the recording")]
    tick: Annotated[list[int], Meta(description="numbers of the samples")]
    t_s: Annotated[list[float], Meta(description="the same in seconds of log time")]
    mode: Annotated[list[str], Meta(description="operating modes")]
    z: Annotated[Column, Meta(description="inputs, by name")]
    quality: Annotated[dict[str, list[str]], Meta(description="of each input, by name")]
    y_hat: Annotated[Column, Meta(description="predictions, by generator")]
    r: Annotated[Column, Meta(description="residuals")]
    sigma: Annotated[Column, Meta(description="their spread without a fault")]
    sums: Annotated[Column, Meta(description="the largest detector in parts of the threshold")]
    stands: Annotated[list[Stand], Meta(description="what the decision says, where that changes")]
