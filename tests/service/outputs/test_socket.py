"""The event socket serves every client what it asked for, and lets none hold up the others."""

import errno
import os
import resource
import selectors
import socket
import stat
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import pytest

from faultline.service.core.errors import InputError
from faultline.service.core.records.event import SCHEMA, Event, decode
from faultline.service.core.records.line import encode
from faultline.service.outputs import lines
from faultline.service.outputs import socket as module
from faultline.service.outputs.socket import EventSocket, Read
from faultline.service.store.file import Record
from faultline.service.store.journal import Page


def event(seq: int) -> Event:
    return Event(
        schema=SCHEMA,
        id=f"truck-{seq}",
        seq=seq,
        tick=10 * seq,
        t_s=2.0 * seq,
        wall=None,
        transition="started",
        diagnoses=[],
        alarm=[],
        cannot_tell=["t02"],
        since_tick=None,
        bundle="0" * 64,
    )


class Loop:
    """The daemon's loop, turned by hand."""

    def __init__(self, path: Path, earlier: Sequence[Record] = (), read: Read | None = None) -> None:
        self.path = path
        self.selector = selectors.DefaultSelector()
        self.events = EventSocket(path, earlier, read)
        self.events.register(self.selector)
        self.clients: list[socket.socket] = []

    def turn(self) -> None:
        """Until nothing is left to do; the kernel hands local bytes over at once."""
        while ready := self.selector.select(0):
            self.events.serve(ready)

    def publish(self, told: Event) -> None:
        self.events.publish(Record(told.seq, "event", encode(told)))

    def client(self, request: bytes = b"") -> socket.socket:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sock.settimeout(5)
        sock.connect(str(self.path))
        sock.sendall(request)
        self.clients.append(sock)
        self.turn()
        return sock

    def close(self) -> None:
        self.events.close()
        self.selector.close()
        for sock in self.clients:
            sock.close()


@pytest.fixture
def loop(tmp_path: Path) -> Iterator[Loop]:
    served = Loop(tmp_path / "events.sock")
    yield served
    served.close()


def received(sock: socket.socket) -> list[int]:
    """Sequence numbers of what has come."""
    sock.setblocking(False)
    content = b""
    while True:
        try:
            part = sock.recv(65536)
        except BlockingIOError:
            break
        if not part:
            break
        content += part
    assert content == b"" or content.endswith(b"\n")
    return [decode(line).seq for line in content.splitlines()]


def ended(sock: socket.socket) -> bool:
    """Whether the server has closed the connection."""
    sock.setblocking(False)
    try:
        return sock.recv(1) == b""
    except ConnectionResetError:  # closed with something of ours unread
        return True
    except BlockingIOError:
        return False


def test_every_client_gets_new_events(loop: Loop) -> None:
    loop.publish(event(1))
    clients = [loop.client(b"{}\n"), loop.client(b"{}\n")]
    loop.publish(event(2))
    loop.publish(event(3))
    assert [received(sock) for sock in clients] == [[2, 3], [2, 3]]


def test_nothing_is_sent_before_the_request(loop: Loop) -> None:
    sock = loop.client()
    loop.publish(event(1))
    loop.turn()
    assert received(sock) == []
    sock.sendall(b'{"aft')
    loop.turn()
    assert received(sock) == []
    sock.sendall(b'er":0}\n')
    loop.turn()
    assert received(sock) == [1]


@pytest.mark.parametrize(("after", "expected"), [(0, [1, 2, 3, 4]), (2, [3, 4]), (3, [4])])
def test_earlier_events_can_be_asked_for(loop: Loop, after: int, expected: list[int]) -> None:
    for seq in (1, 2, 3):
        loop.publish(event(seq))
    sock = loop.client(b'{"after":%d}\n' % after)
    loop.publish(event(4))
    assert received(sock) == expected


def test_a_number_from_before_a_restart_gets_everything(loop: Loop) -> None:
    loop.publish(event(1))
    assert received(loop.client(b'{"after":500}\n')) == [1]
    assert received(loop.client(b'{"after":1}\n')) == []


def test_the_ring_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RING", 3)
    loop = Loop(tmp_path / "e.sock")
    for seq in range(1, 6):
        loop.publish(event(seq))
    assert received(loop.client(b'{"after":0}\n')) == [3, 4, 5]
    loop.close()


def all_of(loop: Loop, slow: socket.socket, last: int) -> list[int]:
    """What a client gets that begins to read now, until the event of number `last`."""
    slow.setblocking(True)
    content = b""
    while not content.endswith(b"\n") or decode(content.splitlines()[-1]).seq < last:
        loop.events.serve(loop.selector.select(0))
        content += slow.recv(65536)
    return [decode(line).seq for line in content.splitlines()]


def test_a_slow_client_holds_up_nobody_and_sees_what_it_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RING", 50)
    loop = Loop(tmp_path / "e.sock")
    slow, quick = loop.client(b"{}\n"), loop.client(b"{}\n")
    got: list[int] = []
    for seq in range(1, 5001):
        loop.publish(event(seq))
        got += received(quick)
    assert got == list(range(1, 5001))
    seen = all_of(loop, slow, 5000)
    gap = next(k for k, (one, other) in enumerate(pairwise(seen)) if other != one + 1)
    assert seen == [*range(1, seen[gap] + 1), *range(4951, 5001)]
    loop.close()


class Store:
    """Gives pages of what was told, at once or when it is told to; as the journal does."""

    def __init__(self, seqs: Sequence[int]) -> None:
        self.records = [Record(seq, "event", encode(event(seq))) for seq in seqs]
        self.waiting: list[Callable[[], None]] = []
        self.at_once, self.fails = True, False

    def read(self, page: Page, then: Callable[[list[Record] | None], None]) -> None:
        assert page.after is not None
        found = [each for each in self.records if each.seq > page.after][: page.most]
        self.waiting.append(lambda: then(None if self.fails else found))
        if self.at_once:
            self.waiting.pop()()


def test_who_is_behind_the_ring_reads_from_the_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RING", 50)
    store = Store(range(1, 5001))
    loop = Loop(tmp_path / "e.sock", read=store.read)
    slow = loop.client(b"{}\n")
    for seq in range(1, 5001):
        loop.publish(event(seq))
    assert all_of(loop, slow, 5000) == list(range(1, 5001))
    for after in (0, 17, 4949, 4950, 4951):
        assert all_of(loop, loop.client(b'{"after":%d}\n' % after), 5000) == list(range(after + 1, 5001))
    assert all_of(loop, loop.client(b'{"after":"truck-300"}\n'), 5000) == list(range(301, 5001))
    assert all_of(loop, loop.client(b'{"after":"bus-300"}\n'), 5000) == list(range(1, 5001))  # no such id
    loop.close()


def test_a_store_that_is_slow_or_fails_holds_up_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RING", 5)
    store = Store(range(1, 21))
    store.at_once = False
    loop = Loop(tmp_path / "e.sock", read=store.read)
    for seq in range(1, 21):
        loop.publish(event(seq))
    behind, quick, gone = loop.client(b'{"after":3}\n'), loop.client(b"{}\n"), loop.client(b'{"after":"truck-2"}\n')
    gone.close()
    loop.turn()
    loop.publish(event(21))
    assert (received(behind), received(quick)) == ([], [21])
    store.fails = True
    for answer in store.waiting:
        answer()
    assert received(behind) == [17, 18, 19, 20, 21]  # the gap shows in the numbers
    loop.close()


def test_a_client_that_reads_late_misses_nothing_within_the_ring(loop: Loop) -> None:
    sock = loop.client(b"{}\n")
    for seq in range(1, 3001):  # more than a socket's buffer
        loop.publish(event(seq))
    sock.setblocking(True)
    content = b""
    while content.count(b"\n") < 3000:
        loop.events.serve(loop.selector.select(0))
        content += sock.recv(65536)
    assert [decode(line).seq for line in content.splitlines()] == list(range(1, 3001))


@pytest.mark.parametrize(
    "request_line",
    [b"hello\n", b"[]\n", b'{"before":1}\n', b'{"after":"\xff"}\n', b'{"\xff":1}\n', b"\xff\n", b"x" * 5000],
)
def test_a_request_that_makes_no_sense_is_answered_and_ended(loop: Loop, request_line: bytes) -> None:
    sock = loop.client(request_line)
    loop.turn()
    assert sock.recv(4096).startswith(b'{"error":"')
    assert ended(sock)
    loop.publish(event(1))


def test_clients_may_leave_at_any_time(loop: Loop) -> None:
    stays, leaves = loop.client(b"{}\n"), loop.client(b"{}\n")
    leaves.close()
    loop.publish(event(1))
    loop.turn()
    loop.publish(event(2))
    assert received(stays) == [1, 2]


def test_too_many_clients_are_turned_away(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lines, "CLIENTS", 1)
    first, second = loop.client(b"{}\n"), loop.client(b"{}\n")
    loop.publish(event(1))
    assert received(first) == [1]
    assert second.recv(100) == b'{"error":"too many clients"}\n'
    assert ended(second)


def test_who_asks_for_nothing_makes_room_at_once(loop: Loop) -> None:
    """As many silent clients as there is room for, which come back whenever one is sent away, keep nobody out."""
    silent = [loop.client() for _ in range(lines.CLIENTS)]
    for seq in range(1, 4):
        good = loop.client(b"{}\n")
        loop.publish(event(seq))
        assert received(good) == [seq]
        assert silent[0].recv(100) == b'{"error":"too many clients"}\n'
        assert ended(silent.pop(0))
        silent.append(loop.client())
    assert not ended(silent[1])
    assert loop.events.conditions == set()


def test_where_descriptors_are_short_clients_are_refused_and_the_rest_keeps_its_own(loop: Loop) -> None:
    first = loop.client(b"{}\n")
    _, hard = limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    os.close(lowest := os.dup(0))
    resource.setrlimit(
        resource.RLIMIT_NOFILE,
        (next(n for n in range(lowest, 4096) if n - min(lines.RESERVED, n // 4) > lowest), hard),
    )  # the client has one, the other end is next
    try:
        assert loop.client(b"{}\n").recv(100) == b'{"error":"too many clients"}\n'
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert {each.kind for each in loop.events.conditions} == {"clients-refused"}
    loop.publish(event(1))
    assert received(first) == [1]
    again = loop.client(b"{}\n")
    loop.publish(event(2))
    assert received(again) == [2]


def test_a_process_without_a_descriptor_does_not_spin_and_accepts_again(
    loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full:
        """A listening socket whose process has no descriptor left."""

        def accept(self) -> None:
            raise OSError(errno.EMFILE, "Too many open files")

        def fileno(self) -> int:
            return listener.fileno()

    listener = loop.events._listener
    monkeypatch.setattr(lines, "AGAIN_S", 0.2)
    monkeypatch.setattr(loop.events, "_listener", Full())
    waits = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    loop.clients.append(waits)
    waits.connect(str(loop.path))
    loop.turn()
    assert loop.selector.select(0) == []
    assert {each.kind for each in loop.events.conditions} == {"clients-refused"}
    monkeypatch.setattr(loop.events, "_listener", listener)
    while not (ready := loop.selector.select(0.05)):
        loop.events.serve(ready)
    waits.sendall(b"{}\n")
    loop.turn()
    loop.publish(event(1))
    assert received(waits) == [1]


def test_who_goes_on_talking_is_sent_away(loop: Loop) -> None:
    """It would keep the loop at full turn."""
    sock = loop.client(b"{}\n")
    sock.sendall(b"and another thing\n")
    loop.turn()
    assert sock.recv(100) == b'{"error":"one line is all that is asked"}\n'
    assert ended(sock)


def test_what_came_after_an_id_can_be_asked_for(tmp_path: Path) -> None:
    """Of an earlier run too; an id that is not known gets everything, whatever its number."""
    earlier = [Record(seq, "event", encode(event(seq))) for seq in (7, 8)]
    loop = Loop(tmp_path / "e.sock", earlier)
    loop.publish(event(9))
    for after, expected in (("truck-7", [8, 9]), ("truck-9", []), ("other-8", [7, 8, 9]), ("truck", [7, 8, 9])):
        assert received(loop.client(b'{"after":"%s"}\n' % after.encode())) == expected
    assert received(loop.client(b'{"after":7}\n')) == [8, 9]
    assert received(loop.client(b"{}\n")) == []
    loop.close()


def test_an_id_that_another_record_names_too_is_its_own(tmp_path: Path) -> None:
    late = Record(50, "fault", b'{"schema":"faultline.fault/1","id":"truck-50","seq":50,"first":{"id":"truck-17",}}\n')
    made = EventSocket(tmp_path / "e.sock", [late], Store([]).read)
    asked: list[Page] = []
    made._read_store = lambda page, _: asked.append(page)
    with selectors.DefaultSelector() as selector, socket.socket(socket.AF_UNIX) as sock:
        made.register(selector)
        sock.connect(str(tmp_path / "e.sock"))
        sock.sendall(b'{"after":"truck-17"}\n')
        while ready := selector.select(0):
            made.serve(ready)
        made.close()
    assert asked == [Page(1, after=16)], "it is looked for in the store"


def test_keys_of_others_are_left_alone(loop: Loop) -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        loop.selector.register(ours, selectors.EVENT_READ)
        theirs.send(b"x")
        loop.events.serve(loop.selector.select(1))
        assert ours.recv(1) == b"x"


def test_only_the_daemons_group_may_connect(loop: Loop) -> None:
    assert stat.S_IMODE(loop.path.stat().st_mode) == 0o660


def test_the_processs_umask_is_left_as_it_was(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with EventSocket(tmp_path / "e.sock"):
            assert os.umask(0o027) == 0o027
    finally:
        os.umask(before)


def test_the_file_goes_with_the_process(tmp_path: Path) -> None:
    path = tmp_path / "e.sock"
    with EventSocket(path):
        assert path.exists()
    assert not path.exists()


def test_a_dead_processes_file_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "e.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    with EventSocket(path), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.connect(str(path))


def test_a_living_processes_is_not(loop: Loop) -> None:
    with pytest.raises(InputError, match="another process listens there"):
        EventSocket(loop.path)
    assert loop.path.exists()


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "precious"
    path.write_text("x")
    with pytest.raises(InputError, match="is no socket"):
        EventSocket(path)
    assert path.read_text() == "x"


@pytest.mark.parametrize("name", ["absent/e.sock", "x" * 200])
def test_a_path_that_cannot_be_used_is_bad_input(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"give another --socket"):
        EventSocket(tmp_path / name)


def test_closing_the_selector_first_is_fine(tmp_path: Path) -> None:
    with EventSocket(tmp_path / "e.sock") as events, selectors.DefaultSelector() as selector:
        events.register(selector)
    assert not (tmp_path / "e.sock").exists()
