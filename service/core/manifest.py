"""The manifest of a bundle: everything the vehicle knows about its tests, as frozen data.

`service.bundle.load` reads it from a folder; the core computes with it. Units are SI: Pa, 1/s, 1 for ratios, s.

The types say what a single value may be; what values must say of each other is in `core.decision.consistency`.
"""

from typing import Annotated, Final, Literal, TypeVar

import msgspec
from msgspec import Meta

from faultline.service.core.display import Display
from faultline.service.core.time_scale import TimeScale

SCHEMA: Final = "faultline.bundle/7"

EDGE: Final = "edge"
"""The first mode of every per-mode list: just after a step, or unknown. Those of the system follow."""

T = TypeVar("T")
Name = Annotated[str, Meta(pattern=r"\A\w[\w.-]*\Z", max_length=80)]
Text = Annotated[str, Meta(pattern=r"\A[^\x00-\x1f\x7f]*\Z", max_length=1000)]  # it is printed in one line
Sha256 = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Period = Annotated[float, Meta(ge=1e-3, le=60)]  # shorter ones would keep the vehicle computing ticks for ever
Seconds = Annotated[float, Meta(ge=0, le=1e7)]
Address = Annotated[int, Meta(ge=0, le=253)]
"""A source address of SAE J1939."""
Unit = tuple[Text, Text, float, float]  # of the DBC, of the bundle, factor, offset
Version = Annotated[int, Meta(ge=0, le=2**53)]
Side = Literal["both", "above", "below"]
NotEmpty = Annotated[list[T], Meta(min_length=1)]
PerMode = Annotated[list[T], Meta(min_length=2)]


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common strictness: every field by name, no field unknown, nothing changes after loading."""


class File(_Part, frozen=True):
    """A file of the bundle: SHA-256 of its bytes and its size [bytes]."""

    sha256: Sha256
    size: Annotated[int, Meta(ge=0)]


class Origin(_Part, frozen=True):
    """Provenance: the data and vehicle of the bundle; data sets by the SHA-256 of the drive's first log.

    Those of tuning are none that the model was calibrated or the networks were trained with. `base` is the tuning of
    other vehicles that was adapted to this one.
    """

    model: Text
    model_sha256: Sha256
    calibrate: list[Sha256]
    train: list[Sha256]
    tune: NotEmpty[Sha256]
    base: Sha256 | None = None
    vehicle: Text | None = None


class Input(_Part, frozen=True, omit_defaults=True):
    """A column of `z`: a signal of the DBC in the bundle's unit; `lower` and `upper` bound the operating region.

    A value that has not changed for `frozen_s` within the operating region, or that lies by more than `largest_step`
    [unit] from the last one, is not believed; without them any value is. One that lies by more than `outlier` [unit]
    from the last ones may be held back (`core.signals.gate`). Its message's frames are known to come by up to
    `jitter_s` too soon (`core.signals.arrivals`). People read `label` and `display`'s units.
    """

    signal: Name
    unit: Text
    maximum_age_s: Positive
    lower: float
    upper: float
    frozen_s: Positive | None = None
    largest_step: Positive | None = None
    outlier: Positive | None = None
    jitter_s: Positive | None = None
    label: Text = ""
    display: list[Display] = []


class GraphFile(_Part, frozen=True):
    """A fused graph among the files.

    `tolerance` is how far a replayed golden residual may be from the exported one, in parts of the residual's sigma:
    another processor rounds differently, no more.
    """

    file: Name
    tolerance: Positive


class State(_Part, frozen=True):
    """A column of `x`; a fresh state is `offset + sum(gain[signal] * z[signal])`."""

    name: Name
    offset: float
    gain: dict[Name, float]


class Generator(_Part, frozen=True):
    """A residual generator: a column of the outputs of its `graph`, whose generators are listed in their order.

    `faults` is its row of the structural fault signature matrix, `equations` are those of the model that it uses,
    `states` are its columns of `x` (consecutive, in order).
    """

    name: Name
    test: Name
    graph: Name
    predicts: Name
    inputs: NotEmpty[Name]
    states: list[State]
    faults: list[Name]
    equations: list[Name]
    warm_up_s: Seconds


class Bounds(_Part, frozen=True, omit_defaults=True):
    """An open interval of a signal; None is no bound."""

    above: float | None = None
    below: float | None = None


class Mode(_Part, frozen=True, omit_defaults=True):
    """An operating mode: it holds where every signal of `where` is within its bounds.

    `description` is what it is, `instruction` what somebody does who brings the system there.
    """

    name: Name
    where: dict[Name, Bounds] = {}
    description: Text = ""
    instruction: Text = ""


class Modes(_Part, frozen=True):
    """Rules that derive the operating mode from the samples.

    It is the first of the `steady` ones that holds; the one without bounds holds where no other does. It is *edge* for
    `settle_s` after an input has moved by more than its entry in `edges` within a quarter of that time, and where a
    signal of the bounds cannot be used.
    """

    steady: NotEmpty[Mode]
    edges: dict[Name, Positive]
    settle_s: Seconds

    @property
    def names(self) -> tuple[str, ...]:
        """The modes in the order of every per-mode list."""
        return EDGE, *(mode.name for mode in self.steady)


class _Detector(_Part, frozen=True, tag_field="kind"):
    """A test of one generator on (r - offset) / scale of the mode [unit of r]."""

    generator: Name
    offset: PerMode[float]
    scale: PerMode[Positive]


class CusumDetector(_Detector, frozen=True, tag="cusum"):
    """A CUSUM with drift `nu` and threshold `J`, of both sides or of one (`service.core.detectors.cusum`)."""

    nu: NotNegative
    J: Positive
    side: Side = "both"


class ThresholdDetector(_Detector, frozen=True, tag="threshold"):
    """Threshold `J` on the residual of a tick, held for `hold_s` (`service.core.detectors.threshold`)."""

    J: Positive
    hold_s: Seconds


class LowPassDetector(_Detector, frozen=True, tag="low-pass"):
    """Threshold `J` behind a low-pass filter of `time_s` (`service.core.detectors.low_pass`)."""

    J: Positive
    hold_s: Seconds
    time_s: Seconds


class AdaptiveDetector(_Detector, frozen=True, tag="adaptive"):
    """Threshold `J` that follows the generator's sigma, `usual` in the mode (`service.core.detectors.adaptive`)."""

    J: Positive
    hold_s: Seconds
    usual: PerMode[Positive]


class SpreadDetector(_Detector, frozen=True, tag="spread"):
    """Threshold `J` on a variance ratio's |z|, of windows up to `memory_s` (`service.core.detectors.spread`)."""

    J: Positive
    hold_s: Seconds
    memory_s: Seconds


Detector = CusumDetector | ThresholdDetector | LowPassDetector | AdaptiveDetector | SpreadDetector


class Fault(_Part, frozen=True, omit_defaults=True):
    """A fault of a component at a `place`; on a J1939 network the suspect parameter `spn` with the mode `fmi`."""

    name: Name
    component: Text
    description: Text
    spn: Annotated[int, Meta(ge=1, le=524_286)] | None = None
    fmi: Annotated[int, Meta(ge=0, le=31)] | None = None
    place: Text = ""


class Equation(_Part, frozen=True):
    """An equation of the model, by which an unknown fault is located."""

    name: Name
    description: Text


class Disturbance(_Part, frozen=True):
    """Disturbance of an equation that is no component's fault, as a leak: the component is then unknown."""

    name: Name
    equation: Name
    description: Text


class Hypothesis(_Part, frozen=True):
    """A fault or a disturbance of one size, in its model's unit; sizes of one sign are a chain that begins at none.

    In a second form of the fault its size is the fraction by which a parameter changes, `share_of`. With a consequence,
    `brought` is the size of the fault that is brought, as its second form says it, if it has one. One of which a drive
    without a fault may seem to have a little, the smallest size of each form at least, has its `usual` shift of the
    residuals (mode, generator) [Pa], a mean over fault-free drives (`core.decision.baseline`).
    """

    fault: Name
    size: float
    share_of: Name | None = None
    brought: float | None = None
    usual: PerMode[list[float]] | None = None


class SizeUnit(_Part, frozen=True, omit_defaults=True):
    """How people read the sizes of a form of a fault: the unit, and of what it is a part."""

    fault: Name
    display: Display
    share_of: Name | None = None
    of: Text = ""


class Consequence(_Part, frozen=True):
    """Consequence of a severe `fault`: it brings the effect of fault `brings` where the signals are within bounds."""

    fault: Name
    brings: Name
    where: dict[Name, Bounds]


class Follower(_Part, frozen=True):
    """Generator that is no evidence: its baseline follows from that of those that are.

    Of every mode `offset`, `spread` and by drift how far it moves [Pa], as in `Evidence`.
    """

    generator: Name
    offset: PerMode[float]
    spread: PerMode[Positive]
    drifts: list[PerMode[float]]


class Twin(_Part, frozen=True):
    """Generator, a network, of the test of `twin`, one of the equations' generators: its baseline is that one's.

    Of every mode `offset`, `spread` as in `Evidence`, and `allowance`: how far the two stray apart from drive to drive.
    """

    generator: Name
    twin: Name
    offset: PerMode[float]
    spread: PerMode[Positive]
    allowance: PerMode[NotNegative]


class Evidence(_Part, frozen=True):
    """Evidence that confirms and ranks faults: the hypotheses, and the spread of a fault-free mean.

    `graph` is the file that has the evidence generators once per hypothesis, in their order, as rows of a batch. No
    fault recording is needed or used. `generators` are numerically independent (chosen by the rank of their
    covariance). Of each in every mode: `offset` [Pa] is the fault-free mean, `spread` that of a tick within a drive,
    `noise` (mode, generator, generator) [Pa^2] the covariance of ticks, `visit` that of visits to the mode besides.
    From one day to the next a mean strays by `allowance` (mode, generator) [Pa], and all together by `drifts` (drift,
    mode, generator) [Pa], a standard deviation each (`core.decision.straying`). These move the `followers` too,
    and all of that the `networks`. `sigma` is, of generators that say how large their error is, what that usually is
    at most (`core.decision.model_error`).
    `operation` (mode, generator) is the usual mean of the signals that are predicted. Faults have `consequences`, at
    most one each; hypotheses with one are behind the others. `sizes` say how people read those of a fault. Without a
    fault a change of the baseline is suspected every `run_length_h` [h] on average (`core.decision.drive_change`).
    """

    generators: NotEmpty[Name]
    offset: PerMode[list[float]]
    spread: PerMode[list[Positive]]
    noise: PerMode[list[list[float]]]
    visit: PerMode[list[list[float]]]
    allowance: PerMode[list[NotNegative]]
    drifts: list[PerMode[list[float]]]
    operation: PerMode[list[float]]
    followers: list[Follower]
    graph: Name | None
    hypotheses: list[Hypothesis]
    consequences: list[Consequence] = []
    sizes: list[SizeUnit] = []
    run_length_h: Positive = 10.0
    networks: list[Twin] = []
    sigma: dict[Name, PerMode[Positive]] = {}

    @property
    def simple(self) -> int:
        """The number of hypotheses without a consequence."""
        return sum(hypothesis.brought is None for hypothesis in self.hypotheses)


class Count(_Part, frozen=True):
    """Events `count` in `hours`, on drives that tuning had left out.

    `upper` [1/h] is the exact 95 % upper bound of a Poisson rate, None without an hour; `low` and `high` [1/h] span
    95 % of the rates that a bootstrap over vehicles (over drives, where there is one vehicle) gives.
    """

    count: Annotated[int, Meta(ge=0)]
    hours: NotNegative
    upper: Positive | None
    low: NotNegative
    high: NotNegative


class Claim(_Part, frozen=True):
    """False alarms in fault-free recordings: suspicions, of detectors or of the evidence, and diagnoses.

    Of all the drives, so many were `left_out` of tuning in turn, and counted on. `target` [1/h] is of suspicions:
    *shown* where the upper bound is below it, *kept* where only the rate is, *missed* where that is not.
    `extrapolated`: the recordings were too short for the target, a tail was drawn on. `said` is all of that as a
    sentence.
    """

    drives: Annotated[int, Meta(ge=1)]
    vehicles: Annotated[int, Meta(ge=1)]
    left_out: Annotated[int, Meta(ge=0)]
    suspicions: Count
    diagnoses: Count
    target: Positive | None
    result: Literal["shown", "kept", "missed"] | None
    extrapolated: bool
    said: Text


class Manifest(_Part, frozen=True, omit_defaults=True):
    """One bundle. `files` covers every other file in the folder but the seal; `period_s` is the tick Ts.

    After `settling_s` the slowest state of the system has forgotten where it started: how long things last is counted
    in that (`TimeScale`). `version` counts up from one bundle of this name to the next: a vehicle takes none that is
    older than one it had. The first `detectors` are one for each generator, in the same order, and test its level; more
    may follow. Without a `dbc` signals come in tables. `senders` are the source addresses that were chosen for messages
    of the DBC, by their names; `buses` the names of the buses on which messages come, where the vehicle has several.
    `signals` are the DBC's names (SIGNAL or MESSAGE.SIGNAL) of inputs that have other ones there, `units` its units
    that are uncommon.
    """

    schema: Literal["faultline.bundle/7"]
    name: Text
    version: Version
    sensor_set: Literal["production", "instrumented"]
    period_s: Period
    settling_s: Positive
    start_within_s: NotNegative
    graphs: NotEmpty[GraphFile]
    golden: Name
    files: dict[str, File]
    origin: Origin
    inputs: NotEmpty[Input]
    generators: NotEmpty[Generator]
    modes: Modes
    detectors: list[Detector]
    faults: list[Fault]
    disturbances: list[Disturbance]
    equations: list[Equation]
    evidence: Evidence
    claim: Claim | None = None
    dbc: Name | None = None
    senders: dict[Name, Address] = {}
    buses: dict[Name, Name] = {}
    signals: dict[Name, Name] = {}
    units: list[Unit] = []

    @property
    def time(self) -> TimeScale:
        """Ticks and settling times of the system."""
        return TimeScale(self.period_s, self.settling_s)
