"""Claiming an address, SAE J1939-81: what is said for it, and what becomes of it when others claim the same.

An address is ours once our claim was on the bus and, of addresses 128 to 247, nobody with a lower NAME has contended
for 250 ms. Whoever claims it later with a higher NAME is told again whose it is; with a lower one it is his, and we
take the next of our addresses, if our NAME says that we may, or say that we cannot claim any.
"""

from collections.abc import Sequence
from typing import Literal

from faultline.service.core.j1939.identifiers import ADDRESS_CLAIMED, NULL
from faultline.service.j1939.frames import Message
from faultline.service.j1939.name import SIZE, delay_s, is_arbitrary
from faultline.service.logs import Frame

WAIT_S = 0.25
CONTENDED = range(128, 248)
"""Addresses that are taken dynamically; the others are assigned by function, and used at once."""
VIOLATED_S = 5.0
"""Who uses our address without having claimed it is told at most so often."""

State = Literal["idle", "claiming", "claimed", "cannot"]


class Claim:
    """Of one NAME. It is told what is heard, and asked with the time for what is to be sent.

    `addresses`: those that it may have, the preferred one first; the others only where the NAME is arbitrary address
    capable. `winner` is the NAME that took the last address from us.
    """

    def __init__(self, name: int, addresses: Sequence[int]) -> None:
        self.name = name
        self._addresses = tuple(addresses) if is_arbitrary(name) else tuple(addresses[:1])
        self.state: State = "idle"
        self.address = NULL
        self.winner: int | None = None
        self._taken: dict[int, int] = {}  # by address, the NAME of the other one who has claimed it
        self._until: float | None = None  # when it is ours, once the claim was on the bus
        self._due: float | None = None  # when to say it (again)
        self._violated = float("-inf")
        self._times = 0

    @property
    def data(self) -> bytes:
        """What a claim carries."""
        return self.name.to_bytes(SIZE, "little")

    def begin(self, now: float) -> None:
        """Begins anew, as after power-up: with the preferred address, which others may defend."""
        self._taken.clear()
        self._next(now)

    def rest(self) -> None:
        """Gives up until `begin`: nobody hears us."""
        self.state, self.address = "idle", NULL
        self._due = self._until = None

    def confirm(self, now: float) -> None:
        """Our claim is on the bus."""
        if self.state == "claiming" and self._until is None:
            self._until = now + (WAIT_S if self.address in CONTENDED else 0.0)

    def hear(self, source: int, name: int, now: float) -> None:
        """Another one claims `source`; or says from `NULL` that it has no address."""
        if name == self.name:  # ours, or one that must not be: nothing says who should give way
            return
        self._taken = {address: other for address, other in self._taken.items() if other != name}
        is_ours = source == self.address and self.state in ("claiming", "claimed")
        if is_ours and self.name < name:
            self._due = now
            return
        if source < NULL:
            self._taken[source] = name
        if is_ours:
            self.winner = name
            self._next(now)

    def asked(self, now: float) -> None:
        """Somebody wants to know who is where."""
        if self.state == "cannot":
            self._say_none(now)
        elif self.state != "idle":
            self._due = now

    def violated(self, now: float) -> None:
        """Another one sends from our address."""
        if self.state == "claimed" and now >= self._violated + VIOLATED_S:
            self._violated = self._due = now

    @property
    def due(self) -> float | None:
        """When there is something to do [s]."""
        return min((t for t in (self._due, self._until) if t is not None), default=None)

    def poll(self, now: float) -> list[Frame]:
        """What is to be sent now."""
        if self._until is not None and now >= self._until:
            self.state, self._until = "claimed", None
        if self._due is None or now < self._due:
            return []
        self._due = None
        return [Message(ADDRESS_CLAIMED, self.data).frame(self.address, now)]

    def _next(self, now: float) -> None:
        """The first of our addresses that nobody was heard to have."""
        self._until = None
        free = [address for address in self._addresses if address not in self._taken]
        if free:
            self.state, self.address, self._due = "claiming", free[0], now
        else:
            self.state, self.address, self._due = "cannot", NULL, None
            self._say_none(now)

    def _say_none(self, now: float) -> None:
        if self._due is None:
            self._times += 1
            self._due = now + delay_s(self.name, self._times)
