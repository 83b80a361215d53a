"""Event stream: one subscription to the daemon's events, shared by all clients of this server.

The daemon serves few clients; this one asks for the latest, and for what came after the last id when the connection is
lost. Whoever connects here has a place in the ring; what is older than that is read a page at a time.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import aclosing
from itertools import takewhile
from pathlib import Path

from faultline.service.core.records.line import encode
from faultline.service.protocol.aio import connected, line_of
from faultline.service.protocol.answers import RecordPage
from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.errors import AwayError, GarbledError, ProtocolError, RefusedError
from faultline.service.protocol.questions import Question
from faultline.service.protocol.records import Record, RecordError, Subscription, number_in
from faultline.service.web.metrics import Counts
from faultline.service.web.ring import SIZE, Ring, told
from faultline.service.web.vehicle import Vehicle
from faultline.service.web.waiting import ChangeNotifier

SETTLED_S = 0.5  # without a line for so long, the daemon has sent all that was asked for
BATCH = 64  # records in one piece of a stream
PAGE = 128  # older ones asked for at once
RETRY_S = 0.2, 5.0  # after which the daemon is looked for again: at first, and at most
RETRY_MS = 1000  # after which a client connects again


class Hub:
    """Latest records. State: the ring, whether the daemon is `there`, and the place at which it `settled`.

    It has settled once the daemon has sent the latest that it had when this process began: before that, nobody's place
    is known, and that place is None.
    """

    def __init__(self, path: Path, vehicle: Vehicle, counts: Counts, say: Callable[[str], None]) -> None:
        self._path, self._vehicle, self._counts, self._say = path, vehicle, counts, say
        self.ring, self.changes = Ring(), ChangeNotifier()
        self.there = False
        self.settled: int | None = None

    async def run(self) -> None:
        """Receive for ever; connect again if the daemon went away."""
        retry, said = Backoff(*RETRY_S), ""
        while True:
            try:
                await self._listen()
            except ProtocolError as error:
                if self.there:
                    said = ""
                    retry.well()
                if str(error) != said:
                    self._say(f"events: {error}; trying again")
                said = str(error)
            self._is_there(there=False)
            await asyncio.sleep(retry.wait())

    async def page(self, seq: int, count: int = PAGE) -> Sequence[Record]:
        """Return records after that number from the daemon's store; none if it has no store.

        Raises:
            AwayError: they cannot be had now.
        """
        try:
            found = await self._vehicle.ask_alone(Question(ask="records", after=seq, count=count), RecordPage)
            return [told(bytes(line)) for line in found.records]
        except (RecordError, GarbledError) as error:
            raise AwayError(f"records cannot be read: {error}") from error
        except RefusedError as error:
            store = (await self._vehicle.state()).store
            if store is None or store.path is None:
                return ()
            raise AwayError(error.message) from error

    async def _listen(self) -> None:
        latest = (await self._vehicle.state()).seq
        after = max(0, latest - SIZE) if self.ring.last is None else self.ring.last
        async with connected(self._path, encode(Subscription(after))) as reader:
            while True:
                if self.ring.newest >= latest:
                    self._settle()
                try:
                    async with asyncio.timeout(None if self.there and self.settled is not None else SETTLED_S):
                        line = await line_of(reader)
                except TimeoutError:
                    self._settle()
                    self._is_there(there=True)
                else:
                    self._take(line)

    def _settle(self) -> None:
        if self.settled is None:
            self.settled = self.ring.end
            self.changes.notify()

    def _take(self, line: bytes) -> None:
        if line.startswith(b'{"error"'):
            raise AwayError(f"{self._path}: turned away: {line[:200].decode(errors='replace').strip()}")
        try:
            record = told(line)
        except RecordError as error:
            self._counts.unread += 1
            if self._counts.unread == 1:
                self._say(f"events: a line is no record: {error}: {line[:80]!r}")
            return
        if self.ring.add(record):
            self._vehicle.forget()  # who hears of it and asks must not get an answer from before
        self._is_there(there=True)

    def _is_there(self, *, there: bool) -> None:
        self.there = there
        self.changes.notify()


def frame(record: Record) -> bytes:
    """Return a record as an event of a stream."""
    return b"id: %b\nevent: %b\ndata: %b\n\n" % (record.id.encode(), record.kind.encode(), record.line)


async def stream(hub: Hub, after: int | str | None, alive_s: float) -> AsyncGenerator[bytes, None]:
    """Yield all records after `after`; and a comment every `alive_s` [s] if nothing comes.

    It ends where the client fell out of the ring: it connects again, with the last id that it has.
    """
    place, there = hub.ring.end if after is None and hub.settled is not None else None, True
    yield b"retry: %d\n\n" % RETRY_MS
    while True:
        if place is None and hub.settled is not None:
            async with aclosing(_caught_up(hub, after, alive_s)) as parts:
                async for part in parts:
                    if isinstance(part, int):
                        place = part
                    else:
                        yield part
        if place is not None:
            batch = hub.ring.since(place, BATCH)
            if batch is None:
                return
            if batch:
                place += len(batch)
                yield b"".join(frame(record) for record in batch)
                continue
        if hub.there != there:
            there = hub.there
            yield b": daemon back\n\n" if there else b": daemon away\n\n"
        elif not await hub.changes.wait(alive_s):
            yield b": alive\n\n" if there else b": daemon away\n\n"


async def _caught_up(hub: Hub, after: int | str | None, alive_s: float) -> AsyncGenerator[bytes | int, None]:
    """Yield what is older than the ring, as pieces of the stream, and then the place in the ring that follows it."""
    ring, seq = hub.ring, None
    while True:
        place = hub.settled if after is None else _place(ring, after if seq is None else seq)
        if place is not None:
            yield place
            return
        try:
            seq = await _number(hub, after) if seq is None else seq
            page = await hub.page(seq)
        except AwayError:
            yield b": daemon away\n\n"
            await hub.changes.wait(alive_s)
            continue
        older = [*takewhile(lambda record: ring.where(record.id) is None, page)]
        if older:
            yield b"".join(frame(record) for record in older)
            seq = older[-1].seq
        elif page:
            where = ring.where(page[0].id)
            assert where is not None
            yield where
            return
        elif seq <= ring.newest:
            yield ring.beyond(seq)
            return
        elif not await hub.changes.wait(alive_s):  # the store is ahead of what was heard, as nothing was yet
            yield b": alive\n\n"


def _place(ring: Ring, after: int | str) -> int | None:
    """Return the place that follows a record by number or id; None if that is not in the ring."""
    where = ring.after(after) if isinstance(after, int) else ring.where(after)
    return where + 1 if isinstance(after, str) and where is not None else where


async def _number(hub: Hub, after: int | str | None) -> int:
    """Return the number of a record that is older than the ring; 0, before all there are, if it is not known."""
    if not isinstance(after, str):
        return after if after is not None and after <= hub.ring.newest else 0
    number = number_in(after)
    if number is None:
        return 0
    found = await hub.page(max(0, number - 1), 1)
    return number if found and found[0].id == after else 0
