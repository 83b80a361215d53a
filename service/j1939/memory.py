"""Client of the service's fault memory: asks after each record of the event socket, and periodically.

What was answered last is good for `KEEP_S` after the service is gone, and then nothing is known: that is not the same
as no fault, and DM1 must not say so.
"""

from collections.abc import Callable
from pathlib import Path

from faultline.service.core.records.fault import Fault
from faultline.service.core.records.line import encode
from faultline.service.j1939.dtcs import Known, known, left_out, unsent
from faultline.service.protocol.answers import FaultList
from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.client import decode
from faultline.service.protocol.errors import ProtocolError, RefusedError
from faultline.service.protocol.questions import Question
from faultline.service.protocol.reconnecting import Reconnecting
from faultline.service.protocol.records import Subscription

ASK_S, ASK_BLIND_S = 10.0, 1.0
"""How often it is asked without being told that anything has changed: with the events, and without."""
PATIENCE_S = 2.0
"""In which an answer comes."""
KEEP_S = 5.0
OLDEST_S = ASK_S + PATIENCE_S + KEEP_S
"""Nothing older is known, whatever happens: this process may have been stopped."""
RETRY_S = 0.5
QUESTION = encode(Question(ask="faults"))


class Memory:
    """State: `known` trouble codes, None if they are unknown. `say` is called once with each message for a person."""

    def __init__(self, control: Path, events: Path, say: Callable[[str], None]) -> None:
        self._where = control
        self._control = Reconnecting(control, Backoff(RETRY_S, RETRY_S))
        self._events = Reconnecting(events, Backoff(RETRY_S, RETRY_S), lambda: encode(Subscription()))
        self._say = say
        self.known: Known | None = None
        self._asked: float | None = None  # when; None: not, or answered
        self._due = 0.0
        self._failing: float | None = None  # since when
        self._answered = 0.0
        self._told: dict[int, str] = {}
        self._too_many = 0
        self._whys: set[str] = set()  # what was said since it answered last

    def filenos(self) -> list[int]:
        """Return the descriptors to wait for."""
        return [number for lines in (self._control, self._events) if (number := lines.fileno()) >= 0]

    @property
    def due(self) -> float:
        """Return the time of the next action, if nothing is received before [s]."""
        dues = [self._events.due, self._control.due]
        if self._control.is_connected:
            dues.append(self._due if self._asked is None else self._asked + PATIENCE_S)
        if self._failing is not None and self.known is not None:
            dues.append(self._failing + KEEP_S)
        return min(due for due in dues if due is not None)

    def take(self, now: float) -> None:
        """Reads what came, asks where that is due, and forgets what is too old."""
        before = self._events.connections
        if self._events.take(now) or self._events.connections != before:
            self._due = now
        before = self._control.connections
        for line in self._control.take(now):
            self._answer(line, now)
        if self._control.connections != before:
            self._asked, self._due = None, now
        if self._asked is not None and now >= self._asked + PATIENCE_S:
            self._fail(f"does not answer within {PATIENCE_S:g} s", self._asked)
            self._control.drop(now)
        elif self._control.why:
            self._fail("is not there", now)
        elif self._asked is None and now >= self._due and self._control.send(QUESTION, now):
            self._asked, self._due = now, now + (ASK_S if self._events.is_connected else ASK_BLIND_S)
        if not self._control.is_connected:
            self._asked = None
        if now >= self._answered + OLDEST_S or (self._failing is not None and now >= self._failing + KEEP_S):
            self.known = None

    def close(self) -> None:
        """Close both connections."""
        self._control.close()
        self._events.close()

    def _answer(self, line: bytes, now: float) -> None:
        if self._asked is None:  # to nothing that we asked
            return
        self._asked = None
        try:
            faults = decode(line, FaultList).faults
        except ProtocolError as error:
            garbled = f"gave no answer that is understood ({error.__cause__})"
            self._fail(f"refused ({error.message})" if isinstance(error, RefusedError) else garbled, now)
            self._due = now + ASK_BLIND_S
            return
        if self._whys:
            self._say(f"{self._where}: the service answers")
        self._whys.clear()
        self._failing, self._answered = None, now
        self.known = known(faults)
        self._warn(faults)

    def _fail(self, why: str, since: float) -> None:
        if self._failing is None:
            self._failing = since
        if why not in self._whys:
            self._whys.add(why)
            self._say(f"{self._where}: the service {why}: without an answer for {KEEP_S:g} s DM1 is not sent")

    def _warn(self, faults: list[Fault]) -> None:
        """Report once what cannot be sent."""
        now = unsent(faults)
        for number, text in now.items():
            if self._told.get(number) != text:
                self._say(text)
        self._told = now
        too_many = left_out(self.known) if self.known is not None else 0
        if too_many > self._too_many:
            self._say(f"{too_many} codes are more than a message has room for; the oldest faults' are sent")
        self._too_many = too_many
