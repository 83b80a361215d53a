"""The golden recording through the fault memory: what is told, kept, asked for, and there again after a restart."""

import json
import os
import selectors
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from faultline.service import faults as command
from faultline.service.bundle.load import load_bundle
from faultline.service.bus import Bus
from faultline.service.bus.base import Counts
from faultline.service.cli import main
from faultline.service.core.errors import InputError
from faultline.service.core.memory.fault_memory import FaultChange, FaultMemory
from faultline.service.core.memory.rules import Rules
from faultline.service.core.records.fault import Cleared, Fault, FaultRecord
from faultline.service.core.records.freeze_frame import FreezeFrame
from faultline.service.core.records.health import Condition
from faultline.service.daemon.control_server import ControlServer
from faultline.service.daemon.fault_recorder import FAILED_S, FaultRecorder
from faultline.service.daemon.pipeline import BusChannel, watched
from faultline.service.daemon.sequencer import Sequencer
from faultline.service.logs import Frame as CanFrame
from faultline.service.logs import open_log
from faultline.service.outputs.control import ControlSocket
from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import ProtocolError
from faultline.service.protocol.live import LiveTick
from faultline.service.store.file import Record, StoreFile
from faultline.service.store.journal import Journal

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
FRAMES = [CanFrame(t, n, extended, data) for t, n, extended, data in open_log(GOLDEN / "log").relative()]


@pytest.fixture(autouse=True)
def journals() -> Iterator[None]:
    """Ends the disk's thread of each vehicle that a test has made."""
    yield
    while OPEN:
        OPEN.pop().finish(5.0)


OPEN: list[Journal] = []


class Vehicle:
    """A service without a loop: what a log says goes through bundle, memory and store."""

    def __init__(self, path: Path | None, run: str = "1", frame_s: float = 10.0) -> None:
        self.said: list[str] = []
        self.frame_s = frame_s
        self.journal = Journal(path, self.said.append)
        OPEN.append(self.journal)
        self.watched = watched(load_bundle(GOLDEN / "bundle"), "truck", 1.0)
        self.bus = SimpleNamespace(counts=Counts(), dropped=3, trouble=None)
        self.line = BusChannel("powertrain", cast(Bus, self.bus), [self.watched], self.said.append, "socketcan:can0")
        self.fault_recorder = self.made(run)
        self.told: list[Record] = []

    def made(self, run: str) -> FaultRecorder:
        return FaultRecorder(
            *(
                Sequencer("truck", self.journal.last, run),
                self.journal,
                [self.line],
                Rules(),
                self.frame_s,
                "boot",
                0.0,
            ),
            self.said.append,
            standing=lambda: ["error-passive: powertrain"],
        )

    def hear(self, until_s: float = 1e9) -> "Vehicle":
        """Drives through the golden recording."""
        self.bus.counts.frames += 1
        self.fault_recorder.look(0.0)
        for k, frame in enumerate(FRAMES):
            if frame.t <= until_s:
                self.fault_recorder.take(self.watched, list(self.watched.hear([frame])))
            if k % 100 == 0:
                self.fault_recorder.look(1.0)
        return self

    def of(self, about: str) -> list[bytes]:
        self.told += self.journal.finish(10.0)
        return [each.line for each in self.told if each.about == about]


def _changes(vehicle: Vehicle) -> list[str]:
    return [msgspec.json.decode(line, type=FaultRecord).change for line in vehicle.of("fault")]


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store in which the golden recording's fault is remembered."""
    path = tmp_path_factory.mktemp("driven") / "store.sqlite"
    vehicle = Vehicle(path).hear()
    vehicle.journal.finish(10.0)
    assert not vehicle.said
    return path


def copied(path: Path, folder: Path) -> Path:
    (folder / "store.sqlite").write_bytes(path.read_bytes())
    return folder / "store.sqlite"


def test_a_fault_is_told_with_the_event_that_it_is_of() -> None:
    vehicle = Vehicle(None).hear()
    vehicle.told += vehicle.journal.take()
    records = [json.loads(each.line) for each in vehicle.told]
    assert [record["seq"] for record in records] == list(range(1, len(records) + 1))
    occurred = next(k for k, record in enumerate(records) if record.get("transition") == "occurred")
    confirmed = msgspec.json.decode(vehicle.told[occurred + 1].line, type=FaultRecord)
    assert confirmed.change == "confirmed"
    assert confirmed.fault.first.id == records[occurred]["id"]
    assert confirmed.fault.first.cycle == 1
    assert confirmed.fault.system == "uds"
    assert _changes(vehicle) == ["confirmed", "refined"]


def test_the_freeze_frame_shows_what_was_seen_before_and_after() -> None:
    vehicle = Vehicle(None).hear()
    frame = msgspec.json.decode(vehicle.fault_recorder.frames(1)["first"], type=FreezeFrame)
    assert frame.complete
    assert (frame.tick, frame.mode, frame.alarm) == (445, "edge", ["t02", "t06", "t09", "t12", "t19"])
    assert frame.conditions == ["error-passive: powertrain"]
    assert frame.counters["dropped"] == 3
    excerpt = frame.excerpt
    assert (excerpt.first_tick, len(excerpt.mode)) == (445 - 50, 101)
    assert {*map(len, excerpt.signals.values()), *map(len, excerpt.residuals.values())} == {101}
    assert [each.signal for each in frame.inputs] == ["y_p_tp", "y_p_ap", "y_p_du", "n_p", "dc_dose"]
    at = excerpt.signals["y_p_du"][50]
    assert at == next(each.value for each in frame.inputs if each.signal == "y_p_du")
    assert {each.test for each in frame.tests if each.verdict == "alarm"} == {*frame.alarm}


def test_a_frame_whose_drive_ends_early_says_so() -> None:
    vehicle = Vehicle(None).hear(until_s=90.0)
    frame = msgspec.json.decode(vehicle.fault_recorder.frames(1)["first"], type=FreezeFrame)
    assert not frame.complete
    assert frame.excerpt.first_tick + len(frame.excerpt.mode) - 1 == frame.tick


def test_everything_is_there_after_a_restart(driven: Path, tmp_path: Path) -> None:
    again = Vehicle(copied(driven, tmp_path), run="2")
    (fault,) = again.fault_recorder.memory.faults.values()
    assert fault.status.test_failed
    assert again.fault_recorder.cycle == 1
    if again.journal.earlier:
        assert again.journal.last == msgspec.json.decode(again.journal.earlier[-1].line, type=FaultRecord).seq
    again.hear()
    (fault,) = again.fault_recorder.memory.faults.values()
    assert (fault.number, fault.occurrences) == (1, 1), "the same one, that nobody has repaired"
    assert _changes(again) == ["refined", "refined"]  # what the tests allow, then what the window shows
    assert "frame/1/latest" not in again.journal.kept


def test_what_cannot_be_read_is_kept_apart(driven: Path, tmp_path: Path) -> None:
    path = copied(driven, tmp_path)
    store = StoreFile(path)
    store.append([], {"fault/2": b'{"number":"two"}', "cycle": b"\xff", "memory": b"[]"})
    store.close()
    vehicle = Vehicle(path)
    assert [*vehicle.fault_recorder.memory.faults] == [1]
    vehicle.journal.finish(10.0)
    left = StoreFile(path).kept
    assert {"unreadable/fault/2", "unreadable/cycle", "unreadable/memory"} < {*left}
    assert "fault/2" not in left
    assert len(vehicle.said) == 3
    assert all("cannot be read" in text and "it is kept as unreadable/" in text for text in vehicle.said)


def nested() -> list[Any]:
    """Lists in lists, deeper than anybody reads."""
    found: list[Any] = []
    for _ in range(900):
        found = [found]
    return found


def changed(driven: Path, folder: Path, row: str, change: Callable[[dict[str, Any]], object]) -> Path:
    """A copy of the store in which a row has other values."""
    path = copied(driven, folder)
    store = StoreFile(path)
    value = json.loads(store.kept[row])
    change(value)
    store.append([], {row: json.dumps(value).encode()})
    store.close()
    return path


@pytest.mark.parametrize(
    ("row", "change", "aside"),
    [
        ("fault/1", lambda f: f["modes"].append(5), {"fault/1", "frame/1/first"}),
        ("fault/1", lambda f: f.update(first=nested()), {"fault/1", "frame/1/first"}),
        ("fault/1", lambda f: f.update(number=7), {"fault/1", "frame/1/first"}),
        ("fault/1", lambda f: f.update(number=0), {"fault/1", "frame/1/first"}),
        ("fault/1", lambda f: f.update(trips=-1), {"fault/1", "frame/1/first"}),
        ("fault/1", lambda f: f.update(fdc=1000), {"fault/1", "frame/1/first"}),
        ("fault/1", lambda f: f.update(dtcs=[{"spn": 2**19, "fmi": 1}]), {"fault/1", "frame/1/first"}),
        ("fault/1", lambda f: f.pop("status"), {"fault/1", "frame/1/first"}),
        ("frame/1/first", lambda f: f.pop("excerpt"), {"frame/1/first"}),
        ("memory", lambda m: m.update(number=-3), {"memory"}),
        ("cycle", lambda c: c.update(number=1.5), {"cycle"}),
    ],
)
def test_rows_that_make_no_sense_are_set_aside_and_reported(
    driven: Path, tmp_path: Path, row: str, change: Callable[[dict[str, Any]], object], aside: set[str]
) -> None:
    """Of another version, or damaged: what a row says must not end the loop at every start."""
    path = changed(driven, tmp_path, row, change)
    vehicle = Vehicle(path, run="2")
    vehicle.fault_recorder.look(0.0)
    assert vehicle.fault_recorder.conditions == {Condition("rows-set-aside", str(path))}
    vehicle.hear()
    assert [*vehicle.fault_recorder.memory.faults] == [2 if row == "fault/1" else 1], "no number is used twice"
    vehicle.journal.finish(10.0)
    kept = StoreFile(path).kept
    assert {name.removeprefix("unreadable/") for name in kept if name.startswith("unreadable/")} == aside
    assert {text.split()[2] for text in vehicle.said} == aside
    again = Vehicle(path, run="3")
    again.fault_recorder.look(0.0)
    assert again.fault_recorder.conditions == set(), "it has been set aside"


def test_what_is_set_aside_twice_is_there_twice(driven: Path, tmp_path: Path) -> None:
    path = changed(driven, tmp_path, "cycle", lambda cycle: cycle.update(number="one"))
    Vehicle(path).journal.finish(10.0)
    store = StoreFile(path)
    store.append([], {"cycle": b"two"})
    store.close()
    Vehicle(path).journal.finish(10.0)
    kept = StoreFile(path).kept
    assert b"one" in kept["unreadable/cycle"]
    assert kept["unreadable/cycle+"] == b"two"


@pytest.mark.parametrize("method", ["event", "tick", "begin_cycle"])
def test_whatever_fails_in_the_memory_events_are_told(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """And nothing ends the loop; once it is over, what is told is remembered again."""
    told = [
        json.loads(each.line)["transition"] for each in Vehicle(None).hear().journal.take() if each.about == "event"
    ]

    def fails(*_: object) -> list[FaultChange]:
        raise KeyError("nobody thought of it")

    vehicle = Vehicle(None)
    with monkeypatch.context() as patch:
        patch.setattr(FaultMemory, method, fails)
        vehicle.hear()
    records = vehicle.journal.take()
    assert [json.loads(each.line)["transition"] for each in records if each.about == "event"] == told
    assert Condition("memory-failed", "the fault memory") in vehicle.fault_recorder.conditions
    assert [text for text in vehicle.said if "the fault memory failed" in text] == vehicle.said
    assert len(vehicle.said) == 1, "it fills no log"
    assert "KeyError: 'nobody thought of it' (test_remembering.py:" in vehicle.said[0]
    vehicle.fault_recorder.look(FAILED_S + 10.0)
    assert vehicle.fault_recorder.conditions == set()


def test_after_a_failure_the_memory_goes_on_with_what_is_kept(
    driven: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle = Vehicle(copied(driven, tmp_path), run="2")
    before = dict(vehicle.fault_recorder.memory.faults)

    def half(memory: FaultMemory, *_: object) -> list[FaultChange]:
        memory.faults.clear()
        raise ValueError("half done")

    with monkeypatch.context() as patch:
        patch.setattr(FaultMemory, "clear", half)
        assert vehicle.fault_recorder.clear(1, "anna") is None
    assert vehicle.fault_recorder.memory.faults == before
    vehicle.hear()
    assert [*vehicle.fault_recorder.memory.faults] == [1]


@pytest.mark.parametrize("frame_s", [10.0, 1.0], ids=["recent", "older than what is recorded"])
@pytest.mark.parametrize("has_before", [False, True])
def test_a_fault_that_was_told_before_the_store_opened_enters_it(
    driven: Path, tmp_path: Path, has_before: bool, frame_s: float
) -> None:
    """The wound: "no fault is remembered" beside one that stands; and a system under another name than before."""
    path = tmp_path / "mounted" / "late" / "store.sqlite"
    vehicle = Vehicle(path, frame_s=frame_s).hear()
    assert [*vehicle.fault_recorder.memory.faults] == [1]
    told = vehicle.journal.take()
    (tmp_path / "elsewhere").mkdir()
    if has_before:
        names = {f"{vehicle.watched.place} on powertrain": "uds@powertrain"}
        store = StoreFile(copied(driven, tmp_path / "elsewhere"))
        rows = {"names": json.dumps(names).encode()}
        rows["fault/1"] = store.kept["fault/1"].replace(b'"system":"uds"', b'"system":"uds@powertrain"')
        store.append([], rows)
        store.close()
    (tmp_path / "mounted").mkdir()
    (tmp_path / "elsewhere").rename(tmp_path / "mounted" / "late")
    end = time.monotonic() + 30.0
    while not vehicle.journal.take_up():
        assert time.monotonic() < end
        time.sleep(0.05)
    vehicle.fault_recorder.take_up()
    assert vehicle.fault_recorder.conditions == set()
    [fault] = vehicle.fault_recorder.memory.faults.values()
    assert (fault.number, fault.occurrences, fault.status.test_failed) == (1, 1, True)  # the same, which had not passed
    assert [*vehicle.fault_recorder.systems] == ["uds@powertrain" if has_before else "uds"]
    changes = [json.loads(line)["change"] for line in vehicle.of("fault")]
    assert changes[0] == ("refined" if has_before else "confirmed")
    assert min(each.seq for each in vehicle.told) > 0
    assert len(told) > 0
    again = Vehicle(path, run="2")
    assert again.fault_recorder.memory.faults == vehicle.fault_recorder.memory.faults


def test_erasing_that_fails_is_said(served: "Served", monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FaultMemory, "clear", lambda *_: 1 // 0)
    with ControlClient(served.path) as control, pytest.raises(ProtocolError, match="nothing was erased") as refused:
        control.ask_json("clear", number=1)
    assert refused.value.code == "not-kept"


def test_a_bundle_that_is_taken_up_goes_on_with_its_faults(driven: Path, tmp_path: Path) -> None:
    vehicle = Vehicle(copied(driven, tmp_path))
    bundle = load_bundle(GOLDEN / "bundle")
    vehicle.watched.take_up(bundle._replace(id="f" * 64))
    vehicle.fault_recorder.take(vehicle.watched, [])
    assert vehicle.fault_recorder.systems["uds"].system.bundle == "f" * 64
    assert [*vehicle.fault_recorder.memory.faults] == [1]


def test_systems_of_the_same_name_are_told_apart_by_their_bus() -> None:
    vehicle = Vehicle(None)
    other = BusChannel(
        "trailer", cast(Bus, vehicle.bus), [watched(load_bundle(GOLDEN / "bundle"), "truck", 1.0)], print
    )
    vehicle.line.bundles[:] = [vehicle.watched]
    vehicle.journal.remember({"names": None})
    both = FaultRecorder(
        *(Sequencer("truck", 0, "1"), vehicle.journal, [vehicle.line, other], Rules(), 10.0, "boot", 0.0, print, list),
    )
    assert [*both.systems] == ["uds@powertrain", "uds@trailer"]
    alone = vehicle.made("2")
    assert [*alone.systems] == ["uds@powertrain"], "the other was refused: its faults are remembered under this name"
    alone.lines = [vehicle.line, other]
    alone.add(other, other.bundles[0])
    assert [*alone.systems] == ["uds@powertrain", "uds@trailer"]


def test_a_system_whose_name_was_given_to_one_that_is_refused_now_gets_another() -> None:
    vehicle = Vehicle(None)
    trailer = BusChannel(
        "trailer", cast(Bus, vehicle.bus), [watched(load_bundle(GOLDEN / "bundle"), "truck", 1.0)], print
    )
    absent = [f"{vehicle.watched.place} on powertrain"]
    alone = FaultRecorder(
        *(Sequencer("truck", 0, "1"), vehicle.journal, [trailer], Rules(), 10.0, "boot", 0.0, print, list, absent),
    )
    assert [*alone.systems] == ["uds@trailer"]


class Served:
    """The control socket of a vehicle, in a thread that turns as the loop does."""

    def __init__(self, vehicle: Vehicle, path: Path, clear: tuple[str, ...] = ()) -> None:
        self.vehicle, self.path = vehicle, path
        self.socket = ControlSocket(path, clear)
        self.answers = ControlServer(
            vehicle.fault_recorder, vehicle.journal, lambda: ("truck", "2026-11-23T12:00:00Z", vehicle.journal.last, [])
        )
        self.socket.answers = self.answers
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._turn)
        self._thread.start()

    def _turn(self) -> None:
        with selectors.DefaultSelector() as selector:
            self.socket.register(selector)
            selector.register(self.vehicle.journal.fileno(), selectors.EVENT_READ)
            while not self._stop.is_set():
                ready = selector.select(0.02)
                for record in self.vehicle.journal.take():
                    self.answers.told(record)
                self.socket.serve(ready)
                self.socket.tick()
            self.socket.close()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


@pytest.fixture
def served(driven: Path, tmp_path: Path) -> Iterator[Served]:
    made = Served(Vehicle(copied(driven, tmp_path)), tmp_path / "control.sock")
    yield made
    made.close()
    made.vehicle.journal.finish(5.0)


def test_faults_can_be_asked_for(served: Served) -> None:
    with ControlClient(served.path) as control:
        answer = control.ask_json("faults")
        (fault,) = msgspec.convert(answer["faults"], list[Fault])
        assert (answer["overflow"], fault.number) == (False, 1)
        detail = control.ask_json("fault", number=1)
        assert msgspec.convert(detail["frames"]["first"], FreezeFrame).complete
        assert detail["frames"]["latest"] is None
        with pytest.raises(ProtocolError, match="no fault 2 is remembered") as refused:
            control.ask_json("fault", number=2)
        assert refused.value.code == "unknown"
        with pytest.raises(ProtocolError, match="name the fault"):
            control.ask_json("fault")


def test_state_and_meanings_can_be_asked_for(served: Served) -> None:
    with ControlClient(served.path) as control:
        state = control.ask_json("state")
        assert (state["source"], state["cycle"]) == ("truck", 1)
        assert state["store"]["failing"] is False
        assert state["buses"] == [
            {
                "name": "powertrain",
                "interface": "socketcan:can0",
                "frames": 0,
                "dropped": 3,
                "errors": 0,
                "trouble": None,
            }
        ]
        (system,) = state["systems"]
        assert (system["name"], system["tick"], len(system["cannot_tell"])) == ("uds", None, 10)
        meaning = control.ask_json("system", name="uds")
        assert meaning["inputs"][0]["unit"] == "Pa"
        assert {"name": "t02.ode", "test": "t02"}.items() <= meaning["generators"][0].items()
        assert {each["name"] for each in meaning["faults"]} >= {"fA_t", "fA_du"}
        with pytest.raises(ProtocolError, match="there is no system 'brakes'; those are uds"):
            control.ask_json("system", name="brakes")


def test_what_was_told_can_be_asked_for_in_pages(served: Served) -> None:
    with ControlClient(served.path) as control:
        everything = control.ask_json("records", after=0)["records"]
        assert [record["seq"] for record in everything] == list(range(1, len(everything) + 1))
        assert control.ask_json("records", after=2, count=3)["records"] == everything[2:5]
        assert control.ask_json("records", before=6, count=2)["records"] == everything[3:5]
        assert control.ask_json("records", count=1)["records"] == everything[-1:]
        for wrong in ({"count": 501}, {"count": 0}, {"after": -1}, {"after": 1, "before": 2}, {"before": 2**63}):
            with pytest.raises(ProtocolError) as refused:
                control.ask_json("records", **wrong)
            assert refused.value.code == "bad-request"


def test_erasing_is_answered_once_it_is_on_the_disk(served: Served) -> None:
    with ControlClient(served.path) as control:
        answer = control.ask_json("clear", number=1)
        assert answer["cleared"] == [1]
        assert control.ask_json("faults")["faults"] == []
        last = control.ask_json("records", count=1)["records"][0]
        assert (last["schema"], last["numbers"], last["id"]) == ("faultline.cleared/1", [1], answer["id"])
        assert msgspec.json.decode(json.dumps(last).encode(), type=Cleared).by
        assert control.ask_json("clear")["cleared"] == []
    served.vehicle.journal.finish(5.0)
    kept = StoreFile(cast(Path, served.vehicle.journal.path)).kept
    assert not [name for name in kept if name.startswith(("fault/", "frame/"))]


def test_erasing_that_the_disk_does_not_take_is_said(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(StoreFile, "append", full)
    with (
        ControlClient(served.path) as control,
        pytest.raises(ProtocolError, match="the disk has not taken that") as refused,
    ):
        control.ask_json("clear", number=1)
    assert refused.value.code == "not-kept"


def test_only_who_may_can_erase(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 4711)
    monkeypatch.setattr(
        "faultline.service.outputs.control._asker", lambda *_: SimpleNamespace(user="mallory", may_clear=False)
    )
    with (
        ControlClient(served.path) as control,
        pytest.raises(ProtocolError, match="mallory may not erase faults") as refused,
    ):
        control.ask_json("clear", number=1)
    assert refused.value.code == "not-allowed"
    assert [*served.vehicle.fault_recorder.memory.faults] == [1]


@pytest.mark.parametrize(
    "line",
    [
        b"hello\n",
        b"[]\n",
        b'{"ask":"everything"}\n',
        b'{"ask":"fault","number":"3"}\n',
        b'{"ask":"faults","x":1}\n',
        b"\xff\n",
    ],
)
def test_what_makes_no_sense_is_answered_and_the_connection_goes_on(served: Served, line: bytes) -> None:
    with socket.socket(socket.AF_UNIX) as sock, sock.makefile("rb") as lines:
        sock.settimeout(5)
        sock.connect(str(served.path))
        sock.sendall(line + b'{"ask":"faults"}\n')
        assert json.loads(lines.readline())["error"]["code"] == "bad-request"
        assert json.loads(lines.readline())["faults"]


def test_live_values_are_the_newest(served: Served) -> None:
    with ControlClient(served.path) as control:
        ticks = control.live("uds")
        first: list[LiveTick] = []
        listener = threading.Thread(target=lambda: first.extend(next(ticks) for _ in range(2)))
        listener.start()
        served.vehicle.hear(until_s=20.0)
        while listener.is_alive():
            served.vehicle.hear(until_s=0.0)
            listener.join(0.05)
            served.vehicle.fault_recorder.take(served.vehicle.watched, list(served.vehicle.watched.hear(_later(20.0))))
    assert first[1].tick > first[0].tick
    assert len(first[0].z) == len(first[0].quality) == 5
    assert len(first[0].r) == len(first[0].sums) == 10


_CLOCK = [0.0]


def _later(begin: float) -> list[CanFrame]:
    """The recording goes on for half a second."""
    _CLOCK[0] += 0.5
    return [frame for frame in FRAMES if begin + _CLOCK[0] - 0.5 < frame.t <= begin + _CLOCK[0]]


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    code = main(["faults", *arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_the_command_lists_shows_and_erases(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    at = ("--control", str(served.path))
    code, out, _ = run(capsys, "list", *at)
    assert code == 1
    assert out.splitlines()[0] == "1. uds: is there, confirmed, status 0xAF, SPN 520192 FMI 11"
    code, out, _ = run(capsys, "show", "1", *at)
    assert code == 0
    assert "components: dosing unit filter, pressure sensor after the pump" in out
    assert "when it was told first:" in out
    assert "of y_p_du" in out
    code, out, _ = run(capsys, "list", "--json", *at)
    assert (code, len(json.loads(out)["faults"])) == (1, 1)
    assert run(capsys, "clear", "1", *at)[:2] == (0, "erased: 1\n")
    assert run(capsys, "list", *at)[:2] == (0, "no fault is remembered\n")
    assert run(capsys, "clear", "--all", *at)[:2] == (0, "nothing was remembered\n")


def test_the_export_is_everything(
    served: Served, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "PAGE", 3)
    code, out, _ = run(capsys, "export", "--control", str(served.path))
    document = json.loads(out)
    assert code == 0
    assert (document["schema"], document["state"]["source"]) == ("faultline.export/1", "truck")
    assert document["faults"][0]["frames"]["first"]["complete"]
    assert [record["seq"] for record in document["records"]] == list(range(1, len(document["records"]) + 1))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["list", "--control", "/nowhere/control.sock"],
            "control.sock: No such file or directory; is the service",
        ),
        (["show", "7"], "no fault 7 is remembered"),
        (["clear", "7"], "no fault 7 is remembered"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(
    served: Served, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    given = arguments if "--control" in arguments else [*arguments, "--control", str(served.path)]
    code, _, err = run(capsys, *given)
    assert code == 2
    assert said in err
    assert err.count("\n") == 1


def test_a_service_that_breaks_off_is_said(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "c"))
        listener.listen()

        def serve(answer: bytes) -> Callable[[], None]:
            def once() -> None:
                with listener.accept()[0] as sock:
                    sock.recv(4096)
                    sock.sendall(answer)

            return once

        for answer, said in ((b'{"fau', "it broke off"), (b"hello\n", "sent no answer")):
            thread = threading.Thread(target=serve(answer))
            thread.start()
            with ControlClient(tmp_path / "c") as control, pytest.raises(InputError, match=said):
                control.ask_json("faults")
            thread.join()


def test_questions_at_once_are_answered_one_after_the_other(served: Served) -> None:
    with socket.socket(socket.AF_UNIX) as sock, sock.makefile("rb") as lines:
        sock.settimeout(10)
        sock.connect(str(served.path))
        sock.sendall(b"\n" * 2000 + b'{"ask":"faults"}\n' * 200)
        answers = [json.loads(lines.readline()) for _ in range(2200)]
    assert [*map(list, answers)] == [["error"]] * 2000 + [["faults", "overflow", "seq"]] * 200


def test_who_asks_and_does_not_read_is_sent_away(served: Served) -> None:
    with socket.socket(socket.AF_UNIX) as sock:
        sock.settimeout(10)
        sock.connect(str(served.path))
        with pytest.raises(OSError, match=r"Broken pipe|reset"):
            sock.sendall(b'{"ask":"fault","number":1}\n' * 1_000_000)
    with ControlClient(served.path) as control:
        assert control.ask_json("faults")["faults"]


def test_bundles_of_one_name_on_one_bus_are_told_apart() -> None:
    vehicle = Vehicle(None)
    vehicle.line.bundles.append(watched(load_bundle(GOLDEN / "bundle"), "truck", 1.0))
    vehicle.journal.remember({"names": None})
    for run in ("2", "3"):
        both = vehicle.made(run)
        assert [*both.systems] == ["uds@powertrain", "uds@powertrain-2"]
    for each in vehicle.line.bundles:
        both.take(each, [])


def test_no_number_is_used_twice_whatever_was_lost(driven: Path, tmp_path: Path) -> None:
    path = copied(driven, tmp_path)
    store = StoreFile(path)
    store.append([], {"memory": None})
    store.close()
    assert Vehicle(path).fault_recorder.memory.remembered.number == 2


def test_what_is_erased_and_still_there_has_a_freeze_frame_again() -> None:
    vehicle = Vehicle(None).hear(until_s=95.0)
    vehicle.fault_recorder.clear(1, "root")
    for frame in FRAMES:
        if 95.0 < frame.t <= 100.0:
            vehicle.fault_recorder.take(vehicle.watched, list(vehicle.watched.hear([frame])))
    assert [*vehicle.fault_recorder.memory.faults] == [2]
    assert vehicle.fault_recorder.frames(2)["first"]


def test_the_frame_of_what_it_was_not_is_gone_with_it(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path / "store.sqlite").hear()
    [fault] = vehicle.fault_recorder.memory.faults.values()
    latest = f"frame/{fault.number}/latest"
    vehicle.journal.remember({latest: b"{}"})
    vehicle.fault_recorder._tell([], [FaultChange("withdrawn", fault)])
    assert latest not in vehicle.journal.kept
    assert {f"fault/{fault.number}", f"frame/{fault.number}/first"} <= set(vehicle.journal.kept)
