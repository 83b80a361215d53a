"""The event: the one thing a subscriber hears, in one schema, `faultline.event/1`.

Source: the CloudEvents idea of (source, id) as identity; the transitions are named after the status life cycle of
AUTOSAR diagnostic management.
"""

import re
from collections.abc import Sequence
from typing import Literal

import msgspec

SCHEMA = "faultline.event/1"

Transition = Literal["started", "suspected", "dismissed", "occurred", "refined", "healed", "withdrawn", "cannot_tell"]
"""started: the first tick was evaluated. suspected: a test alarms, and nothing is confirmed yet; *pending* in AUTOSAR's
terms. dismissed: nothing is suspected any more, or it is taken for what this day is like, and nothing was confirmed.
occurred: a fault was confirmed where there was none. refined: the explanations or their ranks changed. healed: no test
has alarmed for a while. withdrawn: what was confirmed rests on samples that came to be doubted, as of two senders, so
that nothing is known. cannot_tell: other tests than before cannot tell."""


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """One explanation of what is wrong: all of `faults` together; no name means that it is no known fault nor a pair.

    `rank` starts at 1; explanations the data cannot separate share a rank. `p` is the probability, with three digits,
    that it is this one if it is one of these; None before residuals have settled, and of two faults at once, for which
    no calibration curve stands behind it. What is unknown is `near` the equation that what explains it enters, as a
    leak does a balance; where nothing explains it, near those that all tests which deviate have in common.
    """

    faults: list[str]
    rank: int
    p: float | None
    near: list[str] = []


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """One transition of the diagnosis.

    `tick` and `t_s` [s] say when it was decided, in log time since the first tick; `since_tick` when the evidence began
    (the alarmed tests' CUSUM last left zero; or the suspicion, where none alarms), None where nothing is wrong.
    `suspected`: something is, and nothing is confirmed, whether a test alarms or not. `intermittent`: what is confirmed
    comes and goes, and explanations are not ranked. `alarm` and `cannot_tell` name
    tests; a test in neither is quiet. `wall` is the wall clock's time (RFC 3339) on a vehicle and None offline, so that
    offline events compare byte by byte. `bundle` is the SHA-256 of the manifest.
    """

    schema: str
    id: str
    seq: int
    tick: int
    t_s: float
    wall: str | None
    transition: Transition
    diagnoses: list[Diagnosis]
    alarm: list[str]
    cannot_tell: list[str]
    since_tick: int | None
    bundle: str
    suspected: bool = False
    intermittent: bool = False


def candidates(diagnoses: Sequence[Diagnosis]) -> list[tuple[tuple[str, ...], int, tuple[str, ...]]]:
    """What is new when it changes: names, ranks and places; a probability creeps."""
    return [(tuple(one.faults), one.rank, tuple(one.near)) for one in diagnoses]


def is_about(event: Event, source: str) -> bool:
    """Whether the event is of this vehicle (`<source>-<run>-<seq>`) or recording (`<source>-<seq>`)."""
    return re.fullmatch(rf"{re.escape(source)}(-[0-9a-f]{{8}})?-\d+", event.id) is not None


class _Header(msgspec.Struct):
    """What every record begins with."""

    schema: str


_ENCODER = msgspec.json.Encoder()
_DECODER = msgspec.json.Decoder(Event)
_HEADER = msgspec.json.Decoder(_Header)


def encode(event: Event) -> bytes:
    """The event as one line of JSON, newline included."""
    return _ENCODER.encode(event) + b"\n"


def schema_of(line: bytes) -> str:
    """What kind of record a line of JSON is; raises as `decode`."""
    return _HEADER.decode(line).schema


def is_other(line: bytes) -> bool:
    """Whether a line is a record of faultline's and no event: of health, of remembered faults; raises as `decode`."""
    schema = schema_of(line)
    return schema.startswith("faultline.") and not schema.startswith("faultline.event/")


def decode(line: bytes) -> Event:
    """The event in one line of JSON; raises `msgspec.DecodeError` or `msgspec.ValidationError`."""
    return _DECODER.decode(line)
