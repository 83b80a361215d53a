"""Configuration of the fault memory."""

from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.memory.debounce import Disabled

Cycles = Annotated[int, Meta(ge=1, le=255)]
Seconds = Annotated[float, Meta(ge=0, le=3600)]


class Rules(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Rules of the fault memory.

    A fault is confirmed once it has failed in `confirm_trips` operation cycles in a row that could tell. After
    `heal_cycles` in a row that could tell and in which it did not fail it is no longer warned of, and after
    `age_cycles` more it is erased. `entries` are remembered at most. What is told counts as failed once it has been so
    for `failed_after_s`, and passed once it has healed for `passed_after_s`, both [s] in which its tests can tell;
    meanwhile that count is kept (`freeze`) or begins anew (`reset`). What is not told any more, as the service was
    started again, has passed once its tests were quiet for `quiet_s` [s] in each mode that showed it.
    """

    confirm_trips: Cycles = 1
    heal_cycles: Cycles = 3
    age_cycles: Cycles = 40
    entries: Annotated[int, Meta(ge=1, le=256)] = 64
    failed_after_s: Seconds = 0.0
    passed_after_s: Seconds = 0.0
    disabled: Disabled = "freeze"
    quiet_s: Annotated[float, Meta(ge=1, le=3600)] = 60.0
