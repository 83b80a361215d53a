"""Streams: every record exactly once and in order, however often a client is cut off, and what happens meanwhile."""

import itertools
import random
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from test_web_metrics import one, strictly
from web_daemon import FakeDaemon
from web_server import Serving, Sse, serving, until

from faultline.service.protocol.backoff import Backoff
from faultline.service.web.asking import FRESH_S
from faultline.service.web.events import RETRY_S
from faultline.service.web.limits import Limits
from faultline.service.web.ring import SIZE


def arguments(daemon: FakeDaemon) -> tuple[str, ...]:
    return "--control", str(daemon.control), "--events", str(daemon.events), "--listen", "127.0.0.1:0"


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[FakeDaemon]:
    with FakeDaemon(tmp_path) as made:
        yield made


def seqs(stream: Sse, count: int) -> list[int]:
    """Numbers of the next records; each event must be whole and say the same in all its fields."""
    found = []
    for event in stream.events():
        if "data" in event:
            data = msgspec.json.decode(event["data"])
            assert event["id"] == data["id"] == f"truck-5e0c72b1-{data['seq']}"
            assert event["event"] == data["schema"].removeprefix("faultline.").partition("/")[0]
            found.append(data["seq"])
            if len(found) == count:
                break
    return found


def comments(stream: Sse) -> Iterator[str]:
    return (event[""] for event in stream.events() if "" in event)


def subscribed(server: Serving) -> None:
    """Once it hears the daemon: what was told before that is what there was, for whoever asks for the new."""
    with server.client() as client:
        until(lambda: one(strictly(client.get("/metrics").content), "faultline_http_subscribed") == 1)


def test_a_stream_begins_where_it_is_asked_to(daemon: FakeDaemon, tmp_path: Path) -> None:
    daemon.tell(*range(1, 31))
    with serving(*arguments(daemon), log=tmp_path / "log") as server:
        for path, last, expected in [
            ("/v1/events?after=0", None, [1, 2, 3]),
            ("/v1/events?after=27", None, [28, 29, 30]),
            ("/v1/events?after=truck-5e0c72b1-20", None, [21, 22, 23]),
            ("/v1/events", "truck-5e0c72b1-20", [21, 22, 23]),
            ("/v1/events?after=3", "truck-5e0c72b1-20", [21, 22, 23]),  # a browser connects again with the same query
            ("/v1/events", "truck-00000000-20", [1, 2, 3]),  # nobody knows it: all there is
            ("/v1/events?after=31", None, [1, 2, 3]),
        ]:
            stream = Sse(server, path, last)
            assert stream.status == 200
            assert b"content-type: text/event-stream; charset=utf-8\r\n" in stream.head
            assert seqs(stream, 3) == expected, path
            stream.close()
        now, resumed = Sse(server, "/v1/events"), Sse(server, "/v1/events", "truck-5e0c72b1-30")
        assert next(now.events()) == {"retry": "1000"}
        daemon.tell(31, 33)
        assert seqs(now, 2) == seqs(resumed, 2) == [31, 33]


def test_every_record_exactly_once_over_a_hundred_reconnects(daemon: FakeDaemon, tmp_path: Path) -> None:
    """Cut anywhere, within a line too, while more is told; what was not whole is read again, and nothing twice."""
    dice = random.Random(17)  # noqa: S311 - it decides where to cut
    daemon.tell(*range(1, 201))
    told, got, last = 200, list[int](), None
    with serving(*arguments(daemon), log=tmp_path / "log") as server:
        for _ in range(100):
            stream = Sse(server, "/v1/events?after=0", last)
            stream.cut_after = dice.randrange(1, 20_000)
            for event in stream.events():
                if "data" in event:
                    got.append(msgspec.json.decode(event["data"])["seq"])
                    last = event["id"]
                if got and got[-1] == told:
                    break
            stream.close()
            more = dice.randrange(0, 40)
            daemon.tell(*range(told + 1, told + 1 + more))
            told += more
        rest = Sse(server, "/v1/events?after=0", last)
        got += seqs(rest, told - got[-1])
    assert got == [*range(1, told + 1)]


def test_what_is_older_than_the_ring_comes_from_the_store(daemon: FakeDaemon, tmp_path: Path) -> None:
    """The store has more than the ring here; pages of it, and the ring behind them, are one sequence."""
    daemon.tell(*range(1, SIZE + 500))
    with serving(*arguments(daemon), log=tmp_path / "log") as server:
        subscribed(server)
        for path, last, first in [
            ("/v1/events?after=0", None, 1),
            ("/v1/events?after=3", None, 4),
            ("/v1/events", "truck-5e0c72b1-200", 201),
            ("/v1/events", "truck-ffffffff-200", 1),  # of another run: not known
        ]:
            stream = Sse(server, path, last)
            assert seqs(stream, SIZE + 500 - first) == [*range(first, SIZE + 500)], path
            stream.close()
    assert {"ask": "records", "after": 199, "count": 1} in daemon.asked


def test_the_daemon_away_and_back(daemon: FakeDaemon, tmp_path: Path) -> None:
    """Streams stay, say that it is away, and go on with what was told meanwhile: each record once."""
    daemon.tell(1, 2, 3)
    with serving(*arguments(daemon), log=tmp_path / "log") as server:
        stream, late = Sse(server, "/v1/events?after=1"), None
        events = stream.events()
        got = [event["id"] for event in itertools.islice((each for each in events if "id" in each), 2)]
        for number in range(4, 10, 2):
            daemon.stop()
            assert next(event for event in events if event.get("") == "daemon away")
            late = late or Sse(server, "/v1/events", "truck-5e0c72b1-2")
            daemon.tell(number)
            daemon.start()
            daemon.tell(number + 1)
            got += [event["id"] for event in itertools.islice((each for each in events if "id" in each), 2)]
        assert got == [f"truck-5e0c72b1-{number}" for number in range(2, 10)]
        assert late is not None
        assert seqs(late, 7) == [*range(3, 10)]
    said = (tmp_path / "log").read_text()
    assert said.count("trying again") == 3, "once each time"


def test_a_stream_may_come_before_the_daemon(tmp_path: Path) -> None:
    daemon = FakeDaemon(tmp_path)
    daemon.tell(1, 2, 3)
    with serving(*arguments(daemon), log=tmp_path / "log") as server:
        resumed, new = Sse(server, "/v1/events", "truck-5e0c72b1-1"), Sse(server, "/v1/events")
        assert next(comments(resumed)) == next(comments(new)) == "daemon away"
        with daemon:
            assert seqs(resumed, 2) == [2, 3]
            assert next(comments(new)) == "daemon back"
            daemon.tell(4)
            assert seqs(new, 1) == [4]


def test_the_daemon_is_not_hammered_with_questions(daemon: FakeDaemon, tmp_path: Path) -> None:
    with serving(*arguments(daemon), log=tmp_path / "log") as server, server.client() as client:
        subscribed(server)  # it has asked what it asks by itself
        before, begun = len(daemon.asked), time.monotonic()
        for _ in range(300):
            assert client.get("/v1/ready").status_code == 200
        took = time.monotonic() - begun
        assert len(daemon.asked) - before <= took / FRESH_S + 1, "an answer is good for a while, for all who ask"


class Away(FakeDaemon):
    """Notes when it turned somebody away [s, monotonic]: who is late to look may see several at once."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.turned_away_at: list[float] = []

    def _turn_away(self) -> bool:
        if was := super()._turn_away():
            self.turned_away_at.append(time.monotonic())
        return was


def test_tries_are_further_and_further_apart() -> None:
    waits = Backoff(*RETRY_S, lambda: 0.0)
    assert [waits.wait() for _ in range(7)] == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]


def test_the_daemon_is_not_hammered_with_connections(tmp_path: Path) -> None:
    """One that turns everybody away, as where too many listen: few tries, further and further apart."""
    (tmp_path / "control.sock").parent.mkdir(exist_ok=True)
    daemon = Away(tmp_path)
    with daemon:
        daemon.turning_away = True
        with serving(*arguments(daemon), log=tmp_path / "log") as server:
            streams = [Sse(server, "/v1/events") for _ in range(10)]
            for stream in streams:
                assert next(comments(stream)) == "daemon away"
            until(lambda: len(daemon.turned_away_at) >= 3)
            first, _, third, *_ = daemon.turned_away_at
            assert third - first > 0.2  # 0.2 and 0.4 s less up to half by chance, and the first may be noted late
            daemon.turning_away = False
            assert next(comments(streams[0])) == "daemon back"


def test_who_hears_of_a_record_and_asks_gets_no_answer_from_before(daemon: FakeDaemon, tmp_path: Path) -> None:
    with serving(*arguments(daemon), log=tmp_path / "log") as server, server.client() as client:
        subscribed(server)
        stream = Sse(server, "/v1/events")
        next(stream.events())
        for number in range(10, 30):
            assert client.get(f"/v1/components/uds/faults/{number}").status_code == 404
            daemon.faults[number] = daemon.faults[1]
            daemon.tell(number)
            assert seqs(stream, 1) == [number]
            assert client.get(f"/v1/components/uds/faults/{number}").status_code == 200


def test_comments_keep_a_stream_alive(daemon: FakeDaemon, tmp_path: Path) -> None:
    with serving(*arguments(daemon), limits={"alive_s": 0.1}, log=tmp_path / "log") as server:
        for path in ("/v1/events", "/v1/live/uds"):
            said = comments(Sse(server, path))
            assert "alive" in itertools.islice(said, 12)
    assert Limits().alive_s == 15.0


def test_there_are_so_many_streams_and_no_more(daemon: FakeDaemon, tmp_path: Path) -> None:
    with serving(*arguments(daemon), log=tmp_path / "log") as server, server.client() as client:
        open_ = [Sse(server, path) for path in ["/v1/events"] * 30 + ["/v1/live/uds"] * 2]
        assert all(stream.status == 200 for stream in open_)
        until(lambda: daemon.watchers)
        assert daemon.watchers == 1, "one connection to the daemon for all who watch a system"
        for path in ("/v1/events", "/v1/live/uds"):
            answer = client.get(path)
            assert (answer.status_code, answer.json()["code"]) == (503, "too-many-streams")
            assert answer.headers["retry-after"] == "5"
        figures = strictly(client.get("/metrics").content)
        assert one(figures, "faultline_http_sse_clients", stream="events") == 30
        open_.pop(0).close()
        again = until(lambda: (found := Sse(server, "/v1/events")).status == 200 and found)
        assert again


def test_live_ticks_and_the_latest_only_for_who_is_slow(daemon: FakeDaemon, tmp_path: Path) -> None:
    with serving(*arguments(daemon), log=tmp_path / "log") as server:
        quick, slow = Sse(server, "/v1/live/uds"), Sse(server, "/v1/live/uds", receive_buffer=4096)
        until(lambda: daemon.watchers == 1)
        events = (each for each in quick.events() if "data" in each)
        for number in range(1, 301):
            daemon.tick(number, padding=20_000)
            assert msgspec.json.decode(next(events)["data"])["tick"] == number
        daemon.tick(301)
        assert msgspec.json.decode(next(events)["data"])["tick"] == 301
        got = list[int]()
        for event in slow.events():
            if "data" in event:
                assert event["event"] == "live"
                got.append(msgspec.json.decode(event["data"])["tick"])
                if got[-1] == 301:
                    daemon.tick(302)
                if got[-1] == 302:
                    break
        assert got == sorted(set(got))
        assert len(got) < 250, "what it could not take was left out"
        quick.close()
        slow.close()
        until(lambda: daemon.watchers == 0)


def test_live_goes_on_when_the_daemon_is_back(daemon: FakeDaemon, tmp_path: Path) -> None:
    with serving(*arguments(daemon), log=tmp_path / "log") as server:
        events = Sse(server, "/v1/live/uds").events()
        until(lambda: daemon.watchers == 1)
        daemon.tick(1)
        daemon.stop()
        assert next(event for event in events if event.get("") == "daemon away")
        daemon.start()
        until(lambda: daemon.watchers == 1)
        daemon.tick(2)
        assert msgspec.json.decode(next(event["data"] for event in events if "data" in event))["tick"] == 2


def test_a_client_that_reads_too_slowly_is_cut_off_and_misses_nothing(daemon: FakeDaemon, tmp_path: Path) -> None:
    """It falls out of the ring while its buffers are full; others hear everything at once."""
    limits = {"stalled_s": 60.0}
    with serving(*arguments(daemon), limits=limits, log=tmp_path / "log") as server:
        subscribed(server)
        slow, quick = Sse(server, "/v1/events", receive_buffer=4096), Sse(server, "/v1/events")
        next(slow.events())
        next(quick.events())
        total = SIZE + 2500
        for number in range(1, total, 500):
            daemon.tell(*range(number, min(number + 500, total)), padding=400)
            assert seqs(quick, min(500, total - number)) == [*range(number, min(number + 500, total))]
        got = seqs(slow, total)
        assert got == [*range(1, len(got) + 1)]
        assert 0 < len(got) < total - 1, "it was cut off"
        again = Sse(server, "/v1/events", f"truck-5e0c72b1-{got[-1]}")
        assert seqs(again, total - 1 - len(got)) == [*range(len(got) + 1, total)]


def test_a_client_that_takes_nothing_is_cut_off(daemon: FakeDaemon, tmp_path: Path) -> None:
    limits = {"stalled_s": 0.5}
    with serving(*arguments(daemon), limits=limits, log=tmp_path / "log") as server, server.client() as client:
        subscribed(server)
        slow = Sse(server, "/v1/events", receive_buffer=4096)
        assert slow.status == 200
        daemon.tell(*range(1, 3000), padding=1000)

        def figure(name: str, **labels: str) -> float:
            read = strictly(client.get("/metrics").content)
            return read[name].samples.get(frozenset(labels.items()), 0.0) if name in read else 0.0

        begun = time.monotonic()
        until(lambda: figure("faultline_http_turned_away_total", reason="takes nothing") == 1)
        assert time.monotonic() - begun < 10
        until(lambda: figure("faultline_http_sse_clients", stream="events") == 0)
