"""The daemon's loop with a bus and a clock that do what they are told."""

import os
import selectors
import signal
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import msgspec
import pytest

from faultline.service.bundle.load import Bundle, load_bundle
from faultline.service.bus import Bus, BusError
from faultline.service.bus.base import Counts
from faultline.service.bus.losses import Losses
from faultline.service.core.j1939.context import CodeTracker
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.context import decode_context
from faultline.service.core.records.event import Event
from faultline.service.core.records.health import SCHEMA, Condition, Health, Standing
from faultline.service.core.records.line import encode
from faultline.service.core.signals.decode import DecodeTable, Rejected
from faultline.service.core.signals.traffic import Traffic
from faultline.service.daemon.clocks import Clocks
from faultline.service.daemon.command import main
from faultline.service.daemon.loop import LOSSES_S, Loop
from faultline.service.daemon.pipeline import LAG_S, BusChannel, Pipeline
from faultline.service.daemon.sequencer import Sequencer
from faultline.service.logs import Frame
from faultline.service.outputs.socket import EventSocket
from faultline.service.store.file import Record
from faultline.service.store.journal import Journal
from faultline.service.systemd import Notifier

BUNDLE = load_bundle(Path(__file__).resolve().parents[2] / "golden" / "bundle")._replace(table=DecodeTable({}))


class Clock:
    """Stands still but for what a bus does to it."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


class Script(Bus):
    """A bus that does one step of a script at each call, then is lost; it always looks as if frames waited."""

    def __init__(self, *steps: Callable[["Script"], list[Frame]]) -> None:
        super().__init__()
        self.steps = list(steps)
        self.dropped_frames = 0
        self._read, self._write = os.pipe()
        os.write(self._write, b"x")

    def fileno(self) -> int:
        return self._read

    @property
    def dropped(self) -> int:
        return self.dropped_frames

    def receive(self) -> list[Frame]:
        if not self.steps:
            raise BusError("told so")
        return self.steps.pop(0)(self)

    def send(self, frame: Frame) -> None:
        raise NotImplementedError

    def close(self) -> None:
        os.close(self._read)
        os.close(self._write)


class Heard:
    """A monitor that only notes the log times it is given [s]."""

    next_tick_s = 0.0
    quality = None

    def __init__(self) -> None:
        self.told: list[tuple[str, float]] = []

    def frame(self, t_s: float, _id: int, _extended: bool, _data: bytes, _bus: str = "") -> list[Event]:
        self.told.append(("frame", t_s))
        return []

    def doubt(self, _signals: object) -> None:
        pass

    def advance(self, t_s: float) -> list[Event]:
        self.told.append(("clock", t_s))
        return []


Serve = Callable[..., list[tuple[str, float]]]


def say(text: str) -> None:
    print(text, file=sys.stderr)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def serve(tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Serve:
    """Runs the script to its end; gives what the monitor was told."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)

    def run(
        *steps: Callable[[Script], list[Frame]], speed: float = 1.0, codes: CodeTracker | None = None
    ) -> list[tuple[str, float]]:
        heard, calm = Heard(), SimpleNamespace(note=lambda _: None, look=lambda *_: set(), doubted={})
        with Script(*steps) as bus, Journal(None, say) as journal, EventSocket(tmp_path / "s") as subscribers:
            assert isinstance(bus, Script)
            made = cast(tuple[Monitor, Traffic], (heard, calm))
            line = BusChannel("bus", bus, [Pipeline(BUNDLE, lambda _: made, speed)], say, codes=codes)
            with pytest.raises(BusError):
                Loop(
                    Sequencer("truck", journal.last, ""), [line], journal, subscribers, Notifier({}), say, clock
                ).serve()
        return heard.told

    return run


def frame(t: float) -> Frame:
    return Frame(t, 1, True, b"")


def test_no_tick_runs_past_a_frame_that_came_while_the_bus_was_read(serve: Serve, clock: Clock) -> None:
    """A process that is stopped between reading the bus and the clock must not take the pause for silence."""

    def stalled(_bus: Script) -> list[Frame]:
        clock.now += 1.0
        return []

    told = serve(lambda _: [frame(100.0)], stalled, lambda _: [frame(100.5)], speed=20.0)
    assert told == [("frame", 0.0), ("clock", pytest.approx(-LAG_S * 20)), ("frame", 10.0)]


def test_the_clock_runs_on_where_the_bus_is_silent(serve: Serve, clock: Clock) -> None:
    def later(_bus: Script) -> list[Frame]:
        clock.now += 1.0
        return []

    told = serve(later, lambda _: [frame(101.0)], later, later)
    assert told == [("frame", 0.0), ("clock", pytest.approx(-LAG_S)), ("clock", pytest.approx(1.0 - LAG_S))]


def test_losses_are_told_once_a_minute_where_there_are_new_ones_and_at_the_end(
    serve: Serve, clock: Clock, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[int] = []

    def lose(dropped: int, seconds: float) -> Callable[[Script], list[Frame]]:
        def step(bus: Script) -> list[Frame]:
            said.append(capsys.readouterr().err.count("dropped by the kernel"))
            bus.dropped_frames += dropped
            clock.now += seconds
            return []

        return step

    minute = LOSSES_S
    serve(lose(2, minute / 2), lose(1, minute), lose(0, minute), lose(4, 1.0), lose(0, 1.0))
    assert said == [0, 0, 1, 0, 0]
    assert "frames dropped by the kernel 7\n" in capsys.readouterr().err


@pytest.mark.parametrize("is_asked", [True, False])
def test_trouble_codes_of_other_devices_are_told_where_they_are_asked_for(
    is_asked: bool, serve: Serve, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    dm1 = Frame(100.0, 0x18FECA07, True, bytes.fromhex("04ff7d140a01ffff"))
    serve(lambda _: [dm1, dm1._replace(t=101.0)], codes=CodeTracker() if is_asked else None)
    lines = capfdbinary.readouterr().out.splitlines()
    assert len(lines) == is_asked
    for line in lines:
        told = decode_context(line)
        assert (told.id, told.seq, told.bus, told.sender, told.t_s) == ("truck-1", 1, "bus", 7, None)
        assert (told.wall is not None, [code.spn for code in told.codes]) == (True, [5245])


def test_nothing_lost_nothing_said(serve: Serve, capsys: pytest.CaptureFixture[str]) -> None:
    serve(lambda _: [frame(100.0)])
    assert capsys.readouterr().err == ""


def test_every_kind_of_loss_is_told() -> None:
    bus = SimpleNamespace(dropped=1, counts=Counts(9, 2, 3, 4, 5, 6, 7, 8))
    stranger = "A never came from 0xFE, its parameter group came from 0x3D: give the DBC that source address"
    table = SimpleNamespace(
        rejected=Rejected({"A": 9, "B": 1}, {"A": 11}, {"A": 12}, early={"A": 13}, unclear={"B": 14}),
        incomplete=lambda: {"A": 15},
        strangers=lambda: [stranger],
    )
    losses = Losses(cast(Bus, bus), [cast(DecodeTable, table)])
    assert losses.news() == (
        "since the start: frames dropped by the kernel 1, remote frames 2, no frames 3, sent by this machine 4, "
        "error frames 5, shorter than in the DBC 10, of another sender 11, too early to be the same sender's 13, "
        "from several senders, of which none is chosen 14, messages in parts that were not all there 15, "
        "multiplexed by an unknown value 12, times bus-off 6, times the interface went down 7, times it was removed 8; "
        + stranger
    )
    assert losses.news() is None
    bus.counts.link_downs += 1
    assert "went down 8" in (losses.news() or "")


@pytest.mark.parametrize("speed", ["0", "-1", "nan", "inf"])
def test_speed_is_a_positive_number(speed: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--bundle", "b", "--bus", "socketcan:vcan0", "--socket", "s", "--speed", speed])
    assert caught.value.code == 2
    assert "--speed must be a number above zero" in capsys.readouterr().err


class Wire(Bus):
    """A bus on a pipe that is replaced when it is told; frames are what the test puts there."""

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[Frame] = []
        self.ends = os.pipe()

    def put(self, *frames: Frame) -> None:
        self.frames += frames
        os.write(self.ends[1], b"x")

    def fileno(self) -> int:
        return -1 if self.trouble == "removed" else self.ends[0]

    @property
    def dropped(self) -> int:
        return 0

    def receive(self) -> list[Frame]:
        taken, self.frames = self.frames, []
        if taken:
            os.read(self.ends[0], 1)
        return taken

    def send(self, frame: Frame) -> None:
        raise NotImplementedError

    def close(self) -> None:
        for end in self.ends:
            os.close(end)

    def pull(self) -> None:
        self.close()
        self.trouble = "removed"
        self.counts.removals += 1

    def plug(self) -> None:
        self.ends = os.pipe()
        self.trouble = None


class Told:
    """A loop of made parts that is turned by a script of acts, a second of its clock apart."""

    def __init__(
        self, tmp_path: Path, clock: Clock, buses: int = 1, store: Path | None = None, name: str = "truck"
    ) -> None:
        self.clock, self.said = clock, list[str]()
        self.path = tmp_path / "told"
        self.wires = [Wire() for _ in range(buses)]
        self.heard = [Heard() for _ in range(buses)]
        self.restarts = [0] * buses
        self.subscribers = EventSocket(self.path)
        self.sleeps = 0.0
        lines = [BusChannel(f"can{k}", self.wires[k], [self.watched(k)], self.said.append) for k in range(buses)]
        kernel = Clocks(lambda: clock.now, lambda: clock.now + self.sleeps, lambda: clock.now + self.sleeps)
        self.journal = Journal(store, self.said.append)
        sequencer = Sequencer(name, self.journal.last, "")
        self.loop = Loop(
            sequencer, lines, self.journal, self.subscribers, Notifier({}), self.said.append, clock, kernel
        )

    def watched(self, k: int) -> Pipeline:
        def make(_: Bundle) -> tuple[Monitor, Traffic]:
            self.restarts[k] += 1
            return cast(
                tuple[Monitor, Traffic],
                (self.heard[k], SimpleNamespace(note=lambda _: None, look=lambda *_: set(), doubted={})),
            )

        return Pipeline(BUNDLE, make, 1.0)

    def run(self, *acts: Callable[[], None]) -> None:
        """Each act, and a turn of the loop a second later; then it is stopped."""
        steps = iter(acts)

        def look() -> None:
            type(self.loop)._look(self.loop)
            self.clock.now += 1.0
            act = next(steps, None)
            if act is None:
                self.loop._stopped = True
            else:
                act()

        self.loop._look = look  # type: ignore[method-assign]
        with self.journal, self.subscribers:
            self.loop.serve()


def nothing() -> None:
    return


@pytest.mark.parametrize("rest_s", [0.0, 0.2])
def test_a_bus_that_brings_frames_wakes_nobody_until_the_next_tick(rest_s: float, tmp_path: Path, clock: Clock) -> None:
    told = Told(tmp_path, clock)
    [line], [wire] = told.loop._lines, told.wires
    with told.journal, told.subscribers, selectors.DefaultSelector() as every, selectors.EpollSelector() as buses:
        told.loop._buses = buses
        told.loop._register(line)
        wire.put(frame(clock.now))
        line.rest_s = rest_s
        ready = told.loop._waited(every)
    wire.close()
    assert bool(ready) == (rest_s == 0.0)


@pytest.fixture
def told(tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], Told]:
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr("faultline.service.daemon.loop.IDLE_S", 0.001)
    return lambda buses: Told(tmp_path, clock, buses)


def test_a_bus_that_goes_and_comes_is_told_and_heard_again(
    told: Callable[[int], Told], capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    made = told(1)
    [wire] = made.wires
    made.run(
        lambda: wire.put(frame(101.0)),
        wire.pull,
        *[nothing] * 4,
        wire.plug,
        lambda: wire.put(frame(108.0)),
        *[nothing] * 12,
    )
    assert [t for what, t in made.heard[0].told if what == "frame"] == [0.0, 7.0]
    lines = [msgspec.json.decode(line, type=Health) for line in capfdbinary.readouterr().out.splitlines()]
    assert [[(each.kind, each.of) for each in line.conditions] for line in lines] == [[("bus-removed", "can0")], []]
    assert [(line.seq, line.id) for line in lines] == [(1, "truck-1"), (2, "truck-2")]
    assert made.said[:2] == ["can0 the interface is not there", "all is well with buses and signals"]
    wire.close()


def test_a_subscriber_may_get_the_descriptor_of_a_bus_that_went(told: Callable[[int], Told]) -> None:
    """It connects in the very turn in which the bus is lost, and the kernel gives the lowest number that is free."""
    made = told(1)
    [wire] = made.wires
    clients: list[socket.socket] = []

    def lost_while_listening() -> None:
        clients.append(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        clients[0].connect(str(made.path))
        clients[0].sendall(b"{}\n")

        def receive() -> list[Frame]:
            if wire.trouble is None:
                wire.pull()
            return []

        wire.receive = receive  # type: ignore[method-assign]

    made.run(nothing, lost_while_listening, *[nothing] * 5)
    assert clients[0].recv(4096).startswith(b'{"schema":"faultline.health/1"')
    clients[0].close()


def test_each_bundle_hears_its_own_bus(told: Callable[[int], Told]) -> None:
    made = told(2)
    one, other = made.wires
    made.run(lambda: one.put(frame(101.0), frame(101.5)), lambda: other.put(frame(102.0)), nothing)
    heard = [[t for what, t in each.told if what == "frame"] for each in made.heard]
    assert heard == [[0.0, 0.5], [0.0]]
    for wire in made.wires:
        wire.close()


def test_after_a_sleep_everything_begins_anew(told: Callable[[int], Told]) -> None:
    """The monotonic clock stood: what is queued, and what was seen before, is of a time that is gone."""
    made = told(1)
    [wire] = made.wires

    def sleep() -> None:
        made.sleeps += 3600.0
        wire.put(frame(101.0))

    made.run(lambda: wire.put(frame(100.0)), sleep, nothing, lambda: wire.put(frame(105.0)), nothing)
    assert made.restarts == [2]
    assert [t for what, t in made.heard[0].told if what == "frame"][-1] == 0.0
    assert any("the machine slept for 3600 s" in text for text in made.said)
    wire.close()


def test_what_an_earlier_run_said_stands_until_this_one_says_otherwise(
    told: Callable[[int], Told], tmp_path: Path, clock: Clock, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    """A bus that was gone when the process was killed, and is there when it is back: subscribers must hear of it."""
    store = tmp_path / "events.sqlite"
    first = Told(tmp_path, clock, store=store, name="truck-a")
    first.run(lambda: first.wires[0].put(frame(101.0)), first.wires[0].pull, *[nothing] * 5)
    second = Told(tmp_path, clock, store=store, name="truck-b")
    second.run(*[nothing] * 12)
    lines = [msgspec.json.decode(line, type=Health) for line in capfdbinary.readouterr().out.splitlines()]
    assert [[(each.kind, each.of) for each in line.conditions] for line in lines] == [[("bus-removed", "can0")], []]
    assert [(line.seq, line.id) for line in lines] == [(1, "truck-a-1"), (2, "truck-b-2")]
    second.wires[0].close()


def test_after_a_stop_of_the_process_everything_begins_anew(told: Callable[[int], Told]) -> None:
    """Ten hours of ticks at once would take minutes, in which nobody is served."""
    made = told(1)
    [wire] = made.wires

    def stop() -> None:
        made.clock.now += 36_000.0
        wire.put(frame(101.0))

    made.run(lambda: wire.put(frame(100.0)), stop, nothing, lambda: wire.put(frame(36_105.0)), nothing)
    assert made.restarts == [2]
    assert [t for what, t in made.heard[0].told if what == "frame"][-1] == 0.0
    assert any("this process was stopped for 36001 s" in text for text in made.said)
    wire.close()


def test_a_bus_that_is_lost_in_the_flush_after_a_sleep_and_its_descriptor_taken_by_the_other(
    told: Callable[[int], Told],
) -> None:
    made = told(2)
    one, other = made.wires

    def sleep() -> None:
        made.sleeps += 3600.0
        taken = other.receive

        def lost() -> list[Frame]:
            other.receive = taken  # type: ignore[method-assign]
            other.pull()
            one.pull()
            one.plug()
            return []

        other.receive = lost  # type: ignore[method-assign]

    made.run(nothing, sleep, nothing, nothing, other.plug, lambda: other.put(frame(105.0)), nothing)
    assert [t for what, t in made.heard[1].told if what == "frame"] == [0.0]
    for wire in made.wires:
        wire.close()


def test_a_standard_output_that_nobody_empties_holds_nobody_up(
    told: Callable[[int], Told], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = told(1)
    read, write = os.pipe()
    with os.fdopen(write, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        lines = [Record(k, "event", b"x" * 9999 + b"\n") for k in range(1, 20)]
        made.run(nothing, lambda: made.loop._tell(lines), nothing)
    os.close(read)
    assert made.said == ["standard output: nobody reads it; events go on over the socket"]
    made.wires[0].close()


def test_a_restart_with_the_ignition_off_does_not_say_that_all_is_well(
    told: Callable[[int], Told], tmp_path: Path, clock: Clock, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    """What only frames can show is not known to be gone because this process has just begun."""
    store = tmp_path / "events.sqlite"
    silent = Condition("no-traffic", "ALL")
    line = encode(
        Health(
            schema=SCHEMA,
            id="truck-a-1",
            seq=1,
            wall=None,
            conditions=[Standing(kind=silent.kind, of=silent.of, since="before")],
        )
    )
    with Journal(store, print) as earlier:
        earlier.put(Record(1, "health", line))
        earlier.finish(10.0)
    made = Told(tmp_path, clock, store=store, name="truck-b")
    found: list[Condition] = []
    traffic = SimpleNamespace(note=lambda _: None, look=lambda *_: set(found), doubted={})
    watched = Pipeline(BUNDLE, lambda _: cast(tuple[Monitor, Traffic], (Heard(), traffic)), 1.0)
    made.loop._lines[0].bundles[:] = [watched]
    made.loop._fault_recorder.systems["uds"].watched = watched
    made.run(*[nothing] * 29, lambda: found.append(silent), *[nothing] * 20)
    assert capfdbinary.readouterr().out == b"", "it stands, as before: nothing is news"
    made.wires[0].close()
