"""DBC files as vendors ship them: character sets, units, and what is wrong with messages that nobody wants."""

from importlib import resources

import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.dbc_messages import describe_dbc
from faultline.service.core.signals.dbc_text import dbc_text, needed
from faultline.service.core.signals.values import Quality

UDS = resources.files("faultline.dbc").joinpath("uds.dbc").read_text()
UNITS = {"y_p_tp": "Pa", "y_p_ap": "Pa", "y_p_du": "Pa", "n_p": "1/s", "dc_dose": "1"}

VENDORS = """VERSION ""

NS_ :
\tNS_DESC_
\tCM_
\tBA_DEF_
\tVAL_
\tSIG_VALTYPE_

BS_:

BU_: Vector__XXX

BO_ 2364540158 EEC1: 8 Vector__XXX
 SG_ EngineSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Vector__XXX

BO_ 2566844926 CCVS1: 8 Vector__XXX
 SG_ WheelBasedVehicleSpeed : 8|16@1+ (0.00390625,0) [0|250.996] "km/h" Vector__XXX

BO_ 2566844158 ET1: 8 Vector__XXX
 SG_ EngineCoolantTemp : 0|8@1+ (1,-40) [-40|210] "°C" Vector__XXX
 SG_ Current : 16|16@1+ (1,0) [0|64255] "µA" Vector__XXX

CM_ BO_ 2364540158 "Electronic Engine Controller 1 … BO_ 7 no message: 8 \\"quoted\\";";
BA_DEF_ SG_  "SPN" INT 0 524287;
BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_  "ProtocolType" STRING ;
BA_DEF_DEF_  "SPN" 0;
BA_DEF_DEF_  "VFrameFormat" "J1939PG";
BA_DEF_DEF_  "ProtocolType" "";
BA_ "ProtocolType" "J1939";
BA_ "VFrameFormat" BO_ 2364540158 3;
BA_ "SPN" SG_ 2364540158 EngineSpeed 190;
"""
WANTED = {"EngineSpeed": "1/s", "WheelBasedVehicleSpeed": "m/s", "EngineCoolantTemp": "K", "Current": "A"}
EEC1, CCVS1, ET1 = 0x0CF00400, 0x18FEF100, 0x18FEEE00


def test_a_vendors_file_is_read_and_its_units_become_the_bundles() -> None:
    table = compile_dbc(VENDORS, WANTED, "vendors.dbc")
    frames = (
        (EEC1, bytes([0, 0, 0, 0x00, 0x19, 0, 0, 0]), {"EngineSpeed": 800 / 60}),
        (CCVS1, bytes([0, 0, 90, 0, 0, 0, 0, 0]), {"WheelBasedVehicleSpeed": 25.0}),
        (ET1, bytes([60, 0, 0x10, 0x27, 0, 0, 0, 0]), {"EngineCoolantTemp": 293.15, "Current": 0.01}),
    )
    for identifier, data, values in frames:
        found = table.decode(identifier, True, data)
        assert {name: value for name, value, _ in found} == pytest.approx(values)
        assert {quality for *_, quality in found} == {Quality.GOOD}
    assert [q for *_, q in table.decode(ET1, True, b"\xfa" + bytes(7))] == [Quality.GOOD, Quality.GOOD]
    assert [q for *_, q in table.decode(ET1, True, b"\xff" + bytes(7))] == [Quality.NOT_AVAILABLE, Quality.GOOD]


@pytest.mark.parametrize("name", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_units_are_the_same_in_every_character_set(name: str) -> None:
    text = dbc_text(VENDORS.encode(name))
    assert text == VENDORS
    assert compile_dbc(text, WANTED, "vendors.dbc").layouts == compile_dbc(VENDORS, WANTED, "vendors.dbc").layouts


@pytest.mark.parametrize("declared", ["cp1251", "1251", "windows-1251"])
def test_a_character_set_that_the_file_declares_is_taken(declared: str) -> None:
    said = f'BA_DEF_ "FileEncoding" STRING ;\nBA_ "FileEncoding" "{declared}";\nCM_ "насос";\n'
    assert dbc_text(said.encode("cp1251")) == said


@pytest.mark.parametrize("declared", ["klingon", "rot13", "utf-16", "ascii"])
def test_one_that_there_is_not_or_does_not_fit_is_not(declared: str) -> None:
    said = f'BA_ "Encoding" "{declared}";\nCM_ "°C";\n'
    assert dbc_text(said.encode("cp1252")) == said


@given(st.binary())
def test_every_file_is_text(raw: bytes) -> None:
    assert isinstance(dbc_text(raw), str)


SLOPPY = {
    "signals that overlap": 'BO_ 257 N: 8 A\n SG_ a : 0|16@1+ (1,0) [0|0] "" A\n SG_ b : 8|16@1+ (1,0) [0|0] "" A\n',
    "a message that is too short": 'BO_ 257 N: 1 A\n SG_ a : 0|16@1+ (1,0) [0|0] "" A\n',
    "a signal without bits": 'BO_ 257 N: 1 A\n SG_ a : 0|0@1+ (1,0) [0|0] "" A\n',
    "an identifier that is too large": 'BO_ 4097 N: 1 A\n SG_ a : 0|1@1+ (1,0) [0|0] "" A\n',
    "a message that is there twice": 2 * 'BO_ 257 N: 1 A\n SG_ a : 0|1@1+ (1,0) [0|0] "" A\n',
    "a floating-point number of 8 bits": 'BO_ 257 N: 1 A\n SG_ a : 0|8@1- (1,0) [0|0] "" A\nSIG_VALTYPE_ 257 a : 1;\n',
    "an attribute that is not defined": 'BO_ 257 N: 1 A\nBA_ "Foo" BO_ 257 3;\n',
    "an attribute that is no number": 'BO_ 257 N: 1 A\nBA_ "GenMsgCycleTime" BO_ 257 "often";\n',
    "a frame format that there is not": 'BO_ 257 N: 1 A\nBA_ "VFrameFormat" BO_ 257 77;\n',
    "values of a message that is not there": 'VAL_ 300 foo 0 "a" 1 "b" ;\n',
    "a value type of a signal that is not there": "BO_ 257 N: 1 A\nSIG_VALTYPE_ 257 foo : 1;\n",
    "a multiplexer that is one of itself": (
        'BO_ 257 N: 2 A\n SG_ a m0M : 0|8@1+ (1,0) [0|0] "" A\n SG_ b m0M : 8|8@1+ (1,0) [0|0] "" A\n'
        "SG_MUL_VAL_ 257 a b 0-0;\nSG_MUL_VAL_ 257 b a 0-0;\n"
    ),
}


@pytest.mark.parametrize("what", SLOPPY)
def test_what_is_wrong_with_a_message_that_nobody_wants_is_no_matter(
    what: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """cantools in its strict mode refuses all of these but the doubled message, whatever is wanted."""
    table = compile_dbc(UDS + SLOPPY[what], UNITS, "uds.dbc")
    assert table.layouts == compile_dbc(UDS, UNITS, "uds.dbc").layouts
    assert capfd.readouterr() == ("", "")


BAD = {
    "overlap": (
        'BO_ 257 N: 8 A\n SG_ a : 0|16@1+ (1,0) [0|0] "" A\n SG_ b : 8|16@1+ (1,0) [0|0] "" A\n',
        "m.dbc: N: The signals b and a are overlapping in message N. Mend its length, start bits and sizes in the DBC",
    ),
    "short": (
        'BO_ 257 N: 1 A\n SG_ a : 0|16@1+ (1,0) [0|0] "" A\n',
        "m.dbc: N: The signal a does not fit in message N.",
    ),
    "nothing": ('BO_ 257 N: 1 A\n SG_ a : 0|0@1+ (1,0) [0|0] "" A\n', "m.dbc: .*signal a length 0"),
    "identifier": ('BO_ 4097 N: 1 A\n SG_ a : 0|1@1+ (1,0) [0|0] "" A\n', "m.dbc: .* more than 11 bits in message N"),
    "float": (
        'BO_ 257 N: 1 A\n SG_ a : 0|8@1- (1,0) [0|0] "" A\nSIG_VALTYPE_ 257 a : 1;\n',
        "m.dbc: N.a: a floating-point number of 8 bits",
    ),
    "twice": (2 * 'BO_ 257 N: 1 A\n SG_ a : 0|1@1+ (1,0) [0|0] "" A\n', "m.dbc: N and N have one identifier; remove"),
    "scale": (
        'BO_ 257 N: 1 A\n SG_ a : 0|8@1+ (1e-320,0) [0|1e10] "" A\n',
        "m.dbc: N.a: its scale, offset or limits are no numbers",
    ),
    "circle": (
        'BO_ 257 N: 2 A\n SG_ a m0M : 0|8@1+ (1,0) [0|0] "" A\n SG_ b m0M : 8|8@1+ (1,0) [0|0] "" A\n'
        "SG_MUL_VAL_ 257 a b 0-0;\nSG_MUL_VAL_ 257 b a 0-0;\n",
        "m.dbc: N.a: is multiplexed by itself",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_what_is_wrong_with_one_that_is_wanted_is_said_with_message_signal_and_remedy(what: str) -> None:
    text, message = BAD[what]
    with pytest.raises(InputError, match=message):
        compile_dbc(f'VERSION ""\nBS_:\nBU_: A\n{text}', {"a": ""}, "m.dbc")


SENSELESS = {  # how a message of that kind is described, whatever is asked for
    "overlap": "makes no sense: N: The signals b and a are overlapping",
    "scale": "makes no sense: N.a: its scale",
    "circle": "makes no sense: N.a: is multiplexed by itself",
    "format": "makes no sense: ",
}


@pytest.mark.parametrize("what", SENSELESS)
def test_the_other_messages_are_described_all_the_same(what: str) -> None:
    """cantools takes none of a file with a frame format that there is not."""
    format_ = 'BO_ 257 N: 1 A\n SG_ a : 0|1@1+ (1,0) [0|0] "" A\nBA_ "VFrameFormat" BO_ 257 77;\n'
    found = {each.name: each for each in describe_dbc(UDS + (format_ if what == "format" else BAD[what][0]), "uds.dbc")}
    alone = {each.name: each for each in describe_dbc(UDS, "uds.dbc")}
    senseless = found.pop("N")
    assert found == alone
    assert all(each.layout is not None for each in found.values())
    assert senseless.layout is None
    assert (senseless.identifier, senseless.is_extended) == (257, False)
    assert senseless.why.startswith(SENSELESS[what])


def test_only_messages_that_are_asked_for_are_described() -> None:
    assert {signal for each in describe_dbc(UDS, "uds.dbc", list(UNITS)) for signal in each.signals} == {*UNITS}


def test_what_breaks_the_grammar_is_said_with_its_line() -> None:
    lines = UDS.splitlines()
    place = next(k for k, line in enumerate(lines) if line.startswith("BO_ ") and "A1DEFSI" in line)
    lines[place] = lines[place].replace(":", "")
    with pytest.raises(
        InputError, match=rf"^uds.dbc: not a valid DBC file: Invalid syntax at line {place + 1}, column"
    ):
        compile_dbc("\n".join(lines), UNITS, "uds.dbc")


@pytest.mark.parametrize("names", [["y_p_du"], ["y_p_tp", "dc_dose"], list(UNITS), ["def_tank_temperature"], ["none"]])
def test_what_some_signals_need_of_a_file_gives_the_same_table(names: list[str]) -> None:
    units = {name: UNITS.get(name, "degC") for name in names if name != "none"}
    text = needed(UDS, names)
    assert text.count("\n") == UDS.count("\n")
    assert compile_dbc(text, units, "uds.dbc").layouts == compile_dbc(UDS, units, "uds.dbc").layouts
    assert len(text) < len(UDS)
    for number, line in enumerate(text.splitlines()):
        assert line in ("", UDS.splitlines()[number])


def test_long_names_value_types_and_multiplexing_are_kept() -> None:
    text = """VERSION ""
BS_:
BU_: A
BO_ 256 M: 8 A
 SG_ sel M : 0|8@1+ (1,0) [0|0] "" A
 SG_ short m1 : 8|32@1- (1,0) [0|0] "Pa" A
BO_ 257 N: 8 A
 SG_ short : 8|16@1+ (1,0) [0|0] "Pa" A
BA_DEF_ SG_ "SystemSignalLongSymbol" STRING;
BA_DEF_DEF_ "SystemSignalLongSymbol" "";
BA_ "SystemSignalLongSymbol" SG_ 256 short "a_pressure_with_a_name_of_more_than_32";
SIG_VALTYPE_ 256 short : 1;
SG_MUL_VAL_ 256 short sel 1-2;
VAL_ 9 none 0 "x";
"""
    name = "a_pressure_with_a_name_of_more_than_32"
    table = compile_dbc(text, {name: "Pa"}, "m.dbc")
    data = b"\x02" + b"\x00\x00\xc0\x3f" + bytes(3)
    assert table.decode(256, False, data) == [(name, 1.5, Quality.GOOD)]
    assert table.decode(256, False, b"\x03" + data[1:]) == []


def test_a_unit_that_is_no_pressure_is_refused() -> None:
    with pytest.raises(InputError, match=r"EngineCoolantTemp: unit '°C' cannot be converted to 'Pa'"):
        compile_dbc(VENDORS, {"EngineCoolantTemp": "Pa"}, "vendors.dbc")


def test_signals_may_have_other_names_than_in_the_dbc() -> None:
    names = {"speed": "EngineSpeed", "v": "CCVS1.WheelBasedVehicleSpeed"}
    units = {"speed": "1/s", "v": "m/s", "EngineCoolantTemp": "K"}
    table = compile_dbc(VENDORS, units, "vendors.dbc", signals=names)
    frames = {EEC1: bytes([0, 0, 0, 0x00, 0x19, 0, 0, 0]), CCVS1: bytes([0, 0, 90, 0, 0, 0, 0, 0])}
    found = {
        name: value for identifier, data in frames.items() for name, value, _ in table.decode(identifier, True, data)
    }
    assert found == pytest.approx({"speed": 800 / 60, "v": 25.0})
    assert {s for each in describe_dbc(VENDORS, "v", [*units], signals=names) for s in each.signals} == {*units}


@pytest.mark.parametrize(
    ("signals", "told"),
    [
        ({"speed": "Speed"}, r"no message carries speed \(as Speed\);"),
        ({"speed": "ET1.EngineSpeed"}, r"no message carries speed \(as ET1.EngineSpeed\);"),
        ({"speed": "EngineSpeed", "v": "EngineSpeed"}, "speed and v are both the DBC's signal EngineSpeed; give each"),
    ],
)
def test_a_name_that_the_dbc_has_not_is_refused(signals: dict[str, str], told: str) -> None:
    with pytest.raises(InputError, match=told):
        compile_dbc(VENDORS, dict.fromkeys(signals, "1/s"), "vendors.dbc", signals=signals)


def test_a_signal_of_several_messages_is_chosen_by_its_message() -> None:
    text = 'VERSION ""\nBS_:\nBU_: A\n' + "".join(
        f'BO_ {k} M{k}: 8 A\n SG_ p : 0|8@1+ ({k},0) [0|0] "Pa" A\n\n' for k in (1, 2)
    )
    with pytest.raises(InputError, match=r'several messages \(M1, M2\).*say under \[can.signals\] which: p = "M1.p"'):
        compile_dbc(text, {"p": "Pa"}, "m.dbc")
    table = compile_dbc(text, {"p": "Pa"}, "m.dbc", signals={"p": "M2.p"})
    assert [value for *_, value, _ in table.decode(2, False, b"\x03" + bytes(7))] == [6.0]
    assert table.decode(1, False, b"\x03" + bytes(7)) == []
