"""`faultline diagnose`: the golden log's events byte by byte, and every kind of bad input."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from service import diagnose
from service.bundle import load_bundle
from service.bundle_files import SEAL, seal
from service.cli import main
from service.core.dbc import compile_dbc
from service.core.events import Event, decode, encode
from service.core.monitor import Monitor
from service.logs import Frame, open_log

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
BUNDLE, LOG = GOLDEN / "bundle", GOLDEN / "log"
EVENTS = (GOLDEN / "events.jsonl").read_bytes()


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that a command ends with."""
    assert main(["diagnose", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


def monitor(source: str = "golden") -> Monitor:
    bundle = load_bundle(BUNDLE)
    return Monitor(bundle.manifest, bundle.bank(), bundle.table, source, bundle.id)


def test_the_golden_log_gives_the_golden_events(capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    assert diagnose.main([str(LOG), "--bundle", str(BUNDLE), "--json"]) == 1
    assert capfdbinary.readouterr().out == EVENTS


def test_the_core_driven_directly_gives_the_same_bytes() -> None:
    events = b"".join(encode(event) for event in monitor().log(open_log(LOG).relative()))
    assert events == EVENTS


def test_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert diagnose.main([str(LOG), "--bundle", str(BUNDLE)]) == 1
    out = capsys.readouterr().out
    assert "1. fA_du (dosing unit filter: filter clogged)" in out
    assert "no fault: every test is quiet" in out


def test_a_log_without_fault_ends_with_0(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    lines = (LOG / "can.log").read_bytes().splitlines(keepends=True)
    quiet = tmp_path / "quiet.log"
    quiet.write_bytes(b"".join(lines[: len(lines) // 2]))  # 60 of 120 s: all tests can tell, the onset is to come
    assert diagnose.main([str(quiet), "--bundle", str(BUNDLE), "--json"]) == 0
    events = [decode(line) for line in capfdbinary.readouterr().out.splitlines()]
    assert [event.transition for event in events] == ["started", "cannot_tell", "cannot_tell"]
    assert events[-1].cannot_tell == []
    assert events[0].id == "quiet-1"


def test_a_log_in_which_no_test_could_tell_is_no_all_clear(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (LOG / "can.log").read_text().splitlines(keepends=True)
    short, silent = tmp_path / "short.log", tmp_path / "silent.log"
    short.write_text("".join(lines[: len(lines) // 10]))
    silent.write_text("".join(line for line in lines if " 18FF20F9#" not in line and " 18FF103D#" not in line))
    for path in (short, silent):
        assert main(["diagnose", str(path), "--bundle", str(BUNDLE), "--json"]) == 2
        captured = capsys.readouterr()
        assert decode(captured.out.splitlines()[0].encode()).transition == "started"
        assert "t02 t06 t08 t09 t10 t12 t13 t19 t20 t21 could never tell, so no alarm is no all-clear" in captured.err


def test_tests_that_never_could_tell_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (LOG / "can.log").read_text().splitlines(keepends=True)
    path = tmp_path / "no-box.log"
    path.write_text("".join(line for line in lines if " 18FF20F9#" not in line))
    assert main(["diagnose", str(path), "--bundle", str(BUNDLE), "--json"]) == 2
    err = capsys.readouterr().err
    assert "no-box.log: t02 t06 t08 t09 t10 t12 t13 t19 t20 could never tell, so no alarm is no all-clear" in err


def test_a_recording_of_too_few_sensors_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(shutil.copytree(LOG, tmp_path / "log"))
    described = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(described.replace('"instrumented"\n\n', '"production"\n\n'))
    err = refused([str(folder), "--bundle", str(BUNDLE)], capsys)
    assert f"{folder / 'recording.toml'}: sensor_set is 'production', the bundle {BUNDLE} needs 'instrumented'; " in err
    assert "give recordings of an instrumented vehicle, or tune and export a model without the added sensors" in err


def test_a_log_cut_in_mid_line_is_used_as_far_as_it_goes_and_the_loss_is_said(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    folder = Path(shutil.copytree(LOG, tmp_path / "log"))
    content = (folder / "can.log").read_bytes()
    (folder / "can.log").write_bytes(content[:-20])
    assert diagnose.main([str(folder), "--bundle", str(BUNDLE), "--json"]) == 1
    captured = capfdbinary.readouterr()
    assert captured.out == EVENTS
    assert b"the last line is cut off and was not used" in captured.err


def test_what_is_not_a_log_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "notes.log"
    path.write_text("dear diary\n")
    assert "notes.log: line 1: not a CAN log" in refused([str(path), "--bundle", str(BUNDLE)], capsys)


def test_a_log_that_is_not_there_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "nowhere" in refused([str(tmp_path / "nowhere"), "--bundle", str(BUNDLE)], capsys)


def test_a_bundle_with_a_changed_byte_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    (folder / "ode.onnx").write_bytes(b"\0" + (folder / "ode.onnx").read_bytes()[1:])
    assert "ode.onnx: its bytes differ" in refused([str(LOG), "--bundle", str(folder)], capsys)


def test_an_unknown_bundle_version_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    manifest = folder / "manifest.json"
    raw = manifest.read_bytes().replace(b"faultline.bundle/5", b"faultline.bundle/9")
    manifest.write_bytes(raw)
    (folder / SEAL).write_bytes(seal(raw))
    assert "schema: this is 'faultline.bundle/9'" in refused([str(LOG), "--bundle", str(folder)], capsys)


def test_a_missing_dbc_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(shutil.copytree(LOG, tmp_path / "log"))
    (folder / "uds.dbc").unlink()
    assert "uds.dbc: not found" in refused([str(folder), "--bundle", str(BUNDLE)], capsys)


def test_a_recording_of_another_dbc_than_the_bundles_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import hashlib

    folder = Path(shutil.copytree(LOG, tmp_path / "log"))
    dbc = folder / "uds.dbc"
    before = hashlib.sha256(dbc.read_bytes()).hexdigest()
    dbc.write_text(dbc.read_text() + "\n")
    after = hashlib.sha256(dbc.read_bytes()).hexdigest()
    description = folder / "recording.toml"
    description.write_text(description.read_text().replace(before, after))
    words = refused([str(folder), "--bundle", str(BUNDLE)], capsys)
    assert f"recorded with DBC {after[:12]}, the bundle was made for {before[:12]}" in words


def without_sensors(frames: Iterator[Frame]) -> Iterator[Frame]:
    return (frame for frame in frames if frame.can_id != 0x18FF20F9)


def test_a_signal_that_never_appears_blinds_its_tests_and_no_others() -> None:
    """Without the sensor box only tests fed by y_p_du, n_p and dc_dose go on: t21."""
    events = list(monitor().log(without_sensors(open_log(LOG).relative())))
    blind = ["t02", "t06", "t08", "t09", "t10", "t12", "t13", "t19", "t20"]
    assert events[0].transition == "started"
    assert [e.cannot_tell for e in events if e.transition == "cannot_tell"] == [blind]
    assert not any(event.diagnoses for event in events)


def test_a_sensor_lost_in_mid_fault_does_not_heal_the_fault() -> None:
    frames = list(open_log(LOG).relative())
    lost = [f for f in frames if f.t < 90 or f.can_id != 0x18FF20F9]
    events = list(monitor().log(iter(lost)))
    last: Event = events[-1]
    assert last.transition == "cannot_tell"
    assert "t02" in last.cannot_tell
    assert ["fA_du"] in [diagnosis.faults for diagnosis in last.diagnoses]


def test_not_available_is_no_value() -> None:
    """0xFFFF in the sensor frame from 30 s on: 0xFF is not 3276.75 kPa, its tests cannot tell."""
    frames = [
        f._replace(data=b"\xff" * 8) if f.t > 30 and f.can_id == 0x18FF20F9 else f for f in open_log(LOG).relative()
    ]
    events = list(monitor().log(iter(frames)))
    assert not any(event.diagnoses for event in events)
    assert events[-1].cannot_tell == ["t02", "t06", "t08", "t09", "t10", "t12", "t13", "t19", "t20"]


def test_a_second_sender_of_the_same_group_is_not_listened_to() -> None:
    frames = []
    for frame in open_log(LOG).relative():
        frames.append(frame)
        if frame.can_id == 0x18FF103D:
            frames.append(frame._replace(can_id=0x18FF103E, data=bytes(8)))
    assert b"".join(encode(event) for event in monitor().log(iter(frames))) == EVENTS


def test_an_empty_log_has_no_events() -> None:
    assert list(monitor().log(iter([]))) == []


def test_the_decode_table_of_the_bundle_is_that_of_its_dbc() -> None:
    bundle = load_bundle(BUNDLE)
    units = {channel.signal: channel.unit for channel in bundle.manifest.inputs}
    assert bundle.table.wanted == compile_dbc((BUNDLE / "uds.dbc").read_text(), units, "x").wanted
