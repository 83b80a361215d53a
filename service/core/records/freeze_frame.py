"""Freeze frame: the state when an event was published, schema `faultline.frame/1`.

Source: snapshot and extended data of AUTOSAR diagnostic management; the excerpt around the event is what a diagnosis
engineer would have wanted to record.
"""

from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.records.event import Diagnosis

SCHEMA = "faultline.frame/1"


class Input(msgspec.Struct, frozen=True, kw_only=True):
    """Value of a signal."""

    signal: Annotated[str, Meta(description="its name")]
    unit: Annotated[str, Meta(description="its unit")]
    value: Annotated[float | None, Meta(description="the last good value; null: never one")]
    age_s: Annotated[float | None, Meta(description="how old that is [s]")]
    quality: Annotated[str, Meta(description="`good`, or why it cannot be used")]


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a residual generator."""

    generator: Annotated[str, Meta(description="its name")]
    test: Annotated[str, Meta(description="the test it belongs to")]
    predicts: Annotated[str, Meta(description="the signal that it predicts")]
    residual: Annotated[float, Meta(description="in that signal's unit")]
    predicted: Annotated[float, Meta(description="in the same unit")]
    sigma: Annotated[float, Meta(description="spread of the residual without a fault, in the same unit")]
    sum: Annotated[float, Meta(description="its detector in parts of the threshold, with the residual's sign")]
    verdict: Annotated[str, Meta(description="`alarm`, `quiet` or `cannot tell`")]


class Excerpt(msgspec.Struct, frozen=True, kw_only=True):
    """The samples around the event, as columns."""

    first_tick: Annotated[int, Meta(description="the first sample")]
    period_s: Annotated[float, Meta(description="time between two [s]")]
    mode: Annotated[list[str], Meta(description="operating mode, by sample")]
    signals: Annotated[dict[str, list[float | None]], Meta(description="by name; null where it could not be used")]
    residuals: Annotated[dict[str, list[float | None]], Meta(description="by generator; null where it could not tell")]
    sums: Annotated[dict[str, list[float]], Meta(description="its detector in parts of the threshold")]


class FreezeFrame(msgspec.Struct, frozen=True, kw_only=True):
    """Freeze frame: all that was known at an event."""

    schema: Annotated[str, Meta(description="`faultline.frame/1`")]
    event: Annotated[str, Meta(description="id of the event")]
    wall: Annotated[str | None, Meta(description="of the event")]
    bundle: Annotated[str, Meta(description="of the event")]
    tick: Annotated[int, Meta(description="of the event")]
    t_s: Annotated[float, Meta(description="of the event")]
    mode: Annotated[str, Meta(description="operating mode")]
    inputs: Annotated[list[Input], Meta(description="every signal")]
    tests: Annotated[list[Verdict], Meta(description="every residual generator")]
    diagnoses: Annotated[list[Diagnosis], Meta(description="as in the event")]
    alarm: Annotated[list[str], Meta(description="as in the event")]
    cannot_tell: Annotated[list[str], Meta(description="as in the event")]
    conditions: Annotated[list[str], Meta(description="what kept the service from telling, as `kind: of`")]
    counters: Annotated[
        dict[str, int],
        Meta(description="of the bus since the service started: `frames`, `dropped`, `errors` and so on"),
    ]
    complete: Annotated[
        bool,
        Meta(
            description="the excerpt reaches as far after the event as before it; else the service was stopped before"
        ),
    ]
    excerpt: Annotated[Excerpt, Meta(description="the samples around the event")]
