"""`faultline log`: channels, messages, senders, gaps, damage, and which signals are there and why not."""

import json
from pathlib import Path
from typing import Any

import pytest

from faultline.service.survey import command

ROOT = Path(__file__).resolve().parents[3]
GOLDEN = ROOT / "tests" / "golden"

DBC = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 2566842941 There: 8 ECU
 SG_ temperature : 0|8@1+ (1,-40) [0|250] "\xb0C" ECU
 SG_ absent_value : 8|8@1+ (1,0) [0|250] "1" ECU
BO_ 2566842942 Absent: 8 ECU
 SG_ never : 0|8@1+ (1,0) [0|250] "1" ECU
BO_ 2566864957 OtherSender: 8 ECU
 SG_ other : 0|8@1+ (1,0) [0|250] "1" ECU
BO_ 2566900222 AnySender: 8 ECU
 SG_ anybody : 0|8@1+ (1,0) [0|250] "1" ECU
BO_ 2566916157 Short: 8 ECU
 SG_ brief : 0|8@1+ (1,0) [0|250] "1" ECU
BO_ 291 Elsewhere: 1 ECU
 SG_ remote_one : 0|8@1+ (1,0) [0|250] "1" ECU
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2566842941 3;
BA_ "VFrameFormat" BO_ 2566842942 3;
BA_ "VFrameFormat" BO_ 2566864957 3;
BA_ "VFrameFormat" BO_ 2566900222 3;
BA_ "VFrameFormat" BO_ 2566916157 3;
BA_ "VFrameFormat" BO_ 291 0;
"""
"""2566842941 is 0x18FEEA3D with the bit of 29-bit identifiers, and so on."""


def identifier(dbc: int) -> str:
    return f"{dbc & 0x1FFF_FFFF:08X}"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    lines = []
    for k in range(200):
        t = 1700000000 + k / 10 + (30.0 if k >= 100 else 0.0)
        lines.append(f"({t:.6f}) can0 {identifier(2566842941)}#{k % 200:02X}FF0000000000FF")
        lines.append(f"({t + 0.01:.6f}) can0 {identifier(2566864957)[:-2]}0B#0011223344556677")
        lines.append(f"({t + 0.02:.6f}) can0 {identifier(2566900222)[:-2]}03#0011223344556677")
        lines.append(f"({t + 0.03:.6f}) can0 {identifier(2566916157)}#0011")
        lines.append(f"({t + 0.04:.6f}) can1 123#00")
    lines.insert(50, "?")
    path = tmp_path / "drive.log"
    path.write_text("\n".join([*lines, ""]))
    (tmp_path / "x.dbc").write_bytes(DBC.encode("cp1252"))
    return path


def survey(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> dict[str, Any]:
    assert command.main([*map(str, words), "--json"]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_what_is_in_a_log(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = survey(capsys, log)
    assert (found["schema"], found["format"], found["frames"]) == ("faultline.log/1", "candump", 1000)
    assert [(each["name"], each["frames"]) for each in found["channels"]] == [("can0", 800), ("can1", 200)]
    assert found["is_damaged"]
    assert found["damage"]["places"] == [{"number": 51, "reason": "no candump line: '?'"}]
    row = next(each for each in found["messages"] if each["identifier"] == identifier(2566842941))
    assert (row["count"], row["pgn"], row["sender"], row["priority"]) == (200, 0xFEEA, 0x3D, 6)
    assert row["period_s"] == pytest.approx(0.1, abs=1e-6)
    assert row["rate_hz"] == pytest.approx(199 / 49.9, rel=1e-3)
    assert row["gaps"] == [{"at_s": 9.9, "for_s": 30.1}]
    assert [each["address"] for each in found["senders"]] == [0x03, 0x0B, 0x3D]


def test_which_signals_are_there_and_why_not(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The DBC is in Windows' characters, as Vector's tools write them."""
    found = survey(capsys, log, "--dbc", log.with_name("x.dbc"), "--channel", "can0")
    signals = {each["signal"]: (each["is_there"], each["why"]) for each in found["signals"]}
    assert signals == {
        "temperature": (True, ""),
        "absent_value": (False, "its values are never valid (not available)"),
        "never": (False, "its parameter group came from 0x3D, not from 0x3E"),
        "other": (False, "its parameter group came from 0x0B, not from 0x3D"),
        "anybody": (True, ""),
        "brief": (False, "all 200 frames are shorter than the 8 bytes of the DBC"),
        "remote_one": (False, "it is on channel can1"),
    }
    assert next(each for each in found["signals"] if each["signal"] == "anybody")["senders"] == [3]


def test_a_russian_file_with_a_message_that_makes_no_sense(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither its characters nor one message keeps the others from being listed."""
    senseless = (
        'BO_ 257 Narrow: 1 ECU\n SG_ narrow : 0|16@1+ (1,0) [0|0] "" ECU\n'
        'BO_ 258 Odd: 8 ECU\n SG_ odd : 0|8@1+ (1,0) [0|0] "" ECU\nBA_ "VFrameFormat" BO_ 258 77;\n'
        'CM_ BO_ 2566842941 "\u0434\u0430\u0432\u043b\u0435\u043d\u0438\u0435";\n'
    )
    path = log.with_name("russian.dbc")
    path.write_bytes((DBC.replace("\xb0C", "bar") + senseless).encode("cp1251"))
    found = survey(capsys, log, "--dbc", path, "--channel", "can0")
    signals = {each["signal"]: (each["is_there"], each["why"]) for each in found["signals"]}
    assert len(signals) == 9
    assert signals["temperature"] == (True, "")
    assert signals["never"] == (False, "its parameter group came from 0x3D, not from 0x3E")
    assert signals["narrow"][1].startswith("makes no sense: Narrow: The signal narrow does not fit in message Narrow.")
    assert signals["odd"][1].startswith("makes no sense: ")
    assert not signals["narrow"][0]
    assert not signals["odd"][0]


def test_a_file_that_does_not_say_what_is_j1939s(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = log.with_name("silent.dbc")
    path.write_text(DBC[: DBC.index("BA_DEF_ ")])
    found = survey(capsys, log, "--dbc", path)
    why = {each["signal"]: each["why"] for each in found["signals"]}
    assert why["temperature"].startswith("the DBC does not say whether There is J1939's: give it the attribute VFrame")
    assert why["remote_one"] == ""


LONG = DBC.replace("There: 8", "There: 20").replace("AnySender: 8", "AnySender: 10")


def in_parts(pgn: int, source: int, data: bytes, *, lost: int | None = None) -> list[str]:
    pieces = [data[k : k + 7].ljust(7, b"\xff") for k in range(0, len(data), 7)]
    head = bytes([0x20, len(data), 0, len(pieces), 0xFF]) + pgn.to_bytes(3, "little")
    parts = [
        f"1CEBFF{source:02X}#{number:02X}{piece.hex()}" for number, piece in enumerate(pieces, 1) if number != lost
    ]
    return [f"1CECFF{source:02X}#{head.hex()}", *parts]


def of_frames(folder: Path, channels: dict[str, list[str]]) -> Path:
    path = folder / "parts.log"
    rows = [
        (k / 20 + 1e-3 * n, name, frame) for n, (name, of) in enumerate(channels.items()) for k, frame in enumerate(of)
    ]
    path.write_text("".join(f"({1700000000 + t:.6f}) {name} {frame}\n" for t, name, frame in sorted(rows)))
    path.with_name("long.dbc").write_bytes(LONG.encode("cp1252"))
    return path


def test_signals_of_messages_in_parts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The parts of one sender on two buses are of two messages."""
    data = bytes([60, 0xFF, *range(18)])
    frames = in_parts(0xFEEA, 0x3D, data) + in_parts(0xFFCA, 0x07, data[:10])
    path = of_frames(tmp_path, {"can0": frames, "can1": in_parts(0xFEEA, 0x3D, bytes([61]) * 20)})
    found = survey(capsys, path, "--dbc", tmp_path / "long.dbc")
    signals = {each["signal"]: each for each in found["signals"]}
    assert signals["temperature"]["is_there"]
    assert signals["temperature"]["channels"] == ["can0", "can1"]
    assert signals["absent_value"]["is_there"]  # on the second bus
    alone = survey(capsys, path, "--dbc", tmp_path / "long.dbc", "--channel", "can0")
    why = {each["signal"]: each["why"] for each in alone["signals"]}
    assert why["temperature"] == ""
    assert why["absent_value"] == "its values are never valid (not available)"


@pytest.mark.parametrize(
    ("frames", "why"),
    [
        (in_parts(0xFEEA, 0x3D, bytes(20), lost=2) * 2, "its parts were never all there: 2 lost"),
        (in_parts(0xFEEA, 0x3D, bytes(20))[:-1], "its parts were never all there: 1 cut off by the end"),
        (in_parts(0xFEEA, 0x3C, bytes(20)), "its parameter group came from 0x3C, not from 0x3D"),
        (in_parts(0xFEEA, 0x3D, bytes(15)), "all 1 frames are shorter than the 20 bytes of the DBC"),
        (in_parts(0xFEEB, 0x3D, bytes(20)), "no such message"),
    ],
)
def test_why_a_message_in_parts_is_not_there(
    frames: list[str], why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = of_frames(tmp_path, {"can0": [*frames, "123#00"]})
    found = survey(capsys, path, "--dbc", tmp_path / "long.dbc")
    [row] = [each for each in found["signals"] if each["signal"] == "temperature"]
    assert (row["is_there"], row["why"]) == (False, why)


def test_a_bundle_asks_for_its_own(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = survey(capsys, GOLDEN / "log", "--bundle", GOLDEN / "bundle")
    assert all(each["is_there"] for each in found["signals"])
    assert len(found["signals"]) == 5
    found = survey(capsys, log, "--bundle", GOLDEN / "bundle", code=1)
    assert {each["why"] for each in found["signals"]} == {"no such message"}


def test_for_people(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([str(log), "--dbc", str(log.with_name("x.dbc"))]) == 0
    text = capsys.readouterr().out
    assert "channels: can0 (800), can1 (200)" in text
    assert "damage: 1 lines could not be read (line 51: no candump line: '?')" in text
    assert "can0     18FEEA3D    9.9     30.1   0.100" in text
    assert "signals: 3 of 7 are there:" in text


def test_without_times_and_without_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.txt"
    path.write_text("  can0  123   [2]  remote request\n" * 9)
    found = survey(capsys, path)
    assert (found["frames"], found["remote"], found["has_times"], found["messages"]) == (0, 9, False, [])
    assert found["channels"] == [{"name": "can0", "frames": 0, "without_data": 9}]
