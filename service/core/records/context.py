"""The context record: what other devices on the bus say of themselves, as far as it bears on a diagnosis.

Trouble codes of J1939 (SAE J1939-73): DM1 tells the active ones, DM2 those that were active before. A record is made
when lamps or codes of a sender change, and when it falls silent; it decides nothing.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

SCHEMA = "faultline.context/1"

LampState = Literal["off", "on", "slow", "fast", "error", "none"]


class TroubleCode(msgspec.Struct, frozen=True, kw_only=True):
    """A trouble code of another device."""

    spn: Annotated[int, Meta(description="suspect parameter, by conversion version 4")]
    fmi: Annotated[int, Meta(description="failure mode")]
    count: Annotated[int | None, Meta(description="how often it has become active; null where nobody counts")]
    other_spns: Annotated[
        list[int],
        Meta(
            description="where the sender marks an older layout (conversion method 1) and does not say which: what the "
            "SPN is by version 1 and by version 2; `spn` is by version 3"
        ),
    ] = []


class LampStates(msgspec.Struct, frozen=True, kw_only=True):
    """The lamps that a device asks for."""

    malfunction: Annotated[
        LampState,
        Meta(
            description="malfunction indicator, of legislated emission faults: `off`, `on`, `slow` or `fast` "
            "(flashing), `error`, `none` (the device has no such lamp)"
        ),
    ]
    red_stop: Annotated[LampState, Meta(description="stop the vehicle")]
    amber_warning: Annotated[LampState, Meta(description="a warning; the vehicle need not stop")]
    protect: Annotated[LampState, Meta(description="a fault that is most likely not electronic")]


class Context(msgspec.Struct, frozen=True, kw_only=True):
    """Trouble codes and lamps of another device, when they have changed."""

    schema: Annotated[str, Meta(description=f"`{SCHEMA}`")]
    id: Annotated[
        str, Meta(description="as of an event; of a log `<source>-context-<seq>`, as these are numbered by themselves")
    ]
    seq: Annotated[int, Meta(description="as of an event; of a log the number of the context record, from 1")]
    wall: Annotated[str | None, Meta(description="as of an event")]
    t_s: Annotated[
        float | None,
        Meta(
            description="of a log, as of an event: seconds since sample 0, negative before it; null on a vehicle, and "
            "of a log that ends before sample 0"
        ),
    ]
    bus: Annotated[
        str | None,
        Meta(description="the bus it came on, as in the configuration; of a log of several channels its channel"),
    ]
    sender: Annotated[int, Meta(description="source address")]
    message: Annotated[
        Literal["DM1", "DM2"],
        Meta(description="`DM1`: codes that are active; `DM2`: that were before, where asked for"),
    ]
    silent: Annotated[
        bool, Meta(description="no DM1 has come from the sender for 10 s: what it said last is not known to hold")
    ]
    lamps: Annotated[LampStates | None, Meta(description="null where it is silent")]
    codes: Annotated[list[TroubleCode], Meta(description="none: no trouble code; or it is silent")]


def decode_context(line: bytes) -> Context:
    """Return the record in one line of JSON; raises `msgspec.DecodeError` or `msgspec.ValidationError`."""
    return msgspec.json.decode(line, type=Context)
