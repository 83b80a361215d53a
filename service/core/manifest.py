"""The manifest of a bundle: everything the vehicle knows about its tests, as frozen data.

`service.bundle` reads it from a folder; the core computes with it. Units are SI: Pa, 1/s, 1 for ratios, s.

The types here say what a single value may be, and decoding enforces it; what values must say of each other is in
`service.core.consistency`.
"""

from typing import Annotated, Final, Literal, TypeVar

import msgspec
from msgspec import Meta

SCHEMA: Final = "faultline.bundle/1"

MODES = ("idle", "partial", "maximum", "edge")
"""Operating modes, in the order of every per-mode list: no dose, some dose, valve held open, just after a change."""

T = TypeVar("T")

Name = Annotated[str, Meta(pattern=r"\A\w[\w.-]*\Z", max_length=80)]
Text = Annotated[str, Meta(pattern=r"\A[^\x00-\x1f\x7f]*\Z", max_length=1000)]  # it is printed in one line
Sha256 = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Period = Annotated[float, Meta(ge=1e-3)]  # shorter ones would keep the vehicle computing ticks for ever
Ticks = Annotated[int, Meta(ge=0, le=1_000_000)]
NotEmpty = Annotated[list[T], Meta(min_length=1)]
PerMode = Annotated[list[T], Meta(min_length=len(MODES), max_length=len(MODES))]


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common strictness: every field by name, no field unknown, nothing changes after loading."""


class File(_Part, frozen=True):
    """A file of the bundle: SHA-256 of its bytes and its size [bytes]."""

    sha256: Sha256
    size: Annotated[int, Meta(ge=0)]


class Origin(_Part, frozen=True):
    """What the bundle was made from: data sets by the SHA-256 of their logs.

    Those of tuning are none that the model was calibrated or the networks were trained with.
    """

    model: Text
    model_sha256: Sha256
    calibrate: list[Sha256]
    train: list[Sha256]
    tune: NotEmpty[Sha256]


class Input(_Part, frozen=True):
    """A column of `z`: a signal of the DBC in the bundle's unit; `lower` and `upper` bound the operating region."""

    signal: Name
    unit: Text
    maximum_age_s: Positive
    lower: float
    upper: float


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
    warm_up_ticks: Ticks


class Modes(_Part, frozen=True):
    """How the operating mode follows from the samples.

    The mode is idle below `idle_below`, maximum above `maximum_above` of `signal`; it is *edge* for `settle_ticks`
    after an input has moved by more than its entry in `edges` from one tick to the next.
    """

    signal: Name
    idle_below: float
    maximum_above: float
    edges: dict[Name, Positive]
    settle_ticks: Ticks


class Detector(_Part, frozen=True):
    """The two-sided CUSUM of one generator on (r - offset) / scale of the mode; drift `nu`, threshold `J`."""

    generator: Name
    offset: PerMode[float]
    scale: PerMode[Positive]
    nu: NotNegative
    J: Positive


class Fault(_Part, frozen=True):
    """A fault and the component it names."""

    name: Name
    component: Text
    description: Text


class Equation(_Part, frozen=True):
    """An equation of the model, by which an unknown fault is located."""

    name: Name
    description: Text


class Hypothesis(_Part, frozen=True):
    """A fault of one size, in the unit of its model; sizes of one sign are a chain that begins at none."""

    fault: Name
    size: float


class Evidence(_Part, frozen=True):
    """What confirms and ranks faults: the hypotheses, and how far a fault-free mean strays.

    `graph` is the file that has the evidence generators once per hypothesis, in their order, as rows of a batch. No
    fault recording is needed or used.

    `generators` are numerically independent (chosen by the rank of their covariance); `offset` (mode, generator) is the
    fault-free mean, `noise` (mode, generator, generator) [Pa^2] its covariance per tick, `visit` that of a visit to the
    mode besides, `allowance` (mode, generator) [Pa] what tuning cannot know of a single mean, `drifts` (drift, mode,
    generator) [Pa] by how much all means stray together from one drive to the next, a standard deviation each.
    """

    generators: NotEmpty[Name]
    offset: PerMode[list[float]]
    noise: PerMode[list[list[float]]]
    visit: PerMode[list[list[float]]]
    allowance: PerMode[list[NotNegative]]
    drifts: list[PerMode[list[float]]]
    graph: Name | None
    hypotheses: list[Hypothesis]


class Manifest(_Part, frozen=True):
    """One bundle. `files` covers every other file in the folder but the seal; `period_s` is the tick Ts."""

    schema: Literal["faultline.bundle/1"]
    name: Text
    sensor_set: Literal["production", "instrumented"]
    period_s: Period
    start_within_s: NotNegative
    dbc: Name
    graphs: NotEmpty[GraphFile]
    golden: Name
    files: dict[str, File]
    origin: Origin
    inputs: NotEmpty[Input]
    generators: NotEmpty[Generator]
    modes: Modes
    detectors: list[Detector]
    faults: list[Fault]
    equations: list[Equation]
    evidence: Evidence
