"""`faultline diagnose`: the golden log's events byte by byte, and every kind of bad input."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from faultline.service.bundle.files import SEAL, seal
from faultline.service.bundle.load import load_bundle
from faultline.service.cli import main
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Event, decode
from faultline.service.core.records.line import encode
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.diagnose import command as diagnose
from faultline.service.logs import Frame, open_log

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
    assert "no fault so far: every test is quiet" in out


def test_a_log_without_fault_ends_with_0(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    lines = (LOG / "can.log").read_bytes().splitlines(keepends=True)
    quiet = tmp_path / "quiet.log"
    quiet.write_bytes(b"".join(lines[: len(lines) // 2]))  # 60 of 120 s: all tests can tell, the onset is to come
    assert diagnose.main([str(quiet), "--bundle", str(BUNDLE), "--json"]) == 0
    events = [decode(line) for line in capfdbinary.readouterr().out.splitlines()]
    assert [event.transition for event in events] == ["started", "cannot_tell"]
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


def in_another_format(path: Path, frames: list[Frame]) -> bytes:
    """The log that python-can writes at the path, whose ending gives the format."""
    with can.Logger(path) as logger:
        for frame in frames:
            logger(can.Message(timestamp=frame.t, arbitration_id=frame.can_id, data=frame.data, channel=0))
    return path.read_bytes()


@pytest.mark.parametrize(("ending", "said"), [("blf", " of 60.0 s"), ("asc", ""), ("trc", "")])
def test_a_log_cut_off_in_the_middle_is_no_all_clear(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], ending: str, said: str
) -> None:
    """Its first 60 s hold no fault, and end whole; those of the cut file do not."""
    frames = list(open_log(LOG).frames())
    path = tmp_path / f"drive.{ending}"
    whole = in_another_format(path, [frame for frame in frames if frame.t - frames[0].t < 60])
    assert main(["diagnose", str(path), "--bundle", str(BUNDLE)]) == 0
    assert capsys.readouterr().out.endswith(
        "from 0.0 to 60.0 s: no fault: every test could tell at some time, and none alarms\n"
    )
    most = len(whole) * 9 // 10
    path.write_bytes(whole[: most if ending == "blf" else whole.rindex(b"\n", 0, most) + 20])  # within a line
    assert main(["diagnose", str(path), "--bundle", str(BUNDLE)]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert f"error: {path}: damaged, so no alarm is no all-clear: " in captured.err
    assert "frames read, from 0.0 to 5" in captured.err
    assert f"s{said}, the end is missing: " in captured.err
    assert captured.err.endswith("give a whole log, or accept with --partial what was read\n")
    assert "could tell at some time" not in captured.out
    assert main(["diagnose", str(path), "--bundle", str(BUNDLE), "--partial"]) == 0
    out = capsys.readouterr().out.splitlines()[-1]
    assert out.startswith("from 0.0 to 5")
    assert f"{said}, as far as the damaged log could be read: no fault" in out


def test_a_fault_in_a_damaged_log_is_a_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "drive.blf"
    whole = in_another_format(path, list(open_log(LOG).frames()))
    path.write_bytes(whole[:-2000])
    assert main(["diagnose", str(path), "--bundle", str(BUNDLE)]) == 1
    captured = capsys.readouterr()
    assert "as far as the damaged log could be read: a fault was found" in captured.out
    assert "the end is missing" in captured.err


@pytest.mark.parametrize(("options", "code"), [([], 2), (["--partial"], 0)])
def test_a_bad_line_within_a_quiet_log_is_no_all_clear(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], code: int
) -> None:
    lines = (LOG / "can.log").read_text().splitlines(keepends=True)
    path = tmp_path / "quiet.log"
    path.write_text("".join([*lines[:100], "(1767225600.1) can0 18FF10\n", *lines[100 : len(lines) // 2]]))
    assert main(["diagnose", str(path), "--bundle", str(BUNDLE), "--json", *options]) == code
    captured = capsys.readouterr()
    assert "1 lines could not be read (line 101: no frame after the time in" in captured.err
    assert decode(captured.out.splitlines()[-1].encode()).transition == "cannot_tell"  # nothing but events


def test_an_incomplete_last_line_alone_is_reported_and_no_damage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (LOG / "can.log").read_text().splitlines(keepends=True)
    path = tmp_path / "quiet.log"
    path.write_text("".join(lines[: len(lines) // 2]) + lines[0][:20])
    assert main(["diagnose", str(path), "--bundle", str(BUNDLE), "--json"]) == 0
    err = capsys.readouterr().err
    assert "the last line is cut off and was not used" in err
    assert "from 0.0 to 63.5 s: no fault" in err


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
    raw = manifest.read_bytes().replace(b"faultline.bundle/7", b"faultline.bundle/9")
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


def two_buses(path: Path) -> Path:
    """The golden log's first minute, without a fault, on can0, and its second, with one, at the same times on can1."""
    frames = list(open_log(LOG).relative())
    merged = sorted((frame.t % 60.0, f"can{int(frame.t // 60.0)}", frame) for frame in frames if frame.t < 119.9)
    lines = [f"({1e9 + t:.6f}) {channel} {frame.can_id:08X}#{frame.data.hex()}\n" for t, channel, frame in merged]
    path.write_text("".join(lines))
    return path


def test_a_log_of_two_buses_is_not_merged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = two_buses(tmp_path / "both.log")
    said = refused([str(both), "--bundle", str(BUNDLE)], capsys)
    assert "the same messages come on can0 and can1: say which bus with --channel" in said
    assert diagnose.main([str(both), "--bundle", str(BUNDLE), "--channel", "can0"]) == 0
    capsys.readouterr()
    said = refused([str(both), "--bundle", str(BUNDLE), "--channel", "can7"], capsys)
    assert "it has can0, can1" in said


def test_other_messages_on_another_bus_are_no_question(tmp_path: Path) -> None:
    quiet = tmp_path / "quiet.log"
    lines = (LOG / "can.log").read_text().splitlines(keepends=True)
    lines = lines[: len(lines) // 2]
    quiet.write_text("".join(line.replace(" can0 18FF", " can3 18FF") for line in lines))
    assert diagnose.main([str(quiet), "--bundle", str(BUNDLE)]) == 0


def test_a_recording_of_two_buses_names_its_own(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(LOG, tmp_path / "two"))
    two_buses(folder / "can.log")
    with pytest.raises(InputError, match=r"say which bus with `channel` under .can. in recording.toml"):
        open_log(folder).check_channels()
    described = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(described.replace("[can]\n", '[can]\nchannel = "can0"\n'))
    open_log(folder).check_channels()
    assert {*open_log(folder).report.channels} == {"can0", "can1"}


def forged(path: Path, begin_s: float, every: int, until_s: float) -> Path:
    """The golden log in which frames of the controller have a twin 1 ms later, of 100 kPa more."""
    lines, seen = [], 0
    for frame in open_log(LOG).relative():
        if frame.t >= until_s:
            break
        lines.append(f"({1e9 + frame.t:.6f}) can0 {frame.can_id:08X}#{frame.data.hex()}\n")
        if frame.can_id == 0x18FF103D and frame.t > begin_s:
            seen += 1
            if seen % every == 0:
                data = (int.from_bytes(frame.data[:2], "little") + 2000).to_bytes(2, "little") + frame.data[2:]
                lines.append(f"({1e9 + frame.t + 0.001:.6f}) can0 {frame.can_id:08X}#{data.hex()}\n")
    path.write_text("".join(lines))
    return path


@pytest.mark.parametrize("every", [2, 8])
def test_a_log_with_forged_frames_is_no_all_clear(
    tmp_path: Path, every: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", str(forged(tmp_path / "x.log", 45.0, every, 68.0)), "--bundle", str(BUNDLE)]) == 2
    assert re.search(r"frames came far too early for one sender \(\d+ of UDS_ECU\)", capsys.readouterr().err)


def test_a_fault_from_before_the_forged_frames_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert diagnose.main([str(forged(tmp_path / "x.log", 100.0, 8, 1e9)), "--bundle", str(BUNDLE)]) == 1
    assert "far too early for one sender" in capsys.readouterr().err
