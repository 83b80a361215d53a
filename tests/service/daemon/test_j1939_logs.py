"""Logs of J1939 as vehicles make them, with DBC files as vendors ship them: the golden log's events, or a clear no."""

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

import pytest

from faultline.service.bundle.files import SEAL, seal
from faultline.service.bundle.load import load_bundle
from faultline.service.cli import main
from faultline.service.core.errors import InputError
from faultline.service.core.j1939.context import CodeTracker
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.context import SCHEMA, decode_context
from faultline.service.core.records.event import schema_of
from faultline.service.core.records.line import encode
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.decode import Wanted
from faultline.service.daemon.pipeline import BusChannel, watched
from faultline.service.diagnose import command as diagnose
from faultline.service.logs import Frame, open_log
from faultline.service.recorded.bus import LogBus

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
BUNDLE, LOG = GOLDEN / "bundle", GOLDEN / "log"
EVENTS = (GOLDEN / "events.jsonl").read_bytes()

SLOPPY = """
BO_ 257 N: 1 Vector__XXX
 SG_ a : 0|16@1+ (1,0) [0|0] "°C" Vector__XXX
 SG_ b : 8|0@1+ (1,0) [0|0] "µ" Vector__XXX
VAL_ 300 foo 0 "a" 1 "b" ;
"""


def vendors(dbc: str) -> bytes:
    """The DBC with the null address everywhere, messages that make no sense, in Windows' character set."""
    for ours in (0x98FF103D, 0x98FF20F9):
        dbc = dbc.replace(str(ours), str(ours & ~0xFF | 0xFE))
    return (dbc + SLOPPY).encode("cp1252")


def events(raw: bytes, frames: Iterator[Frame], senders: Mapping[str, int] | None = None) -> bytes:
    """What the golden bundle says of the frames, decoded with another DBC."""
    bundle = load_bundle(BUNDLE)
    units = {channel.signal: channel.unit for channel in bundle.manifest.inputs}
    table = compile_dbc(dbc_text(raw), units, "other.dbc", senders or {})
    monitor = Monitor(bundle.manifest, bundle.bank(), table, "golden", bundle.id)
    return b"".join(encode(event) for event in monitor.log(frames))


def golden_dbc() -> str:
    return (BUNDLE / "uds.dbc").read_text()


def test_a_vendors_file_gives_the_golden_events() -> None:
    assert events(vendors(golden_dbc()), open_log(LOG).relative()) == EVENTS


def with_a_second_sender(address: int) -> Iterator[Frame]:
    for frame in open_log(LOG).relative():
        yield frame
        if frame.can_id == 0x18FF103D:
            yield frame._replace(can_id=0x18FF1000 | address, data=bytes(8))


def test_so_it_does_with_a_second_sender_if_the_first_is_chosen() -> None:
    frames = with_a_second_sender(0x21)
    assert events(vendors(golden_dbc()), frames, {"UDS_ECU": 0x3D}) == EVENTS


def test_with_a_second_sender_of_which_none_is_chosen_nothing_is_diagnosed() -> None:
    found = [json.loads(line) for line in events(vendors(golden_dbc()), with_a_second_sender(0x21)).splitlines()]
    assert not any(event["diagnoses"] for event in found)
    assert found[-1]["cannot_tell"] == [each.test for each in load_bundle(BUNDLE).manifest.generators]


def in_parts(frames: Iterator[Frame]) -> Iterator[Frame]:
    """The added sensors' frames as a message of 20 bytes each, in three parts."""
    for frame in frames:
        if frame.can_id != 0x18FF20F9:
            yield frame
            continue
        payload = frame.data[:2] + bytes(12) + frame.data[2:4] + bytes(4)
        yield frame._replace(can_id=0x1CECFFF9, data=bytes.fromhex("20 14 00 03 ff 20 ff 00"))
        for k in range(3):
            part = bytes([k + 1]) + payload[7 * k : 7 * k + 7].ljust(7, b"\xff")
            yield frame._replace(can_id=0x1CEBFFF9, data=part)


def test_a_message_in_parts_gives_the_golden_events() -> None:
    dbc = golden_dbc().replace("UDS_SENSORS: 8", "UDS_SENSORS: 20").replace("y_p_ap : 16|", "y_p_ap : 112|")
    assert events(dbc.encode(), in_parts(open_log(LOG).relative())) == EVENTS


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """The golden bundle with a vendor's DBC."""
    folder = Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    raw = vendors(golden_dbc())
    (folder / "uds.dbc").write_bytes(raw)
    manifest = json.loads((folder / "manifest.json").read_bytes())
    manifest["files"]["uds.dbc"] = {"sha256": hashlib.sha256(raw).hexdigest(), "size": len(raw)}
    sealed(folder, manifest)
    return folder


def sealed(folder: Path, manifest: object) -> None:
    content = json.dumps(manifest).encode()
    (folder / "manifest.json").write_bytes(content)
    (folder / SEAL).write_bytes(seal(content))


def log_of(path: Path, frames: Iterator[Frame]) -> Path:
    path.write_text("".join(f"({1e9 + f.t:.6f}) can0 {f.can_id:08X}#{f.data.hex()}\n" for f in frames))
    return path


def test_a_log_with_two_senders_is_refused_until_one_is_chosen(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_of(tmp_path / "two.log", with_a_second_sender(0x21))
    assert main(["diagnose", str(log), "--bundle", str(bundle)]) == 2
    assert capsys.readouterr() == (
        "",
        "faultline diagnose: error: two: UDS_ECU comes from 0x21, 0x3D, and the DBC does not say which one is meant: "
        "choose one, as with --sender UDS_ECU=0x21\n",
    )
    assert main(["diagnose", str(log), "--bundle", str(bundle), "--sender", "UDS_ECU=0x3D"]) == 1
    assert "fA_du" in capsys.readouterr().out


def test_who_is_the_only_sender_is_said(bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = log_of(tmp_path / "one.log", open_log(LOG).relative())
    assert diagnose.main([str(log), "--bundle", str(bundle), "--sender", "UDS_ECU=0x3D"]) == 1
    assert capsys.readouterr().err == (
        f"faultline diagnose: {log}: of any sender, by the DBC: UDS_SENSORS from 0xF9 (1265 frames)\n"
    )


def test_a_bundle_may_have_chosen(bundle: Path, tmp_path: Path) -> None:
    log = log_of(tmp_path / "two.log", with_a_second_sender(0x21))
    manifest = json.loads((bundle / "manifest.json").read_bytes())
    sealed(bundle, manifest | {"senders": {"UDS_ECU": 0x3D}})
    assert diagnose.main([str(log), "--bundle", str(bundle)]) == 1


def test_a_recording_may_choose(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(LOG, tmp_path / "two"))
    raw = vendors(golden_dbc())
    (folder / "uds.dbc").write_bytes(raw)
    log_of(folder / "can.log", with_a_second_sender(0x21))
    described = (folder / "recording.toml").read_text()
    digest = hashlib.sha256(golden_dbc().encode()).hexdigest()
    described = described.replace(digest, hashlib.sha256(raw).hexdigest())
    (folder / "recording.toml").write_text(described)
    units = {"y_p_du": "Pa"}
    with pytest.raises(InputError, match=r"--sender UDS_ECU=0x21, or `senders` under .can. in recording"):
        open_log(folder).table(units, "two")
    (folder / "recording.toml").write_text(described.replace("[can]\n", "[can]\nsenders = { UDS_ECU = 0x3D }\n"))
    assert open_log(folder).table(units, "two").layouts[0].identifier == 0x00FF103D


@pytest.mark.parametrize("given", ["UDS_ECU", "UDS_ECU=", "=3", "UDS_ECU=0xFE", "UDS_ECU=-1", "UDS_ECU=ECM"])
def test_a_sender_that_is_none_is_refused(given: str, bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        diagnose.main([str(LOG), "--bundle", str(bundle), "--sender", given])
    assert f"{given}: give MESSAGE=ADDRESS, an address from 0x00 to 0xFD" in capsys.readouterr().err


def test_a_sender_of_a_message_that_there_is_not_is_refused(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", str(LOG), "--bundle", str(bundle), "--sender", "EEC1=0"]) == 2
    assert "a sender is chosen for EEC1; messages of J1939 with wanted signals: UDS_ECU, UDS_SENSORS" in (
        capsys.readouterr().err
    )


CODES = bytes.fromhex("43ff bf000908 54000908 ed141f01")


def with_trouble_codes(frames: Iterator[Frame]) -> Iterator[Frame]:
    """The frames, and DM1 each second: of the engine in parts until 60 s, of another device without a fault."""
    due = 0.0
    for frame in frames:
        while frame.t >= due:
            yield Frame(due, 0x18FECA0B, True, bytes.fromhex("00ff00000000ffff"))
            if due < 60.0:
                yield Frame(due, 0x1CECFF00, True, bytes.fromhex("20 0e 00 02 ff ca fe 00"))
                for k in range(2):
                    yield Frame(due, 0x1CEBFF00, True, bytes([k + 1]) + CODES[7 * k : 7 * k + 7])
            due += 1.0
        yield frame


def test_trouble_codes_of_other_devices_stand_beside_the_golden_events(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    log = log_of(tmp_path / "golden.log", with_trouble_codes(open_log(LOG).relative()))
    assert diagnose.main([str(log), "--bundle", str(BUNDLE), "--json"]) == 1
    lines = capfdbinary.readouterr().out.splitlines(keepends=True)
    records = [decode_context(line) for line in lines if schema_of(line) == SCHEMA]
    assert b"".join(line for line in lines if schema_of(line) != SCHEMA) == EVENTS
    told = [(r.sender, r.silent, [code.spn for code in r.codes]) for r in records]
    assert told == [(0x0B, False, []), (0x00, False, [191, 84, 5357]), (0x00, True, [])]
    assert [r.t_s is not None and round(r.t_s) for r in records] == [0, 0, 70]
    times = [json.loads(line)["t_s"] for line in lines]
    assert times == sorted(times)


def test_and_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = (frame for frame in with_trouble_codes(open_log(LOG).relative()) if frame.t < 59.0)
    broken = Frame(59.0, 0x18FECA33, True, b"?")
    log = log_of(tmp_path / "codes.log", chain(frames, [broken]))
    assert diagnose.main([str(log), "--bundle", str(BUNDLE)]) == 0
    captured = capsys.readouterr()
    assert "another device, 0x00, has SPN 191 FMI 9 (8 times), SPN 84 FMI 9 (8 times), SPN 5357" in captured.out
    assert "trouble codes of other devices that could not be read: 1 of 0x33 that make no sense" in captured.err


def test_a_bus_is_watched_for_trouble_codes_where_it_is_asked_to(tmp_path: Path) -> None:
    """Their frames are let through, and what they say is told beside what the bundles make of the others."""
    frames = [frame for frame in with_trouble_codes(open_log(LOG).relative()) if frame.t < 5.0]
    asked: list[Wanted] = []

    class Asked(LogBus):
        def want(self, wanted: Sequence[Wanted]) -> None:
            asked.extend(wanted)

    bus = Asked(frames)
    line = BusChannel("powertrain", bus, [], print, codes=CodeTracker())
    line.add(watched(load_bundle(BUNDLE), "truck", 1.0))
    assert {Wanted(0x00FECA00, 0x03FFFF00, True), Wanted(0x00EC0000, 0x03FF0000, True)} < set(asked)
    changes = []
    for _ in range(20):
        line.listen(bus.now)
        changes += line.changes()
    record = changes[1].record(("truck-1", 1, "2026-01-01T00:00:00Z"), None, line.name)
    assert [(each.sender, each.message) for each in changes] == [(0x0B, "DM1"), (0x00, "DM1")]
    assert (record.bus, record.t_s, [code.spn for code in record.codes]) == ("powertrain", None, [191, 84, 5357])
    assert line.listen(bus.now + 11.0) is not None
    assert [(each.sender, each.said) for each in line.changes()] == [(0x0B, None), (0x00, None)]
