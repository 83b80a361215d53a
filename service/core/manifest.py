"""The manifest of a bundle: everything the vehicle knows about its tests, as frozen data.

`service.bundle` reads it from a folder; the core computes with it. Units are SI: Pa, 1/s, 1 for ratios, s.
"""

from typing import Final, Literal

import msgspec

SCHEMA: Final = "faultline.bundle/1"

MODES = ("idle", "partial", "maximum", "edge")
"""Operating modes, in the order of every per-mode list: no dose, some dose, valve held open, just after a change."""


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common strictness: every field by name, no field unknown, nothing changes after loading."""


class File(_Part, frozen=True):
    """A file of the bundle: SHA-256 of its bytes and its size [bytes]."""

    sha256: str
    size: int


class Origin(_Part, frozen=True):
    """What the bundle was made from. The data sets of calibration and tuning (SHA-256 of the logs) are disjoint."""

    model: str
    model_sha256: str
    calibrate: list[str]
    tune: list[str]


class Input(_Part, frozen=True):
    """A column of `z`: a signal of the DBC in the bundle's unit; `lower` and `upper` bound the operating region."""

    signal: str
    unit: str
    maximum_age_s: float
    lower: float
    upper: float


class State(_Part, frozen=True):
    """A column of `x`; a fresh state is `offset + sum(gain[signal] * z[signal])`."""

    name: str
    offset: float
    gain: dict[str, float]


class Generator(_Part, frozen=True):
    """A residual generator: column `k` of the graph's outputs is generator `k` of the manifest's list.

    `faults` is its row of the structural fault signature matrix, `states` are its columns of `x` (consecutive, in
    order).
    """

    name: str
    test: str
    predicts: str
    inputs: list[str]
    states: list[State]
    faults: list[str]
    warm_up_ticks: int


class Modes(_Part, frozen=True):
    """How the operating mode follows from the samples.

    The mode is idle below `idle_below`, maximum above `maximum_above` of `signal`; it is *edge* for `settle_ticks`
    after an input has moved by more than its entry in `edges` from one tick to the next.
    """

    signal: str
    idle_below: float
    maximum_above: float
    edges: dict[str, float]
    settle_ticks: int


class Detector(_Part, frozen=True):
    """The two-sided CUSUM of one generator on (r - offset) / scale of the mode; drift `nu`, threshold `J`."""

    generator: str
    offset: list[float]
    scale: list[float]
    nu: float
    J: float


class Fault(_Part, frozen=True):
    """A fault and the component it names."""

    name: str
    component: str
    description: str


class Hypothesis(_Part, frozen=True):
    """What the residuals of the evidence generators do under a fault of one size: mean shift, (mode, generator) [Pa].

    Predicted by the model from fault-free recordings; no fault recording is needed or used.
    """

    fault: str
    size: float
    shift: list[list[float]]


class Evidence(_Part, frozen=True):
    """What ranks the faults that the alarms leave: predicted shifts, and how far a fault-free mean strays.

    `generators` are numerically independent (chosen by the rank of their covariance); `offset` (mode, generator) is the
    fault-free mean, `noise` (mode, generator, generator) [Pa^2] its long-run covariance per tick, `allowance` (mode,
    generator) [Pa] what calibration error and drive-to-drive spread may add.
    """

    generators: list[str]
    offset: list[list[float]]
    noise: list[list[list[float]]]
    allowance: list[list[float]]
    hypotheses: list[Hypothesis]


class Manifest(_Part, frozen=True):
    """One bundle. `files` covers every other file in the folder; `period_s` is the tick Ts."""

    schema: Literal["faultline.bundle/1"]
    name: str
    sensor_set: Literal["production", "instrumented"]
    period_s: float
    start_within_s: float
    dbc: str
    graph: str
    golden: str
    files: dict[str, File]
    origin: Origin
    inputs: list[Input]
    generators: list[Generator]
    modes: Modes
    detectors: list[Detector]
    faults: list[Fault]
    evidence: Evidence
