"""Frames to signals: agreement with cantools, J1939's words for no value, all signals of a frame or none."""

from importlib import resources

import cantools.database
import pytest
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from service.core.decode import compile_dbc
from service.core.errors import InputError
from service.core.signals import Quality, j1939_quality

DBC = resources.files("dbc").joinpath("uds.dbc").read_text()
UNITS = {"y_p_tp": "Pa", "y_p_ap": "Pa", "y_p_du": "Pa", "n_p": "1/s", "dc_dose": "1"}
ECU, SENSORS = 0x18FF103D, 0x18FF20F9


@given(st.binary(min_size=8, max_size=8))
def test_agrees_with_cantools_on_every_payload(data: bytes) -> None:
    database = cantools.database.load_string(DBC, "dbc")
    assert isinstance(database, Database)
    decoded = database.decode_message(ECU, data)
    assert isinstance(decoded, dict)
    factor = {"y_p_du": 1e3, "n_p": 1.0, "dc_dose": 1e-2}
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    for name, value, _quality in table.decode(ECU, True, data):
        assert value == pytest.approx(float(str(decoded[name])) * factor[name])


BIG_ENDIAN = """VERSION ""
BS_:
BU_: A
BO_ 256 M: 8 A
 SG_ up : 3|12@0- (0.5,-3) [0|0] "Pa" A
 SG_ down : 20|9@1- (1,0) [0|0] "Pa" A
"""


@given(st.binary(min_size=8, max_size=8))
def test_signed_and_big_endian_signals_agree_with_cantools(data: bytes) -> None:
    database = cantools.database.load_string(BIG_ENDIAN, "dbc")
    assert isinstance(database, Database)
    decoded = database.decode_message(256, data)
    assert isinstance(decoded, dict)
    table = compile_dbc(BIG_ENDIAN, {"up": "Pa", "down": "Pa"}, "m.dbc")
    assert {name: value for name, value, _ in table.decode(256, False, data)} == pytest.approx(decoded)


@pytest.mark.parametrize(
    ("raw", "quality"),
    [(0xFFFF, Quality.NOT_AVAILABLE), (0xFE12, Quality.ERROR), (0xFB00, Quality.RESERVED), (0xFAFF, Quality.GOOD)],
)
def test_no_value_is_never_a_number(raw: int, quality: Quality) -> None:
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    data = raw.to_bytes(2, "little") + bytes(6)
    assert {n: q for n, _, q in table.decode(ECU, True, data)} == {
        "y_p_du": quality,
        "n_p": Quality.GOOD,
        "dc_dose": Quality.GOOD,
    }


def test_every_8_bit_raw_has_its_quality() -> None:
    expected = [Quality.GOOD] * 0xFB + [Quality.RESERVED] * 3 + [Quality.ERROR, Quality.NOT_AVAILABLE]
    assert [j1939_quality(raw, 8) for raw in range(256)] == expected


def test_a_short_frame_gives_none_of_its_signals_and_is_counted() -> None:
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    assert table.decode(ECU, True, bytes(5)) == []
    assert table.short_frames == 1


def test_priority_may_differ_but_source_address_may_not() -> None:
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    assert table.decode(ECU ^ (3 << 26), True, bytes(8))
    assert table.decode(ECU ^ 1, True, bytes(8)) == []
    assert table.decode(ECU, False, bytes(8)) == []


@pytest.mark.parametrize(
    ("text", "units", "message"),
    [
        ("hello", UNITS, "uds.dbc: not a valid DBC file"),
        (DBC, {"y_p_xx": "Pa"}, "uds.dbc: no message carries y_p_xx"),
        (DBC, {"n_p": "Pa"}, "uds.dbc: UDS_ECU.n_p: unit '1/s' cannot be converted to 'Pa'"),
        (BIG_ENDIAN.replace("down", "up2").replace("SG_ up2", "SG_ up m0"), {"up": "Pa"}, "uds.dbc"),
    ],
)
def test_a_dbc_that_does_not_fit_is_refused_with_the_place(text: str, units: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match="^" + message):
        compile_dbc(text, units, "uds.dbc")


def test_a_signal_in_two_messages_is_refused() -> None:
    text = BIG_ENDIAN + 'BO_ 257 N: 8 A\n SG_ up : 0|8@1+ (1,0) [0|0] "Pa" A\n'
    with pytest.raises(InputError, match="signal up is in several messages"):
        compile_dbc(text, {"up": "Pa"}, "m.dbc")
