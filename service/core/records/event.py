"""Event: a transition of the diagnosis, in one schema, `faultline.event/1`.

Source: the CloudEvents idea of (source, id) as identity; the transitions are named after the status life cycle of
AUTOSAR diagnostic management.
"""

import re
from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

SCHEMA = "faultline.event/1"

Transition = Literal["started", "suspected", "dismissed", "occurred", "refined", "healed", "withdrawn", "cannot_tell"]
"""started: the first tick was evaluated. suspected: a test alarms, and nothing is confirmed yet; *pending* in AUTOSAR's
terms. dismissed: nothing is suspected any more, or it is taken for the drive's baseline, and nothing was confirmed.
occurred: a fault was confirmed where there was none. refined: the explanations or their ranks changed. healed: no test
has alarmed for a while. withdrawn: what was confirmed rests on samples that came to be doubted, as of two senders, so
that nothing is known. cannot_tell: other tests than before cannot tell."""


class Size(msgspec.Struct, frozen=True, kw_only=True):
    """How large a fault is, or what disturbs an equation: a 95 % interval."""

    low: Annotated[float, Meta(description="the least size, with its sign: less is negative")]
    high: Annotated[float, Meta(description="the largest")]
    unit: Annotated[str, Meta(description="of both: as people read it, `%` of a part")]
    of: Annotated[str, Meta(description="of what it is a part; empty where the size is no part of anything")] = ""


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """One explanation of what is wrong."""

    faults: Annotated[
        list[str],
        Meta(
            description="all of these together explain what is seen; empty: it is no fault of a component that the "
            "model knows, nor two (*unknown*)"
        ),
    ]
    rank: Annotated[int, Meta(description="from 1; explanations that the data cannot separate share a rank")]
    p: Annotated[
        float | None,
        Meta(
            description="probability, with three digits, that it is this one ([how well that "
            "holds](results/diagnosis.md)); null in the first 20 s, of two faults at once, of what comes "
            "and goes, and of an unknown where nothing fits. It is of the moment of telling: a change "
            "of `p` alone makes no event"
        ),
    ]
    near: Annotated[
        list[str],
        Meta(
            description="of what is unknown: with a `p`, the equation that explains it when something enters it that "
            "is no component's fault, as a leak enters a balance; without, those that all tests which "
            "deviate have in common (`faultline bundle show`). Empty, with a `p`: that the fault is none that the "
            "model knows, which is never out of the question"
        ),
    ] = []
    sizes: Annotated[
        list[Size],
        Meta(
            description="how large it is, of a single fault, or of what enters the equation in `near`, once the "
            "diagnosis has `settled`; of the moment of telling, as `p`; else empty"
        ),
    ] = []


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """One transition of the diagnosis. A test in neither `alarm` nor `cannot_tell` is quiet."""

    schema: Annotated[str, Meta(description="`faultline.event/1`")]
    id: Annotated[
        str,
        Meta(
            description="`<source>-<run>-<seq>`: the vehicle's name, eight digits that each start of the service "
            "draws, and the number; `<source>-<seq>` of a recording"
        ),
    ]
    seq: Annotated[int, Meta(description="number of the event, from 1")]
    tick: Annotated[int, Meta(description="sample at which it was decided, from 0")]
    t_s: Annotated[
        float,
        Meta(
            description="the same in seconds of log time since sample 0, which is 45 ms after all signals are first "
            "known: up to some seconds after the log's first frame"
        ),
    ]
    wall: Annotated[
        str | None,
        Meta(description="wall clock (RFC 3339) on a vehicle, null for a log: so events of a log compare byte by byte"),
    ]
    transition: Annotated[Transition, Meta(description="see below")]
    diagnoses: Annotated[
        list[Diagnosis],
        Meta(description="explanations of a confirmed fault, best first; they stand until it has healed"),
    ]
    alarm: Annotated[list[str], Meta(description="tests that alarm")]
    cannot_tell: Annotated[
        list[str],
        Meta(
            description="tests that cannot tell (stale or invalid input, outside their operating region, or in the "
            "warm-up after either)"
        ),
    ]
    since_tick: Annotated[
        int | None,
        Meta(
            description="sample at which the evidence began, or the suspicion where no test alarms; null where "
            "nothing is wrong: a sum may have left zero by chance some seconds before the onset"
        ),
    ]
    bundle: Annotated[str, Meta(description="SHA-256 of the manifest of the bundle that decided")]
    suspected: Annotated[
        bool,
        Meta(
            description="something is, and nothing is confirmed: a test alarms, or the residuals together have "
            "changed, though none does. An alarm of networks beside equations alone is one once it has lasted 20 s"
        ),
    ] = False
    intermittent: Annotated[
        bool,
        Meta(
            description="what is confirmed comes and goes: explanations are those that the tests allow, all of one "
            "rank and without `p`"
        ),
    ] = False
    settled: Annotated[
        bool,
        Meta(
            description="the explanations rest on how far residuals deviate in each mode; before, some 20 s, they are "
            "those that the tests allow, and names may be missing or too many"
        ),
    ] = False


def candidates(diagnoses: Sequence[Diagnosis]) -> list[tuple[tuple[str, ...], int, tuple[str, ...]]]:
    """Return what makes diagnoses new when it changes: names, ranks and places; a probability creeps."""
    return [(tuple(one.faults), one.rank, tuple(one.near)) for one in diagnoses]


def is_about(event: Event, source: str) -> bool:
    """Return True if the event is of this vehicle (`<source>-<run>-<seq>`) or recording (`<source>-<seq>`)."""
    return re.fullmatch(rf"{re.escape(source)}(-[0-9a-f]{{8}})?-\d+", event.id) is not None


class _Header(msgspec.Struct):
    """Header of every record."""

    schema: str


_DECODER = msgspec.json.Decoder(Event)
_HEADER = msgspec.json.Decoder(_Header)


def schema_of(line: bytes) -> str:
    """Return the schema of a record in a line of JSON; raises as `decode`."""
    return _HEADER.decode(line).schema


def is_other(line: bytes) -> bool:
    """Return True if a line is a record of faultline's and no event: health, remembered faults; raises as `decode`."""
    schema = schema_of(line)
    return schema.startswith("faultline.") and not schema.startswith("faultline.event/")


def decode(line: bytes) -> Event:
    """Return the event in one line of JSON; raises `msgspec.DecodeError` or `msgspec.ValidationError`."""
    return _DECODER.decode(line)
