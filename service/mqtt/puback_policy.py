"""PUBACK policy: which refusals are final and which are tried again.

Source: MQTT 5.0, 3.4.2.1 (PUBACK reason codes). What is about the one message will be refused whenever it is sent: it
is given up at once. What is about this client, the moment or the load may change, so it is tried again, and what comes
after it waits; but not for ever: a stream that stands still for one refusal tells nobody anything.
"""

from typing import Literal

PATIENCE_S = 300.0
"""So long after the first refusal, with nothing taken since, each refused record is given up at once."""

Verdict = Literal["taken", "again", "given up"]

TAKEN = {0x00: "success", 0x10: "no matching subscribers"}
OF_THE_MESSAGE = {0x90: "topic name invalid", 0x95: "packet too large", 0x99: "payload format invalid"}
OF_THE_MOMENT = {
    0x80: "unspecified error",
    0x81: "malformed packet",
    0x82: "protocol error",
    0x83: "implementation specific error",
    0x87: "not authorized",
    0x91: "packet identifier in use",
    0x97: "quota exceeded",
}

HANGS_UP = frozenset((0x81, 0x82, 0x87, 0x90, 0x95, 0x97, 0x99))
"""With these some brokers end the connection instead of refusing what was sent (MQTT 5.0, 3.14.2.1)."""


def name_of(code: int) -> str:
    """Return the reason code's name."""
    return {**TAKEN, **OF_THE_MESSAGE, **OF_THE_MOMENT}.get(code, f"reason code 0x{code:02x}")


class PubackPolicy:
    """Decides on each acknowledgement. State: since when [s] only refusals came."""

    def __init__(self) -> None:
        self._refused_since: float | None = None

    @property
    def refusing(self) -> bool:
        """Return True if the last answers were refusals: then one publication at a time is enough to find out."""
        return self._refused_since is not None

    def judge(self, code: int, now: float) -> Verdict:
        """Return what becomes of a record with this answer at `now` [s]; an unknown code may be temporary too."""
        if code < 0x80:
            self._refused_since = None
            return "taken"
        if code in OF_THE_MESSAGE:
            return "given up"
        if self._refused_since is None:
            self._refused_since = now
        return "again" if now - self._refused_since < PATIENCE_S else "given up"
