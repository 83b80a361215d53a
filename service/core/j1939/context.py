"""Trouble codes of other devices, as they come on the bus: what has changed, and who has fallen silent.

DM1 comes once a second from each device that has active codes, and at once when they change; DM2 only where asked for.
Both come in one frame, or in parts.
"""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.service.core.frames import Frames
from faultline.service.core.j1939.dm1 import NO_OC, Code, Diagnostics, Lamps, decode, older_spns
from faultline.service.core.j1939.identifiers import DM1, DM2, TP_CM, TP_DT, group_of
from faultline.service.core.j1939.transport import Reassembler
from faultline.service.core.records.context import SCHEMA, Context, LampState, LampStates, TroubleCode

GROUPS = (DM1, DM2, TP_CM, TP_DT)
"""The groups whose frames are looked at."""
SILENT_S = 10.0
"""A device whose DM1 has not come for so long has fallen silent [s, real time]: ten times as long as it may wait."""
GAP_S = 0.5
"""Two changes of a sender are at least so far apart [s, real time]: one that comes sooner is seen with the next DM1."""

NAMES: dict[int, Literal["DM1", "DM2"]] = {DM1: "DM1", DM2: "DM2"}

_STATES: tuple[LampState, ...] = ("off", "on", "error", "none")
_FLASHES: dict[int, LampState] = {0: "slow", 1: "fast"}
_FORMATS = frozenset(pgn >> 8 for pgn in GROUPS)


class Change(NamedTuple):
    """A sender's lamps and codes from log time `t` [s] on; None: it has fallen silent."""

    t: float
    sender: int
    message: Literal["DM1", "DM2"]
    said: Diagnostics | None

    def record(self, identity: tuple[str, int, str | None], t_s: float | None, bus: str | None = None) -> Context:
        """The record of it; `identity` is its id, number and wall clock."""
        named, seq, wall = identity
        return Context(
            schema=SCHEMA,
            id=named,
            seq=seq,
            wall=wall,
            t_s=t_s,
            bus=bus,
            sender=self.sender,
            message=self.message,
            silent=self.said is None,
            lamps=None if self.said is None else _lamps(self.said.lamps),
            codes=[] if self.said is None else [_code(code) for code in self.said.codes],
        )


@dataclass(slots=True)
class _Sender:
    """State of a sender's message: when it came last [s], the lamps and codes last reported, and when [s]."""

    came: float
    reported: object = None
    reported_at: float = -float("inf")


class CodeTracker:
    """Takes frames, gives changes. State: what each sender said last, and messages whose parts are missing.

    `unreadable` counts, by sender, messages that are none; `speed`: seconds of log time a second, 1 on a vehicle.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self._speed = max(1.0, speed)
        self.parts = Reassembler(lambda identifier: NAMES.get(group_of(identifier)))
        self.parts.speed = self._speed
        self.unreadable: Counter[int] = Counter()
        self._senders: dict[tuple[int, Literal["DM1", "DM2"]], _Sender] = {}
        self._due = -float("inf")  # when it is looked next who is silent [s]

    def frame(self, t: float, can_id: int, is_extended: bool, data: bytes) -> list[Change]:
        """Take a frame that came at log time `t` [s]."""
        found = self.look(t) if t >= self._due else []
        if not is_extended or can_id >> 16 & 0x3FF not in _FORMATS:
            return found
        pgn = group_of(can_id)
        if pgn in (TP_CM, TP_DT):
            whole = self.parts.take(t, can_id, data)
            if whole is None:
                return found
            can_id, data = whole
            pgn = group_of(can_id)
        if pgn in NAMES:
            found += self._said(t, can_id & 0xFF, NAMES[pgn], data)
        return found

    def frames(self, frames: Frames, own: npt.NDArray[np.bool_] | bool = True) -> list[Change]:
        """Take frames in order of time, `own` (N,) those of the bus; only those of the groups are looked at.

        The times of all say when it is looked who is silent.
        """
        near = np.isin(frames.identifier >> 16 & 0x3FF, list(_FORMATS)) & frames.is_extended & own
        rows = deque([*np.flatnonzero(near).tolist(), len(frames)])
        found: list[Change] = []
        while (row := min(rows[0], int(np.searchsorted(frames.time, self._due)))) < len(frames):
            if row < rows[0]:
                found += self.look(float(frames.time[row]))
                continue
            rows.popleft()
            data = frames.data[row, : frames.length[row]].tobytes()
            found += self.frame(float(frames.time[row]), int(frames.identifier[row]), True, data)
        return found

    def look(self, t: float) -> list[Change]:
        """Return who has fallen silent up to log time `t` [s]."""
        self._due = t + self._speed
        return list(self._silent(t))

    def _said(self, t: float, sender: int, message: Literal["DM1", "DM2"], data: bytes) -> list[Change]:
        try:
            said = decode(data)
        except ValueError:
            self.unreadable[sender] += 1
            return []
        state = self._senders.setdefault((sender, message), _Sender(t))
        state.came = t
        now = said.lamps, frozenset((code.spn, code.fmi, code.is_old) for code in said.codes)
        if now == state.reported or 0.0 <= t - state.reported_at < GAP_S * self._speed:
            return []
        state.reported, state.reported_at = now, t
        return [Change(t, sender, message, said)]

    def _silent(self, t: float) -> Iterator[Change]:
        for (sender, message), state in self._senders.items():
            if message == "DM1" and state.reported is not None and t - state.came > SILENT_S * self._speed:
                state.reported = None
                yield Change(t, sender, message, None)


def _lamps(lamps: Lamps) -> LampStates:
    malfunction, red, amber, protect = (
        _FLASHES.get(flash, "on") if state == 1 else _STATES[state]
        for state, flash in zip(lamps[:4], lamps.flash, strict=True)
    )
    return LampStates(malfunction=malfunction, red_stop=red, amber_warning=amber, protect=protect)


def _code(code: Code) -> TroubleCode:
    return TroubleCode(
        spn=code.spn,
        fmi=code.fmi,
        count=None if code.oc == NO_OC else code.oc,
        other_spns=list(older_spns(code)) if code.is_old else [],
    )
