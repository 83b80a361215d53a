"""Frames to signals: agreement with cantools, J1939's words for no value, all signals of a frame or none."""

import struct
from importlib import resources

import cantools.database
import pytest
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.decode import DecodeTable, Wanted
from faultline.service.core.signals.senders import SENDERS
from faultline.service.core.signals.values import Quality, j1939_quality

DBC = resources.files("faultline.dbc").joinpath("uds.dbc").read_text()
UNITS = {"y_p_tp": "Pa", "y_p_ap": "Pa", "y_p_du": "Pa", "n_p": "1/s", "dc_dose": "1"}
EFF = 0x8000_0000
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


@pytest.mark.parametrize(
    ("length", "words"),
    [
        (1, {}),
        (2, {3: Quality.NOT_AVAILABLE, 2: Quality.ERROR}),
        (3, {7: Quality.NOT_AVAILABLE, 6: Quality.ERROR}),
        (7, {127: Quality.NOT_AVAILABLE, 126: Quality.ERROR}),
    ],
)
def test_every_raw_of_less_than_a_byte_has_its_quality(length: int, words: dict[int, Quality]) -> None:
    found = {raw: j1939_quality(raw, length) for raw in range(1 << length)}
    assert {raw: quality for raw, quality in found.items() if quality is not Quality.GOOD} == words


def test_a_short_frame_gives_none_of_its_signals_and_is_counted() -> None:
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    assert table.decode(ECU, True, bytes(5)) == []
    assert table.rejected.short == {"UDS_ECU": 1}


def test_priority_may_differ_but_source_address_may_not() -> None:
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    assert table.decode(ECU ^ (3 << 26), True, bytes(8))
    assert table.decode(ECU ^ 1, True, bytes(8)) == []
    assert table.decode(ECU, False, bytes(8)) == []
    assert (table.rejected.other_source, table.rejected.total) == ({"UDS_ECU": 1}, 1)


def test_a_bus_lets_every_sender_of_a_group_through_so_that_a_second_one_is_seen() -> None:
    table = compile_dbc(DBC, {"n_p": "1/s"}, "uds.dbc")
    claims = Wanted(0x00EEFF3D, 0x03FFFFFF, True)  # of the sender's address, by whomever
    assert table.wanted == (claims, Wanted(0x00FF1000, 0x03FFFF00, True))
    assert compile_dbc(BIG_ENDIAN, {"up": "Pa"}, "m.dbc").wanted == (Wanted(256, 0x7FF, False),)


WIDTHS = "".join(
    f'BO_ {(0x18FF0000 + 256 * n + 1) | 0x80000000} M{n}: 8 A\n SG_ s{n} : 3|{n}@1+ (0.1,-7) [{low}|{high}] "Pa" A\n'
    for n, (low, high) in enumerate([(0, 0)] * 17 + [(-5, 3)] * 3, 1)
)
J1939 = f"""VERSION ""
BS_:
BU_: A
{WIDTHS}
BA_DEF_ "ProtocolType" STRING ;
BA_DEF_DEF_ "ProtocolType" "";
BA_ "ProtocolType" "J1939";
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
"""


@given(st.integers(1, 20), st.integers(0, 2**64 - 1))
def test_numbers_are_read_without_a_call_as_they_are_with_one(width: int, content: int) -> None:
    table = compile_dbc(J1939, {f"s{width}": "Pa"}, "w.dbc")
    [layout] = table.layouts
    assert layout.j1939
    [(*_, field)] = layout.plain
    assert table.decode(layout.identifier, True, content.to_bytes(8, "little")) == [field.read(content, 0, True)]


@pytest.mark.parametrize("length", range(65))
def test_a_frame_of_any_length_gives_all_signals_or_none(length: int) -> None:
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    found = table.decode(ECU, True, bytes(length))
    assert len(found) == (3 if length >= 8 else 0)
    assert table.rejected.short == ({} if length >= 8 else {"UDS_ECU": 1})


def test_what_the_dbc_does_not_allow_is_out_of_range() -> None:
    narrow = DBC.replace("[0|160.6375]", "[0|100]")
    assert narrow != DBC
    table = compile_dbc(narrow, UNITS, "uds.dbc")
    for raw, quality in ((40000, Quality.GOOD), (40001, Quality.OUT_OF_RANGE), (0xFFFF, Quality.NOT_AVAILABLE)):
        data = bytes(4) + raw.to_bytes(2, "little") + bytes(2)
        assert {n: q for n, _, q in table.decode(ECU, True, data)}["dc_dose"] is quality


MULTIPLEXED = """VERSION ""
BS_:
BU_: A
BO_ 256 M: 8 A
 SG_ which M : 0|4@1+ (1,0) [0|0] "" A
 SG_ always : 8|8@1+ (1,0) [0|0] "Pa" A
 SG_ first m0 : 16|16@1+ (1,0) [0|0] "Pa" A
 SG_ second m3M : 16|8@1+ (1,0) [0|0] "" A
 SG_ deep m7 : 24|8@1+ (1,0) [0|0] "Pa" A
 SG_ real m5 : 32|32@1- (1,0) [0|0] "Pa" A

SIG_VALTYPE_ 256 real : 1;
SG_MUL_VAL_ 256 first which 0-1;
SG_MUL_VAL_ 256 second which 3-3;
SG_MUL_VAL_ 256 deep second 7-7;
SG_MUL_VAL_ 256 real which 5-5;
"""


@pytest.mark.parametrize("selector", range(16))
def test_multiplexed_signals_are_read_only_where_they_are(selector: int) -> None:
    """Against cantools, which refuses what the DBC does not know: that is counted, and the other signals kept."""
    database = cantools.database.load_string(MULTIPLEXED, "dbc")
    assert isinstance(database, Database)
    names = ("always", "first", "deep", "real")
    table = compile_dbc(MULTIPLEXED, dict.fromkeys(names, "Pa"), "m.dbc")
    data = bytes([selector, 9, 7, 5]) + struct.pack("<f", 2.5)
    found = {name: value for name, value, _ in table.decode(256, False, data)}
    known = selector in (0, 1, 3, 5)
    assert table.rejected.unknown_selector == ({} if known else {"M": 1})
    expected = database.decode_message(256, data) if known else {"always": 9}
    assert isinstance(expected, dict)
    assert found == {name: value for name, value in expected.items() if name in names}


ONE = """VERSION ""
BS_:
BU_: A
BO_ {number} M: 8 A
 SG_ one : 3|{width}@1+ (2,-7) [0|0] "Pa" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
"""


@pytest.mark.parametrize("width", range(1, 17))
def test_a_number_and_its_neighbours_at_every_border_are_what_they_are(width: int) -> None:
    """Beside other bits that are all set, or none."""
    table = compile_dbc(ONE.format(number=EFF | 0x18FF0001, width=width), {"one": "Pa"}, "m.dbc")
    top = 1 << width
    borders = {0, 1, top - 1, top - 2, top - 3, *(top * word // 256 + k for word in range(0xF9, 0xFF) for k in (-1, 0))}
    for raw in sorted(raw for raw in borders if 0 <= raw < top):
        for others in (0, (1 << 64) - 1):
            content = others & ~((top - 1) << 3) | raw << 3
            [(_, value, quality)] = table.decode(0x18FF0001, True, content.to_bytes(8, "little"))
            assert quality is j1939_quality(raw, width)
            assert value == 2.0 * raw - 7.0


BIG_ENDIAN_MULTIPLEXED = """VERSION ""
BS_:
BU_: A
BO_ 256 M: 8 A
 SG_ which M : 7|4@0+ (1,0) [0|0] "" A
 SG_ always : 15|8@0+ (1,0) [0|0] "Pa" A
 SG_ second m3M : 23|8@0+ (1,0) [0|0] "" A
 SG_ deep m7 : 31|8@0+ (1,0) [0|0] "Pa" A

SG_MUL_VAL_ 256 second which 3-3;
SG_MUL_VAL_ 256 deep second 7-7;
"""


@pytest.mark.parametrize(("which", "second"), [(3, 7), (3, 8), (2, 7)])
def test_selectors_of_the_other_byte_order_are_read_as_well(which: int, second: int) -> None:
    database = cantools.database.load_string(BIG_ENDIAN_MULTIPLEXED, "dbc")
    assert isinstance(database, Database)
    table = compile_dbc(BIG_ENDIAN_MULTIPLEXED, {"always": "Pa", "deep": "Pa"}, "m.dbc")
    data = bytes([which << 4 | 0xF, 9, second, 5, 0, 0, 0, 0])
    expected = {"always": 9.0, "deep": 5.0} if (which, second) == (3, 7) else {"always": 9.0}
    for count in (1, 2):
        assert {name: value for name, value, _ in table.decode(256, False, data)} == expected
        assert table.rejected.unknown_selector == ({} if len(expected) == 2 else {"M": count})
    if len(expected) == 2:
        decoded = database.decode_message(256, data)
        assert isinstance(decoded, dict)
        assert decoded["deep"] == 5


SIGNED = """VERSION ""
BS_:
BU_: A
BO_ {number} M: 8 A
 SG_ below : 0|16@1- (1,0) [0|0] "Pa" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "{frame}";
"""


@pytest.mark.parametrize(("frame", "quality"), [("J1939PG", Quality.NOT_AVAILABLE), ("ExtendedCAN", Quality.GOOD)])
def test_what_is_no_plain_number_has_j1939s_words_too(frame: str, quality: Quality) -> None:
    table = compile_dbc(SIGNED.format(number=EFF | 0x18FF0001, frame=frame), {"below": "Pa"}, "m.dbc")
    [(_, _, found)] = table.decode(0x18FF0001, True, b"\xff" * 8)
    assert found is quality


def test_an_inner_multiplexer_counts_only_where_it_is() -> None:
    table = compile_dbc(MULTIPLEXED, {"always": "Pa", "deep": "Pa"}, "m.dbc")
    for selector, unknown in ((0, {}), (3, {"M": 1})):
        assert [name for name, _, _ in table.decode(256, False, bytes([selector, 9, 8, 5, 0, 0, 0, 0]))] == ["always"]
        assert table.rejected.unknown_selector == unknown


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf"), 1.5])
def test_a_floating_point_number_that_is_none_is_an_error(number: float) -> None:
    table = compile_dbc(MULTIPLEXED, {"real": "Pa"}, "m.dbc")
    [(_, _, quality)] = table.decode(256, False, b"\x05\0\0\0" + struct.pack("<f", number))
    assert quality is (Quality.GOOD if number == 1.5 else Quality.ERROR)


@pytest.mark.parametrize(
    ("text", "units", "message"),
    [
        ("hello", UNITS, "uds.dbc: not a valid DBC file"),
        (DBC, {"y_p_xx": "Pa"}, "uds.dbc: no message carries y_p_xx"),
        (DBC, {"n_p": "Pa"}, "uds.dbc: UDS_ECU.n_p: unit '1/s' cannot be converted to 'Pa'"),
    ],
)
def test_a_dbc_that_does_not_fit_is_refused_with_the_place(text: str, units: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match="^" + message):
        compile_dbc(text, units, "uds.dbc")


NOT_J1939 = """VERSION ""
BS_:
BU_: A
BO_ {first} ONE: 8 A
 SG_ one : 0|16@1+ (1,0) [0|0] "Pa" A
BO_ {second} TWO: 8 A
 SG_ two : 0|16@1+ (1,0) [0|0] "Pa" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "ExtendedCAN";
"""


def test_29_bits_of_which_nobody_says_what_they_are_are_refused() -> None:
    """J1939's *not available* would be the largest number that there is."""
    silent = "".join(line for line in DBC.splitlines(keepends=True) if "VFrameFormat" not in line)
    with pytest.raises(InputError, match="does not say whether UDS_ECU is J1939's: give it the attribute VFrameFormat"):
        compile_dbc(silent, {"n_p": "1/s"}, "uds.dbc")


def test_what_comes_in_parts_or_of_others_changes_nothing() -> None:
    """TP.CM and TP.DT of the very sender, whole, with a lie about their size, out of order, broken off."""
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    session = (
        "20 0e 00 02 ff 10 ff 00",
        "01 ff ff ff ff ff ff ff",
        "02 00 00 00 00 00 00 00",
        "ff 00 ff ff ff 10 ff 00",
    )
    lie = ("20 ff ff ff ff 10 ff 00", "09 00 00 00 00 00 00 00", "01 00 00 00 00 00 00 00")
    for frame in (*session, *lie):
        for group in (0x1CECFF00, 0x1CEBFF00):
            assert table.decode(group | 0x3D, True, bytes.fromhex(frame)) == []
    assert sum(table.taken.values()) + table.rejected.total == 0


def test_a_number_that_its_scale_makes_too_large_is_none() -> None:
    text = (
        'VERSION ""\nBS_:\nBU_: A\nBO_ 256 M: 8 A\n SG_ big : 0|64@1- (1000,0) [0|0] "Pa" A\n'
        "SIG_VALTYPE_ 256 big : 2;\n"
    )
    table = compile_dbc(text, {"big": "Pa"}, "m.dbc")
    assert [q for _, _, q in table.decode(256, False, struct.pack("<d", 1e306))] == [Quality.OUT_OF_RANGE]
    assert [q for _, _, q in table.decode(256, False, struct.pack("<d", 1e300))] == [Quality.GOOD]


def test_a_message_that_no_protocol_carries_is_refused() -> None:
    """Nobody would put it together, and its signals would be missing without a word."""
    long = DBC.replace("BO_ 2566852669 UDS_ECU: 8", "BO_ 2566852669 UDS_ECU: 1786")
    assert long != DBC
    with pytest.raises(InputError, match="UDS_ECU has 1786 bytes, J1939's transport protocol carries 1785: take"):
        compile_dbc(long, UNITS, "uds.dbc")


def test_29_bits_that_are_not_j1939_are_all_looked_at() -> None:
    """The first three are a priority in J1939 alone: there two messages had become one."""
    text = NOT_J1939.format(first=EFF | 0x1000_0100, second=EFF | 0x1400_0100)
    table = compile_dbc(text, {"one": "Pa", "two": "Pa"}, "m.dbc")
    assert [name for name, _, _ in table.decode(0x1000_0100, True, bytes(8))] == ["one"]
    assert [name for name, _, _ in table.decode(0x1400_0100, True, bytes(8))] == ["two"]
    assert table.decode(0x1800_0100, True, bytes(8)) == []
    assert {(each.identifier, each.mask) for each in table.wanted} == {
        (0x1000_0100, 0x1FFF_FFFF),
        (0x1400_0100, 0x1FFF_FFFF),
    }


def test_a_signal_in_two_messages_is_refused() -> None:
    text = BIG_ENDIAN + 'BO_ 257 N: 8 A\n SG_ up : 0|8@1+ (1,0) [0|0] "Pa" A\n'
    with pytest.raises(InputError, match="signal up is in several messages"):
        compile_dbc(text, {"up": "Pa"}, "m.dbc")


def test_a_dbc_with_another_source_address_is_told_which_senders_there_are() -> None:
    table = compile_dbc(DBC.replace(str(0x98FF103D), str(0x98FF1040)), {"y_p_du": "Pa"}, "others.dbc")
    assert table.strangers() == []
    for address in (0x3D, 0x3D, 0x21):
        assert table.decode(0x18FF1000 | address, True, bytes(8)) == []
    assert table.strangers() == [
        "UDS_ECU never came from 0x40, its parameter group came from 0x21, 0x3D: give the DBC that source address, "
        "or choose with --sender UDS_ECU=0x21"
    ]
    assert table.decode(0x18FF1040, True, bytes(8))
    assert table.strangers() == []


def test_an_identifier_carries_wanted_signals_whatever_the_priority_in_j1939_alone() -> None:
    table = compile_dbc(DBC, UNITS, "uds.dbc")
    assert table.carries(ECU, True)
    assert table.carries(ECU ^ (3 << 26), True)
    assert not table.carries(ECU ^ 1, True)
    assert not table.carries(ECU & 0x7FF, False)
    other = compile_dbc(NOT_J1939.format(first=EFF | 0x1000_0100, second=EFF | 0x1400_0100), {"one": "Pa"}, "m.dbc")
    assert other.carries(0x1000_0100, True)
    assert not other.carries(0x1800_0100, True)
    standard = compile_dbc(BIG_ENDIAN, {"up": "Pa"}, "m.dbc")
    assert standard.carries(256, False)
    assert not standard.carries(257, False)
    assert not standard.carries(256, True)


DOUBTED = [("y_p_du", Quality.DOUBTED), ("n_p", Quality.DOUBTED)]


def second_sender(speed: float | None = None) -> tuple[DecodeTable, list[list[tuple[str, float, Quality]]]]:
    """Ten seconds of one sender, then frames of another one 60 ms after each of its own; the latter's signals."""
    table, found = compile_dbc(DBC, {"n_p": "1/s", "y_p_du": "Pa"}, "uds.dbc"), []
    if speed is not None:
        table.run_at(speed)
    for k in range(150):
        table.decode(ECU, True, k.to_bytes(8, "little"), 0.2 * k)
        if k >= 50:
            found.append(table.decode(ECU, True, (1000 + k).to_bytes(8, "little"), 0.2 * k + 0.06))
    return table, found


@pytest.mark.parametrize("speed", [None, 1.0, 0.2])
def test_a_second_senders_frames_make_all_signals_of_the_message_doubted(speed: float | None) -> None:
    """What is slower than real time is judged as real time is: 40 ms of jitter stay 40 ms."""
    table, found = second_sender(speed)
    assert all([(name, worth) for name, _, worth in each] == DOUBTED for each in found)
    assert (table.taken, table.rejected.early) == ({"UDS_ECU": 150}, {"UDS_ECU": 100})


def test_at_five_times_real_time_jitter_is_five_times_as_long_and_that_sender_is_not_seen_by_its_arrival() -> None:
    table, found = second_sender(5.0)
    assert not table.rejected.early
    assert all(each and {worth for *_, worth in each} == {Quality.GOOD} for each in found[:1])


def test_a_frame_said_again_by_a_gateway_is_counted_and_taken_once() -> None:
    table = compile_dbc(DBC, {"n_p": "1/s"}, "uds.dbc")
    for k in range(3):
        data = k.to_bytes(8, "little")
        assert table.decode(ECU, True, data, 0.2 * k)
        assert table.decode(ECU, True, data, 0.2 * k + 0.001) == []
    assert (table.taken, table.repeated, table.rejected.total) == ({"UDS_ECU": 3}, {"UDS_ECU": 3}, 0)


def test_no_more_than_eight_other_senders_are_remembered() -> None:
    table = compile_dbc(DBC, {"n_p": "1/s"}, "uds.dbc")
    for address in range(20):
        table.decode(0x18FF1000 | address, True, bytes(8))
    assert table.rejected.senders == {"UDS_ECU": set(range(SENDERS))}
