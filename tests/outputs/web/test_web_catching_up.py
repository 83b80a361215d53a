"""A stream that begins before the ring does, with a daemon that does as it is told: no sockets, no waiting."""

import asyncio
from collections.abc import AsyncGenerator, Sequence
from contextlib import aclosing
from pathlib import Path

import msgspec
import pytest
from web_daemon import record

from faultline.service.protocol.errors import AwayError
from faultline.service.protocol.records import Record
from faultline.service.web.events import Hub, stream
from faultline.service.web.metrics import Counts
from faultline.service.web.ring import Ring, told
from faultline.service.web.vehicle import Vehicle


class Heard(Hub):
    """A hub whose store and ring are filled by hand; `away` fails so many looks into the store."""

    def __init__(self, stored: Sequence[int], heard: Sequence[int], size: int = 5) -> None:
        super().__init__(Path("/e"), Vehicle(Path("/c"), 1, 1), Counts(), lambda _: None)
        self.ring = Ring(size)
        self.stored = [*stored]
        self.there, self.settled, self.away = True, 0, 0
        for seq in heard:
            self.hear(seq)

    def hear(self, seq: int) -> None:
        self.ring.add(told(record(seq)))
        self.changes.notify()

    async def page(self, seq: int, count: int = 3) -> Sequence[Record]:
        if self.away:
            self.away -= 1
            self.changes.notify()
            raise AwayError("of the test")
        return [told(record(each)) for each in self.stored if each > seq][: min(count, 3)]


async def seqs(parts: AsyncGenerator[bytes, None], count: int) -> list[int]:
    """Numbers of the next records."""
    found: list[int] = []
    async with aclosing(parts):
        async for part in parts:
            found += [msgspec.json.decode(line[6:])["seq"] for line in part.split(b"\n") if line.startswith(b"data: ")]
            if len(found) >= count:
                break
    return found


def begun(hub: Hub, after: int | str | None) -> AsyncGenerator[bytes, None]:
    return stream(hub, after, 5.0)


@pytest.mark.parametrize("after", [0, 1, 7, 8, 14, 15, 16, 19])
def test_pages_of_the_store_and_the_ring_are_one_sequence(after: int) -> None:
    async def run() -> list[int]:
        hub = Heard(range(1, 21), range(16, 21))
        return await seqs(begun(hub, after), 20 - after)

    assert asyncio.run(run()) == [*range(after + 1, 21)]


@pytest.mark.parametrize(
    "after", ["truck-5e0c72b1-3", "truck-00000000-3", "nonsense", "truck-x", "truck-99999999999999999999"]
)
def test_an_id_is_known_by_the_record_of_its_number(after: str) -> None:
    async def run() -> list[int]:
        return await seqs(begun(Heard(range(1, 21), range(16, 21)), after), 5)

    first = 4 if after == "truck-5e0c72b1-3" else 1
    assert asyncio.run(run())[:5] == [*range(first, first + 5)]


def test_the_ring_moves_on_meanwhile() -> None:
    """Ten records are told with every piece that the client takes: what falls out of the ring is in the store."""

    async def run() -> list[int]:
        hub = Heard(range(1, 21), range(16, 21))
        found: list[int] = []
        async with aclosing(begun(hub, 0)) as parts:
            async for part in parts:
                found += [msgspec.json.decode(line[6:])["seq"] for line in part.split(b"\n") if line[:6] == b"data: "]
                last = hub.ring.newest
                if last < 100:
                    hub.stored += range(last + 1, last + 3)
                    for seq in range(last + 1, last + 3):
                        hub.hear(seq)
                if found and found[-1] == hub.ring.newest:
                    return found
        return found

    found = asyncio.run(run())
    assert found == [*range(1, len(found) + 1)]
    assert len(found) >= 100


def test_without_a_store_it_goes_on_with_the_oldest_there_is() -> None:
    async def run() -> tuple[list[int], list[int]]:
        hub = Heard([], range(16, 21))
        return await seqs(begun(hub, 3), 5), await seqs(begun(hub, "truck-5e0c72b1-3"), 5)

    assert asyncio.run(run()) == ([*range(16, 21)], [*range(16, 21)])


def test_a_store_that_is_ahead_of_what_was_heard_gives_nothing_twice() -> None:
    """A record is in the store before anybody hears of it."""

    async def run() -> list[int]:
        hub = Heard([1, 2], [])
        reading = asyncio.create_task(seqs(begun(hub, 0), 4))
        await asyncio.sleep(0.01)
        for seq in (1, 2, 3, 4):
            hub.hear(seq)
            await asyncio.sleep(0)
        return await reading

    assert asyncio.run(run()) == [1, 2, 3, 4]


def test_a_store_that_cannot_be_read_now_is_waited_for() -> None:
    async def run() -> tuple[list[bytes], list[int]]:
        hub = Heard(range(1, 21), range(16, 21))
        hub.away = 2
        parts = begun(hub, 3)
        first = [await anext(parts) for _ in range(2)]
        hub.away, hub.there = 0, True
        hub.changes.notify()
        asyncio.get_running_loop().call_later(0.01, hub.changes.notify)
        return first, await seqs(parts, 17)

    first, rest = asyncio.run(run())
    assert first == [b"retry: 1000\n\n", b": daemon away\n\n"]
    assert rest == [*range(4, 21)]


def test_who_waits_for_the_ring_to_settle_gets_what_was_told_since() -> None:
    async def run() -> list[int]:
        hub = Heard([], [])
        hub.settled = None
        reading = asyncio.create_task(seqs(begun(hub, None), 2))
        await asyncio.sleep(0.01)
        hub.hear(1)  # from before
        hub.settled = hub.ring.end
        hub.hear(2)
        hub.hear(3)
        return await reading

    assert asyncio.run(run()) == [2, 3]
