"""The freeze frame: what was seen when a fault was told, schema `faultline.frame/1`.

Source: snapshot and extended data of AUTOSAR diagnostic management; the excerpt around the event is what a diagnosis
engineer would have wanted to record.
"""

import msgspec

from faultline.service.core.events import Diagnosis

SCHEMA = "faultline.frame/1"


class Input(msgspec.Struct, frozen=True, kw_only=True):
    """A signal [unit]: its last good value (None: never one), how old that is [s], and what it was worth then."""

    signal: str
    unit: str
    value: float | None
    age_s: float | None
    quality: str


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """A residual generator: residual, prediction and spread [unit of what it predicts], CUSUM in parts of threshold."""

    generator: str
    test: str
    predicts: str
    residual: float
    predicted: float
    sigma: float
    sum: float
    verdict: str


class Excerpt(msgspec.Struct, frozen=True, kw_only=True):
    """The ticks around the event: numbers as columns, None where a signal could not be used or a test not tell."""

    first_tick: int
    period_s: float
    mode: list[str]
    signals: dict[str, list[float | None]]
    residuals: dict[str, list[float | None]]
    sums: dict[str, list[float]]


class Frame(msgspec.Struct, frozen=True, kw_only=True):
    """All that was known when `event` (its id) was told at `tick`, `t_s` [s] of log time.

    `counters` are those of the bus since the service started, `conditions` what kept it from telling (`kind: of`).
    `complete`: the excerpt reaches as far after the event as before it.
    """

    schema: str
    event: str
    wall: str | None
    bundle: str
    tick: int
    t_s: float
    mode: str
    inputs: list[Input]
    tests: list[Verdict]
    diagnoses: list[Diagnosis]
    alarm: list[str]
    cannot_tell: list[str]
    conditions: list[str]
    counters: dict[str, int]
    complete: bool
    excerpt: Excerpt
