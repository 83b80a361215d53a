"""Event socket: records as lines of JSON; for subscribers see docs/events.md.

One ring holds the latest events and every client has a place in it. Who is behind the ring reads from the store, a page
at a time, until it has caught up; without a store it goes on with the oldest there is, and the numbers show the gap.
Memory is bounded by the ring and a page for each client, and no client can hold up an alarm.
"""

import socket
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from faultline.service.outputs.lines import Client, LineServer
from faultline.service.protocol.records import Subscription, number_in
from faultline.service.store.file import Record
from faultline.service.store.journal import Page

RING = 4096  # events that can be asked for again without a look into the store
PAGE = 128  # events of one look


Read = Callable[[Page, Callable[[list[Record] | None], None]], None]


class _Subscriber(Client):
    """`last` is the number of what it was sent last, None before its request; `page` is what the store gave it."""

    def __init__(self, sock: socket.socket) -> None:
        super().__init__(sock)
        self.last: int | None = None
        self.page: deque[Record] = deque()
        self.is_waiting = False  # for the store


class EventSocket(LineServer[_Subscriber]):
    """Serves events to any number of clients from one selectors loop, without ever blocking.

    `earlier` are those of earlier runs, oldest first, that can be asked for; `read` gives what is older, from the store
    (`service.store.journal.Journal.read`), where there is one.

    Raises:
        InputError: the path cannot be used, or another process serves it.
    """

    def __init__(self, path: Path, earlier: Sequence[Record] = (), read: Read | None = None) -> None:
        super().__init__(path)
        self._read_store = read
        self._ring = deque(earlier, maxlen=RING)

    def publish(self, record: Record) -> None:
        """Publish a record, of a larger number than those before, to the ring and to each client."""
        self._ring.append(record)
        for client in list(self._clients):
            self._flush(client)

    def renew(self, earlier: Sequence[Record]) -> None:
        """Take the records of a store that was opened late, which are not news to connected clients."""
        self._ring = deque(earlier, maxlen=RING)
        for client in self._clients:
            if client.last is not None and self._ring:
                client.last = self._ring[-1].seq
                client.page.clear()

    def _made(self, sock: socket.socket) -> _Subscriber:
        return _Subscriber(sock)

    def _asked(self, client: _Subscriber, line: bytes) -> None:
        if client.last is not None or client.is_waiting:
            self._refuse(client, "one line is all that is asked")
            return
        try:
            request = msgspec.json.decode(line, type=Subscription)
        except (msgspec.MsgspecError, ValueError) as error:  # the latter for bytes that are no UTF-8
            self._refuse(client, str(error))
            return
        self._place(client, request.after)
        self._flush(client)

    def _place(self, client: _Subscriber, after: int | str | None) -> None:
        """Set the client's place after what it has had; before all, if `after` is unknown."""
        newest = self._ring[-1].seq if self._ring else 0
        if after is None:
            client.last = newest
        elif isinstance(after, int):
            client.last = after if 0 <= after <= newest else 0
        elif (known := next((each.seq for each in self._ring if _is(each, after)), None)) is not None:
            client.last = known
        else:
            self._look_up(client, after)

    def _look_up(self, client: _Subscriber, named: str) -> None:
        """Look up the number of a stored record by its id, which ends with it."""
        number = number_in(named)
        if self._read_store is None or number is None:
            client.last = 0
            return

        def found(records: list[Record] | None) -> None:
            client.is_waiting = False
            client.last = number if records and _is(records[0], named) else 0
            self._flush(client)

        client.is_waiting = True
        self._read_store(Page(1, after=number - 1), found)

    def _next(self, client: _Subscriber) -> bytes | None:
        if client.last is None or client.is_waiting:
            return None
        record = client.page.popleft() if client.page else None
        if record is None:
            if not self._ring or self._ring[-1].seq <= client.last:
                return None
            if self._ring[0].seq > client.last + 1 and self._read_store is not None:
                self._turn_back(client, self._read_store)
                return None
            record = self._ring[bisect_right(self._ring, client.last, key=lambda each: each.seq)]
        client.last = record.seq
        return record.line

    def _turn_back(self, client: _Subscriber, read_store: Read) -> None:
        """Ask for a page of records that are older than the ring."""

        def read(records: list[Record] | None) -> None:
            client.is_waiting = False
            oldest = self._ring[0].seq
            client.page.extend(each for each in records or () if each.seq < oldest)
            if not client.page:  # the store has nothing between that and the ring, or cannot be read
                client.last = oldest - 1
            self._flush(client)

        client.is_waiting = True
        assert client.last is not None
        read_store(Page(PAGE, after=client.last), read)


def _is(record: Record, named: str) -> bool:
    """Return True if that is the record's own id, the first that it names: a fault names those of events too."""
    return record.line.startswith(b'"id":' + msgspec.json.encode(named) + b",", record.line.find(b'"id":'))
