"""A J1939 node that tells trouble codes: claims an address, sends DM1, answers requests. Pure: the time is an argument.

Every frame that is really transmitted, ours too, must come back through `hear`: what does not come back was not heard
by anybody. Then nothing is sent but a claim now and then, until one comes back (`service.j1939.echo`).

DM1 is sent once a second, and at once when its state changes, which is done once a second at most (SAE J1939-73). Where
its parts take longer than that, the next one waits for the last part.
"""

from collections.abc import Sequence
from typing import Literal

from faultline.service.core.j1939.dm1 import encode
from faultline.service.core.j1939.identifiers import ADDRESS_CLAIMED, DM1, DM2, FRAME, GLOBAL, NULL
from faultline.service.j1939.claim import Claim
from faultline.service.j1939.dtcs import Known
from faultline.service.j1939.echo import Echo
from faultline.service.j1939.frames import Heard, Message, parse
from faultline.service.j1939.name import SIZE
from faultline.service.j1939.outbox import Outbox
from faultline.service.j1939.requests import Refusal, refused, wanted
from faultline.service.logs import Frame

PERIOD_S = 1.0
LATE_S = 0.2
"""A DM1 that is late by less does not move those after it."""
RETRY_S, LONGEST_RETRY_S = 5.0, 60.0
"""A bus that takes nothing is tried again after that, twice as long each time."""

Status = Literal["waiting", "claiming", "claimed", "cannot", "mute"]


class Node:
    """`name` and `addresses` as of `Claim`."""

    def __init__(self, name: int, addresses: Sequence[int]) -> None:
        self._claim = Claim(name, addresses)
        self._echo = Echo()
        self._outbox = Outbox()
        self._known: Known | None = None
        self._mute = False
        self._retry_due, self._retry = 0.0, RETRY_S
        self._dm1_due = self._changed = float("-inf")
        self._wanted: dict[int, None] = {}  # groups that all are to be told, in order
        self._last = 0  # the one that they were told last
        self._answers: dict[Message, None] = {}
        self._news = False  # something was heard that may ask for an answer
        self.has_twin = False
        """Another device has our NAME."""

    @property
    def status(self) -> Status:
        """`waiting`: not begun. `cannot`: others have all our addresses. `mute`: what we send is not transmitted."""
        if self._mute:
            return "mute"
        return "waiting" if self._claim.state == "idle" else self._claim.state

    @property
    def address(self) -> int:
        """Ours, or the one that we claim; `NULL` where there is none."""
        return self._claim.address

    @property
    def winner(self) -> int | None:
        """The NAME that took the last address from us."""
        return self._claim.winner

    def begin(self, now: float) -> None:
        """The bus is there: claims an address."""
        self._echo.clear()
        self._mute, self._retry = False, RETRY_S
        self._forget()
        self._claim.begin(now)

    def end(self) -> None:
        """The bus is gone: nothing is sent until `begin`."""
        self._echo.clear()
        self._mute = False
        self._forget()
        self._claim.rest()

    def know(self, known: Known | None, now: float) -> None:
        """What is remembered now; None where nobody knows: then nothing is told, which is not the same as no fault."""
        before, self._known = self._known, known
        if known is None or (before is not None and before.state == known.state):
            return
        if now >= self._changed + PERIOD_S:
            self._dm1_due, self._changed = now, now

    def hear(self, frame: Frame, now: float) -> None:
        """Takes a frame that was on the bus."""
        heard = parse(frame)
        if heard is None:
            return
        if self._echo.heard(frame, now):
            self._transmitted(heard, now)
            return
        self._news = True
        address = self._claim.address
        is_mine = heard.destination == address != NULL
        if heard.pgn == ADDRESS_CLAIMED:
            self._claimed(heard, now)
        elif heard.source == address != NULL:
            self._claim.violated(now)
        elif (pgn := wanted(heard)) is not None and (is_mine or heard.destination == GLOBAL):
            self._asked(pgn, heard, now)
        elif self._claim.state == "claimed" and is_mine:
            self._outbox.hear(heard, now)

    def frames(self, now: float) -> list[Frame]:
        """What is to be sent now."""
        self._news = False
        if self._mute:
            if now >= self._retry_due:
                self._claim.begin(now)
                self._retry_due, self._retry = now + self._retry, min(2.0 * self._retry, LONGEST_RETRY_S)
        elif self._echo.is_overdue(now):
            self._mute, self._retry_due, self._retry = True, now + RETRY_S, 2.0 * RETRY_S
            self._forget()
            self._claim.rest()
        frames = self._claim.poll(now)
        if self._claim.state == "claimed":
            frames += [message.frame(self._claim.address, now) for message in self._messages(now)]
        for frame in frames:
            self._echo.sent(frame, now)
        return frames

    @property
    def due(self) -> float | None:
        """When `frames` has something to do, if nothing is heard before [s]."""
        dues = [self._claim.due, self._retry_due if self._mute else self._echo.due]
        if self._claim.state == "claimed":
            dues.append(self._outbox.due)
            if self._news:
                dues.append(0.0)
            if self._known is not None and not (DM1 in self._wanted or self._outbox.is_sending(DM1)):
                dues.append(self._dm1_due)
        return min((due for due in dues if due is not None), default=None)

    def _transmitted(self, heard: Heard, now: float) -> None:
        """A frame of ours was on the bus."""
        if self._mute and self._claim.state == "idle":  # one that had waited in the controller: the bus is well again
            self._retry_due = now
            return
        self._mute, self._retry = False, RETRY_S
        if heard.pgn == ADDRESS_CLAIMED and heard.source == self._claim.address != NULL:
            self._claim.confirm(now)

    def _claimed(self, heard: Heard, now: float) -> None:
        if len(heard.data) != SIZE:
            return
        self.has_twin |= heard.data == self._claim.data
        before = self._claim.address
        self._claim.hear(heard.source, int.from_bytes(heard.data, "little"), now)
        if self._claim.address != before:
            self._forget()

    def _asked(self, pgn: int, heard: Heard, now: float) -> None:
        """A request to us or to all."""
        to_all = heard.destination == GLOBAL
        if pgn == ADDRESS_CLAIMED:
            self._claim.asked(now)
        elif self._claim.state != "claimed" or (heard.source >= NULL and not to_all):
            return
        elif pgn not in (DM1, DM2):
            if not to_all:
                self._answers[refused(Refusal.NOT_SUPPORTED, pgn, heard.source)] = None
        elif to_all:
            self._wanted[pgn] = None
        else:
            self._answer(pgn, heard.source, now)

    def _answer(self, pgn: int, asker: int, now: float) -> None:
        """To one: a message of one frame has no address, one in parts goes by a connection."""
        payload = self._payload(pgn)
        if payload is not None and len(payload) <= FRAME:
            self._wanted[pgn] = None
        elif payload is None or not self._outbox.connect(pgn, payload, asker, now):
            self._answers[refused(Refusal.BUSY, pgn, asker)] = None

    def _messages(self, now: float) -> list[Message]:
        messages = self._outbox.poll(now) + list(self._answers)
        self._answers.clear()
        if self._known is not None and now >= self._dm1_due:
            self._wanted[DM1] = None
        for pgn in sorted(self._wanted, key=lambda pgn: pgn == self._last):  # no group keeps another one waiting
            payload = self._payload(pgn)
            if payload is None:
                del self._wanted[pgn]
            elif len(payload) <= FRAME and not self._outbox.is_sending(pgn):
                del self._wanted[pgn]
                messages.append(Message(pgn, payload))
                self._told(pgn, now)
            elif len(payload) > FRAME and self._outbox.is_free(now):
                del self._wanted[pgn]
                self._outbox.broadcast(pgn, payload, now)
                self._told(pgn, now)
        return messages + self._outbox.poll(now)

    def _told(self, pgn: int, now: float) -> None:
        """The next DM1 comes a second later, whatever made this one be sent."""
        self._last = pgn
        if pgn == DM1:
            due = self._dm1_due
            self._dm1_due = (due if due <= now < due + LATE_S else now) + PERIOD_S

    def _payload(self, pgn: int) -> bytes | None:
        """Of DM1 or DM2; None where nobody knows."""
        if self._known is None:
            return None
        return encode(self._known.active if pgn == DM1 else self._known.previous, self._known.amber)

    def _forget(self) -> None:
        """What was to be sent from the address that was ours."""
        self._outbox.clear()
        self._wanted.clear()
        self._answers.clear()
        self._dm1_due = float("-inf")
