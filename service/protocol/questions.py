"""Questions of the control socket, a line each."""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Ask = Literal["faults", "fault", "clear", "relearn", "state", "records", "system", "live", "history"]


class Question(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """One line that a client of the control socket sends; fields that a question does not need are left out."""

    ask: Annotated[Ask, Meta(description="what is asked")]
    number: Annotated[int | None, Meta(description="of a fault: `fault`, `clear`")] = None
    name: Annotated[str | None, Meta(description="of a system: `relearn`, `system`, `live`, `history`")] = None
    after: Annotated[int | None, Meta(description="records of larger numbers, or later ticks")] = None
    before: Annotated[int | None, Meta(description="records of smaller numbers, or earlier ticks")] = None
    count: Annotated[int | None, Meta(description="at most so many records or ticks")] = None
