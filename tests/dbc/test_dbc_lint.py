"""Every DBC of the project: loads strictly, and says unit, range, sender and cycle time of everything."""

from pathlib import Path

import cantools.database
import pytest
from cantools.database.can import Database

from faultline import dbc
from faultline.testbench import tanks

SHIPPED = sorted(Path(dbc.__file__).parent.glob("*.dbc"))
FILES = [*SHIPPED, Path(tanks.__file__).with_name("tanks.dbc")]


def _load(path: Path) -> Database:
    database = cantools.database.load_file(path, strict=True)
    assert isinstance(database, Database)
    return database


def test_there_is_a_dbc() -> None:
    assert [path.name for path in SHIPPED] == ["uds.dbc"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_messages_have_sender_cycle_time_and_comment(path: Path) -> None:
    for message in _load(path).messages:
        assert message.senders, message.name
        assert message.cycle_time, message.name
        assert message.comment, message.name
        assert message.protocol == "j1939", message.name


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_signals_have_unit_range_comment_and_the_range_that_j1939_allows(path: Path) -> None:
    for message in _load(path).messages:
        for signal in message.signals:
            assert signal.unit, signal.name
            assert signal.comment, signal.name
            assert signal.receivers, signal.name
            assert signal.minimum is not None, signal.name
            assert signal.maximum is not None, signal.name
            largest = {8: 0xFA, 16: 0xFAFF}[signal.length]
            assert signal.maximum <= largest * signal.scale + signal.offset + 1e-9, signal.name


def test_both_families_and_the_models_names_are_there() -> None:
    database = _load(SHIPPED[0])
    groups = {(message.frame_id >> 8) & 0x3FFFF for message in database.messages}
    assert {61475, 61476, 61691, 64828, 65110} <= groups
    assert sum(0xFF00 <= group <= 0xFFFF for group in groups) == 2
    names = {signal.name for message in database.messages for signal in message.signals}
    assert {"y_p_tp", "y_p_ap", "y_p_du", "n_p", "dc_dose"} <= names


def test_real_frames_of_public_logs_decode_to_what_their_trucks_measured() -> None:
    """Frames of real trucks, as published with open J1939 tools: 60 % and 26 degC in the tank; nothing dosed."""
    database = _load(SHIPPED[0])
    tank = database.decode_message("AT1T1I1", bytes.fromhex("9642FFFF1F1F00FF"))
    assert tank == {"def_tank_volume": 60.0, "def_tank_temperature": 26}
    dosing = database.decode_message("A1SCRDSI1", bytes.fromhex("0000F0FFFF00FFFF"))
    assert dosing == {"def_actual_dosing": 0.0, "def_doser_pressure": 0}
