"""A system whose signals are on two buses: offline, recorded and live the same events as from one."""

import json
import shutil
from itertools import count
from pathlib import Path

import pytest

from faultline.service.bundle.files import SEAL, BundleError, seal
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.context import decode_context
from faultline.service.core.records.event import Event, decode
from faultline.service.daemon.command import main
from faultline.service.daemon.pipeline import BusChannel, check_buses, connect, watched
from faultline.service.diagnose import command as diagnose
from faultline.service.logs import Frame, LogError, open_log
from faultline.service.recorded.bus import LogBus
from faultline.service.recorded.service import Recording
from faultline.service.survey import command as survey

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
SENSORS, ECU = "18FF20F9", "18FF103D"
OWN = "trailer"
OTHER = "UDS_SENSORS come"


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The golden bundle, whose UDS_SENSORS comes on the bus `trailer`."""
    folder = tmp_path_factory.mktemp("bundle") / "bundle"
    shutil.copytree(GOLDEN / "bundle", folder)
    manifest = json.loads((folder / "manifest.json").read_bytes())
    raw = json.dumps({**manifest, "buses": {"UDS_SENSORS": OWN}}).encode()
    (folder / "manifest.json").write_bytes(raw)
    (folder / SEAL).write_bytes(seal(raw))
    return folder


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The golden log with UDS_SENSORS on can1; on each bus the other one's identifier carries something else."""
    lines = []
    for line in (GOLDEN / "log" / "can.log").read_text().splitlines():
        stamp, _, frame = line.split(" ")
        number = frame.partition("#")[0]
        lines.append(f"{stamp} {'can1' if number == SENSORS else 'can0'} {frame}")
        if number in (SENSORS, ECU):
            lines.append(f"{stamp} {'can0' if number == SENSORS else 'can1'} {number}#0102030405060708")
    path = tmp_path_factory.mktemp("log") / "golden.log"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def events() -> list[Event]:
    """Those of the golden log."""
    return [decode(line) for line in (GOLDEN / "events.jsonl").read_bytes().splitlines()]


def told(found: list[Event]) -> list[tuple[object, ...]]:
    return [(each.tick, each.transition, each.alarm, each.cannot_tell, each.diagnoses) for each in found]


def test_diagnose_takes_each_message_from_its_bus(
    bundle: Path, log: Path, events: list[Event], capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    given = ["--bundle", str(bundle), "--channel", "can0", "--channel", f"{OWN}=can1", "--json"]
    assert diagnose.main([str(log), *given]) == 1
    found = [decode(line) for line in capfdbinary.readouterr().out.splitlines()]
    assert told(found) == told(events)


def test_log_looks_for_each_message_on_its_bus(
    bundle: Path, log: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    def signals(*channels: str, code: int) -> dict[str, tuple[list[str], str]]:
        words = [word for each in channels for word in ("--channel", each)]
        assert survey.main([str(log), "--bundle", str(bundle), *words, "--json"]) == code
        rows = json.loads(capfdbinary.readouterr().out)["signals"]
        return {each["signal"]: (each["channels"], each["why"]) for each in rows}

    found = signals("can0", f"{OWN}=can1", code=0)
    assert found["y_p_tp"] == (["can1"], "")
    assert found["n_p"] == (["can0"], "")
    assert signals("can0", code=1)["y_p_tp"] == (
        [],
        f"it comes on bus {OWN}: say which channel that is with --channel {OWN}=CHANNEL",
    )
    assert not signals(f"{OWN}=can0", code=0)["y_p_tp"][1]  # a message of its identifier comes there too
    with pytest.raises(InputError, match=r"--channel other=can1: the bundle .* names no such bus"):
        survey.main([str(log), "--bundle", str(bundle), "--channel", "other=can1"])


def test_a_device_of_one_bus_is_not_that_of_the_other(
    bundle: Path, log: Path, tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    """Both have address 0, and trouble codes of their own: neither takes the other's for a change."""
    lines = log.read_text().splitlines()
    codes = [
        f"({float(lines[0].split()[0].strip('()')) + k:.6f}) can{k % 2} 18FECA00#00FF{1 + k % 2:02X}000101FFFF"
        for k in range(40)
    ]
    path = tmp_path / "codes.log"
    path.write_text("\n".join(sorted([*lines, *codes])) + "\n")
    given = ["--bundle", str(bundle), "--channel", "can0", "--channel", f"{OWN}=can1", "--json"]
    assert diagnose.main([str(path), *given]) == 1
    records = [
        decode_context(line) for line in capfdbinary.readouterr().out.splitlines() if b"faultline.context" in line
    ]
    appeared = [(each.bus, [code.spn for code in each.codes]) for each in records if each.codes]
    assert appeared == [("can0", [1]), ("can1", [2])]


def test_frame_by_frame_and_by_columns_are_the_same(bundle: Path, log: Path, events: list[Event]) -> None:
    loaded, opened = load_bundle(bundle), open_log(log, "can0", {OWN: "can1"})
    monitor = Monitor(loaded.manifest, loaded.bank(), loaded.table, "golden", loaded.id)
    found = [
        event
        for bus, frame in opened.by_bus(loaded.table)
        for event in monitor.frame(frame.t, frame.can_id, frame.is_extended, frame.data, bus)
    ]
    assert told(found) == told(events)[: len(found)]
    assert len(found) >= len(events) - 1
    again = load_bundle(bundle)
    list(Monitor(again.manifest, again.bank(), again.table, "golden", again.id).signals(opened.signals(again.table)))
    assert again.table.taken == loaded.table.taken == {"UDS_ECU": 635, "UDS_SENSORS": 1265}
    assert again.table.rejected == loaded.table.rejected
    assert not loaded.table.rejected.total


def test_a_recording_says_which_channel_is_which(bundle: Path, log: Path, tmp_path: Path, events: list[Event]) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(GOLDEN / "log", folder)
    shutil.copy(log, folder / "can.log")
    text = (folder / "recording.toml").read_text()
    text += f'channel = "can0"\nbuses = {{ {OWN} = "can1" }}\nmessages = {{ UDS_SENSORS = "{OWN}" }}\n'
    (folder / "recording.toml").write_text(text)
    loaded, opened = load_bundle(bundle), open_log(folder)
    monitor = Monitor(loaded.manifest, loaded.bank(), loaded.table, "golden", loaded.id)
    assert told(list(monitor.signals(opened.signals(loaded.table)))) == told(events)
    units = {each.signal: each.unit for each in loaded.manifest.inputs}
    table = opened.table(units, "x")
    assert [*table.buses] == [OWN]
    assert sum(len(piece.columns.get("y_p_tp", [[]])[0]) for piece in opened.signals(table).pieces()) == 1265
    recording = Recording(opened, folder, load_bundle(bundle), lambda _: None, lambda _: None)
    found = [
        decode(record.line) for record in recording.records if record.line.startswith(b'{"schema":"faultline.event')
    ]
    assert told(found) == told(events)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ([], f"{OTHER} on bus trailer, which is not known: its channels are can0, can1; say .* --channel trailer=NAME"),
        (["--channel", "trailer=can7"], f"{OTHER} on bus trailer, which is channel can7, which it has not: its chan"),
    ],
)
def test_a_bus_that_nobody_maps_is_named(bundle: Path, log: Path, given: list[str], words: str) -> None:
    with pytest.raises(LogError, match=words):
        diagnose.main([str(log), "--bundle", str(bundle), "--channel", "can0", *given])


def test_a_bus_that_the_bundle_does_not_name_is_refused(bundle: Path, log: Path) -> None:
    with pytest.raises(InputError, match=r"--channel trialer=can1: the bundle .* names trailer"):
        diagnose.main([str(log), "--bundle", str(bundle), "--channel", "can0", "--channel", "trialer=can1"])


@pytest.mark.parametrize("first", ["own", "other"])
def test_live_frames_of_two_buses_are_taken_in_order_of_time(
    bundle: Path, log: Path, events: list[Event], first: str
) -> None:
    """In each turn one bus is read after the other, and frames come meanwhile: they wait until both were read."""
    loaded, opened = load_bundle(bundle), open_log(log, "can0", {OWN: "can1"})
    by_bus: dict[str, list[Frame]] = {"": [], OWN: []}
    for bus, frame in opened.by_bus(loaded.table):
        by_bus[bus].append(frame)
    pipeline = watched(loaded, "golden", 1.0)
    now = 0.0

    class Turn(LogBus):
        """Gives what has come by now."""

        def __init__(self, frames: list[Frame]) -> None:
            super().__init__([])
            self._waiting = frames

        def receive(self) -> list[Frame]:
            count = next((k for k, frame in enumerate(self._waiting) if frame.t > now), len(self._waiting))
            found, self._waiting = self._waiting[:count], self._waiting[count:]
            return found

    own = BusChannel("powertrain", Turn(by_bus[""]), [pipeline], lambda _: None)
    other = BusChannel(OWN, Turn(by_bus[OWN]), [], lambda _: None)
    connect([own, other])
    found: list[Event] = []
    for k in count():
        if now > opened.duration_s:
            break
        for line in (own, other) if first == "own" else (other, own):
            begin = now
            now += 0.004 + 0.013 * (k % 3)  # what comes while the buses are read
            for _, heard in line.listen(begin):
                found += heard
    assert told(found) == told(events)
    assert loaded.table.taken == {"UDS_ECU": 635, "UDS_SENSORS": 1264}  # the last frame ends the log


def test_a_bus_that_is_silent_makes_its_signals_late_and_the_others_go_on(bundle: Path, log: Path) -> None:
    loaded, opened = load_bundle(bundle), open_log(log, "can0", {OWN: "can1"})
    pipeline = watched(loaded, "golden", 1.0)
    own = BusChannel("powertrain", LogBus([]), [pipeline], lambda _: None)
    other = BusChannel(OWN, LogBus([]), [], lambda _: None)
    connect([own, other])
    last = 0.0
    for bus, frame in opened.by_bus(loaded.table):
        last = frame.t
        if bus or frame.t > 50.0:
            pipeline.put(OWN, [frame] if bus and frame.t < 40.0 else [], frame.t)
        list(pipeline.hear_all([] if bus else [frame], frame.t))
    conditions = {(each.kind, each.of) for each in pipeline.look(last)}
    assert {("missing", "y_p_tp"), ("missing", "y_p_ap")} <= conditions
    assert ("missing", "y_p_du") not in conditions


def test_a_configuration_without_that_bus_refuses_the_bundle(bundle: Path, tmp_path: Path) -> None:
    words = r"UDS_SENSORS come on bus trailer, which the configuration has not; its buses are .*: add a \[\[bus\]\]"
    with pytest.raises(BundleError, match=words):
        check_buses(load_bundle(bundle), ["can0", "can1"])
    given = ["--bundle", str(bundle), "--socket", str(tmp_path / "x.sock")]
    with pytest.raises(BundleError, match=words):
        main([*given, "--bus", "udp_multicast:239.74.163.9:43999"])
    with pytest.raises(InputError, match="give one bus without a name"):
        main([*given, "--bus", "trailer=udp_multicast:239.74.163.9:43999"])


def test_a_table_gives_the_signals_of_any_bus(bundle: Path, tmp_path: Path) -> None:
    """It has no channels, so none is asked for."""
    path = tmp_path / "x.csv"
    path.write_text(
        "time,y_p_tp,y_p_ap,y_p_du,n_p,dc_dose\n" + "".join(f"{k / 5},1e5,1e5,1e5,0,0\n" for k in range(50))
    )
    with pytest.raises(InputError, match="could never tell, so no alarm is no all-clear"):
        diagnose.main([str(path), "--bundle", str(bundle)])
