"""recording.toml written for files of a newcomer: what they say is there, what they do not is marked and refused."""

import re
from pathlib import Path

import pytest

from faultline.analysis.model import load_model
from faultline.analysis.recordings.command import main as ingest
from faultline.analysis.recordings.name_match import match_names
from faultline.analysis.recordings.offered import Offer
from faultline.analysis.recordings.track import tracks_of
from faultline.service.core.errors import InputError
from faultline.service.logs import LogError, load_recording, open_log

ROOT = Path(__file__).parents[3]
LOG, DBC = ROOT / "tests" / "golden" / "log" / "can.log", (ROOT / "dbc" / "uds.dbc").read_text()
SAID = ["--vehicle", "v", "--source", "s", "--cycle", "c"]
TANK = "time_s,Y_1,y2 [mm],Y3_cm,u\n0,0.3,200,10,0.5\n2,0.31,201,10.5,0.5\n4,0.32,202,11,0.5\n"


def init(*words: str | Path) -> int:
    return ingest(["--init", *map(str, words)])


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A CAN log with its DBC, and another DBC of other messages beside it."""
    folder = tmp_path / "drive-3"
    folder.mkdir()
    (folder / "can.log").write_bytes(LOG.read_bytes())
    (folder / "ours.dbc").write_text(DBC)
    (folder / "a-other.dbc").write_text('VERSION ""\nBS_:\nBU_: A\nBO_ 5 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n')
    return folder


def values(folder: Path, **units: str) -> dict[str, list[float]]:
    log = open_log(folder)
    tracks = tracks_of(log.signals(log.table(units, "test")), units)
    return {name: track.value[:3].tolist() for name, track in tracks.items()}


def test_a_log_with_the_dbc_that_fits_best_is_a_recording(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert init(drive / "can.log", "--system", "uds", *SAID) == 0
    said = capsys.readouterr().out
    assert "ours.dbc: fits best of 2, with 7 of 7 identifiers" in said
    assert f"{drive}: 9775 frames read" in said
    recording = load_recording(drive)
    assert (recording.id, recording.vehicle, recording.sensor_set) == ("drive-3", "v", "instrumented")
    assert recording.can_log.signals == {}
    assert recording.start is not None
    assert values(drive, n_p="1/s", y_p_du="Pa") == values(LOG.parent, n_p="1/s", y_p_du="Pa")


def test_a_table_without_times_needs_the_period(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.csv").write_text("u,y,\n1.0,0.5,\n2.0,0.6,\n")
    with pytest.raises(InputError, match=r"a table of values without a column of times; .* or the seconds"):
        init(tmp_path / "x.csv", *SAID)
    for words in (["--period", "0"], ["--period", "4", "--time", "u"]):
        with pytest.raises(InputError, match=r"--period \d: a positive number of seconds, and no --time"):
            init(tmp_path / "x.csv", *SAID, *words)
    assert init(tmp_path / "x.csv", *SAID, "--period", "4") == 0
    assert "2 rows read, from 0.0 to 4.0 s" in capsys.readouterr().out


def test_what_nobody_said_is_marked_and_refused_at_once(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert init(drive / "can.log", "--vehicle", "truck 7") == 0
    assert "to be filled in before it can be used: source, cycle" in capsys.readouterr().out
    with pytest.raises(LogError, match=r"recording\.toml: still to be filled in: source, cycle$"):
        load_recording(drive)
    with pytest.raises(InputError, match="is there already; give --force"):
        init(drive / "can.log", *SAID)
    assert init(drive / "can.log", "--force", *SAID) == 0
    assert load_recording(drive).cycle == "c"


def test_names_of_another_dbc_are_mapped_and_those_that_are_only_alike_are_marked(drive: Path) -> None:
    other = DBC.replace("y_p_du", "Y_P_DU").replace(" n_p", " n_pump").replace("y_p_ap", "Yap")
    (drive / "ours.dbc").write_text(other.replace("y_p_tp", "x"))
    init(drive / "can.log", "--system", "uds", *SAID)
    file = drive / "recording.toml"
    with pytest.raises(LogError, match=r"still to be filled in: can\.signals\.y_p_ap, can\.signals\.n_p$"):
        load_recording(drive)
    text = file.read_text()
    assert 'n_p = "FILL IN: n_pump [1/s] or def_pump_speed [rpm]?"' in text
    assert "# Without the added sensors y_p_tp." in text
    text = re.sub(r'"FILL IN: Yap.*"', '"Yap"', text)
    file.write_text(text.replace("FILL IN: n_pump [1/s] or def_pump_speed [rpm]?", "UDS_ECU.n_pump"))
    recording = load_recording(drive)
    assert recording.can_log.signals == {"y_p_ap": "Yap", "y_p_du": "Y_P_DU", "n_p": "UDS_ECU.n_pump"}
    assert recording.sensor_set == "production"
    units = {"n_p": "1/s", "y_p_du": "Pa", "y_p_ap": "Pa"}
    assert values(drive, **units) == values(LOG.parent, **units)


def test_columns_have_the_units_of_their_titles_and_names(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(TANK)
    out = tmp_path / "rig" / "run-1"
    assert init(tmp_path / "log.csv", "--system", "three-tank", "--out", out, *SAID) == 0
    recording = load_recording(out)
    assert (recording.id, recording.file, recording.start) == ("run-1", "../../log.csv", None)
    found = values(out, y1="m", y2="m", y3="m", u="1")
    assert {name: each[0] for name, each in found.items()} == pytest.approx({"y1": 0.3, "y2": 0.2, "y3": 0.1, "u": 0.5})


def test_a_column_without_a_unit_whose_values_are_not_the_models_is_marked(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(TANK.replace("0.5", "50").replace("y2 [mm]", "y2 [V]"))
    init(tmp_path / "a.csv", "--system", "three-tank", *SAID)
    with pytest.raises(LogError, match=r"filled in: table\.signals\.u\.unit, table\.signals\.y2\.unit$"):
        load_recording(tmp_path)
    text = (tmp_path / "recording.toml").read_text()
    assert "the file says none, and values from 50 to 50 are not within [0, 1] 1" in text
    assert "m is wanted and V is what the file says" in text


def test_without_a_system_the_columns_are_listed_with_units(tmp_path: Path) -> None:
    (tmp_path / "week.csv").write_text("when;T_degC;v_km_h;p (rpm);T_min\n0;20;36;60;1\n1;20;36;60;1\n")
    assert init(tmp_path / "week.csv", "--time", "when", *SAID) == 0
    assert "# Columns: T_degC, v_km_h, p [rpm], T_min\n" in (tmp_path / "recording.toml").read_text()
    found = values(tmp_path, T_degC="K", v_km_h="m/s", p="1/s", T_min="K")
    assert {name: each[0] for name, each in found.items()} == pytest.approx(
        {"T_degC": 293.15, "v_km_h": 10.0, "p": 1.0, "T_min": 1.0}
    )


def test_a_table_beside_a_log_of_another_clock_needs_its_offset(drive: Path) -> None:
    (drive / "more.csv").write_text("t,T_degC\n0,20\n1,20\n")
    init(drive / "can.log", drive / "more.csv", *SAID)
    with pytest.raises(LogError, match=r"still to be filled in: table\.offset_s$"):
        load_recording(drive)
    file = drive / "recording.toml"
    file.write_text(re.sub(r'offset_s = ".*"', "offset_s = 3.0", file.read_text()))
    assert values(drive, T_degC="K", n_p="1/s")["T_degC"] == [293.15, 293.15]


@pytest.mark.parametrize("both", [False, True])
def test_channels_are_those_of_the_dbcs_messages(drive: Path, *, both: bool) -> None:
    lines = LOG.read_text().splitlines(keepends=True)
    other = [line.replace("can0", "can1") for line in lines]
    apart = [new if "18FF203D" in new or "18FF2" in new else old for old, new in zip(lines, other, strict=True)]
    mixed = [line for pair in zip(lines, other, strict=True) for line in pair]
    (drive / "can.log").write_text("".join(mixed if both else apart))
    init(drive / "can.log", "--system", "uds", *SAID)
    if both:
        with pytest.raises(LogError, match=r"still to be filled in: can\.channel$"):
            load_recording(drive)
        assert "all messages are on can0 and on can1" in (drive / "recording.toml").read_text()
    else:
        can = load_recording(drive).can_log
        assert (can.channel, can.buses, can.messages) == ("can0", {"can1": "can1"}, {"UDS_SENSORS": "can1"})
        assert values(drive, y_p_ap="Pa", n_p="1/s") == values(LOG.parent, y_p_ap="Pa", n_p="1/s")


def test_what_cannot_be_described_is_refused_in_a_line(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    for words, told in (
        ([drive], "is a folder; give the log in it"),
        ([drive / "can.log", "--dbc", drive / "a-other.dbc"], "none of its messages is in"),
        ([drive / "can.log", "--dbc", drive / "none.dbc"], "none.dbc: cannot be read"),
        ([drive / "can.log", tmp_path / "x.csv"], "x.csv: no table of values with a column of times"),
        ([tmp_path / "x.csv", drive / "can.log"], "x.csv: "),
    ):
        with pytest.raises(InputError) as error:
            init(*words)
        assert told in str(error.value)
        assert "\n" not in str(error.value)
    assert not (drive / "recording.toml").exists()


def test_a_name_that_two_messages_have_is_left_to_a_person() -> None:
    known = {"n_p": load_model("uds").known["n_p"]}
    twice = [Offer("n_p", "rpm", "A", is_alone=False), Offer("n_p", "rpm", "B", is_alone=False)]
    assert match_names(known, twice)["n_p"].remark == "A.n_p or B.n_p"
    assert match_names(known, [*twice[:1], Offer("n_p", "kPa", "B", is_alone=False)])["n_p"].offer == twice[0]
    assert match_names(known, [Offer("n_p", "kPa", "B")])["n_p"].remark == "n_p [kPa] cannot be converted to 1/s"
    assert "in a unit for 1/s there is none" in match_names(known, [Offer("speed", "kPa", "B")])["n_p"].remark


def test_logs_of_one_name_in_folders_of_their_own_are_recordings_of_several_names(tmp_path: Path) -> None:
    for name in ("monday", "tuesday", "data"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "house.csv").write_text("time;T_degC\n0;20\n1;20\n")
        assert init(tmp_path / name / "house.csv", *SAID) == 0
    ids = [load_recording(tmp_path / name).id for name in ("monday", "tuesday", "data")]
    assert ids == ["monday", "tuesday", "house"]
