"""Who sends a message: any sender, a chosen one, several of them, with a destination or in parts."""

from collections.abc import Mapping
from importlib import resources

import numpy as np
import pytest

from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Input
from faultline.service.core.records.health import Condition
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.decode import BOUND, DecodeTable, Wanted
from faultline.service.core.signals.sampling import Sampler
from faultline.service.core.signals.traffic import Traffic
from faultline.service.core.signals.values import Quality

UDS = resources.files("faultline.dbc").joinpath("uds.dbc").read_text()
ANY = UDS.replace(str(0x98FF103D), str(0x98FF10FE))
GROUP = 0x18FF1000


def any_sender(senders: Mapping[str, int] | None = None) -> DecodeTable:
    return compile_dbc(ANY, {"y_p_du": "Pa", "n_p": "1/s"}, "vendors.dbc", senders or {})


def names(found: list[tuple[str, float, Quality]]) -> dict[str, str]:
    return {name: quality.name for name, _, quality in found}


BOTH_GOOD = {"y_p_du": "GOOD", "n_p": "GOOD"}
BOTH_DOUBTED = {"y_p_du": "DOUBTED", "n_p": "DOUBTED"}


@pytest.mark.parametrize("address", [0x00, 0x3D, 0xFD, 0xFE])
def test_where_the_dbc_names_no_sender_the_only_one_is_taken(address: int) -> None:
    table = any_sender()
    for k in range(3):
        data = k.to_bytes(8, "little")
        assert names(table.decode(GROUP | address | k % 2 << 26, True, data, 0.2 * k)) == BOTH_GOOD
    assert table.senders == {"UDS_ECU": {address: 3}}
    assert (table.taken, table.rejected.total, table.strangers()) == ({"UDS_ECU": 3}, 0, [])


def test_once_there_is_a_second_one_neither_is_believed() -> None:
    """Whether it is another device or somebody who pretends to be one: nobody has said which is meant."""
    table = any_sender()
    assert names(table.decode(GROUP | 0x3D, True, bytes(8), 0.0)) == BOTH_GOOD
    assert names(table.decode(GROUP | 0x21, True, bytes(8), 0.1)) == BOTH_DOUBTED
    assert names(table.decode(GROUP | 0x3D, True, bytes(8), 0.2)) == BOTH_DOUBTED
    assert table.rejected.unclear == {"UDS_ECU": 2}
    assert table.strangers() == [
        "UDS_ECU comes from 0x21 (1 frames), 0x3D (2 frames), and the DBC does not say which one is meant: choose one, "
        "as with --sender UDS_ECU=0x21"
    ]


def test_one_that_is_chosen_is_the_only_one_that_is_taken() -> None:
    for dbc in (ANY, UDS):
        table = compile_dbc(dbc, {"y_p_du": "Pa"}, "vendors.dbc", {"UDS_ECU": 0x21})
        assert names(table.decode(GROUP | 0x21, True, bytes(8))) == {"y_p_du": "GOOD"}
        assert table.decode(GROUP | 0x3D, True, bytes(8)) == []
        assert (table.rejected.other_source, table.rejected.senders) == ({"UDS_ECU": 1}, {"UDS_ECU": {0x3D}})
        assert Wanted(0x00EEFF21, 0x03FFFFFF, True) in table.wanted


def test_frames_of_somebody_else_under_the_only_senders_address_are_known_by_when_they_come() -> None:
    table = any_sender()
    for k in range(100):
        table.decode(GROUP | 0x3D, True, k.to_bytes(8, "little"), 0.2 * k)
    assert names(table.decode(GROUP | 0x3D, True, b"forged !", 19.86)) == BOTH_DOUBTED
    assert table.rejected.early == {"UDS_ECU": 1}


def test_a_bus_lets_all_senders_and_all_claims_through() -> None:
    assert any_sender().wanted == (Wanted(0x00EEFF00, 0x03FFFF00, True), Wanted(0x00FF1000, 0x03FFFF00, True))
    assert any_sender().carries(GROUP | 0x77, True)
    assert not any_sender().carries(GROUP | 0x100, True)


def test_the_only_senders_address_that_another_device_claims_is_noticed() -> None:
    table = any_sender()
    claim = 0x18EEFF3D
    table.decode(claim, True, b"the ECU.")
    table.decode(GROUP | 0x3D, True, bytes(8))
    assert not table.rejected.claimed
    table.decode(claim, True, b"another.")
    table.decode(claim + 1, True, b"a third.")
    assert table.rejected.claimed == {"UDS_ECU": 1}


def test_the_samples_before_a_second_sender_are_doubted_too() -> None:
    inputs = [Input(signal=n, unit="1", maximum_age_s=5.0, lower=0.0, upper=1.0) for n in ("y_p_du", "n_p")]
    table, sampler = any_sender(), Sampler(inputs)
    for k, address in enumerate([0x3D, 0x3D, 0x21, 0x3D]):
        for name, value, quality in table.decode(GROUP | address, True, bytes(8), 0.2 * k):
            sampler.receive(name, 0.2 * k, value, quality)
    assert sampler.new_doubts() == {"y_p_du": 0.2, "n_p": 0.2}
    assert sampler.sample(0.7)[1].tolist() == [Quality.DOUBTED] * 2


def test_a_second_sender_is_a_condition_at_once() -> None:
    table = any_sender()
    inputs = [Input(signal=n, unit="1", maximum_age_s=5.0, lower=0.0, upper=1.0) for n in ("y_p_du", "n_p")]
    traffic = Traffic(table, inputs, 0.0)
    for k in range(20):
        table.decode(GROUP | (0x21 if k == 18 else 0x3D), True, k.to_bytes(8, "little"), 0.2 * k)
        traffic.note(0.2 * k)
        found = traffic.look(0.2 * k, None)
        assert found == ({Condition("second-sender", "UDS_ECU")} if k >= 18 else set())


def test_a_log_is_known_to_have_several_senders_by_its_identifiers() -> None:
    table = any_sender()
    assert table.undecided({(GROUP | 0x3D, True), (GROUP ^ 0x0C00003D, True), (0x10, False)}) == []
    assert table.undecided({(GROUP | 0x3D, True), (GROUP | 0x07, True)}) == [
        "UDS_ECU comes from 0x07, 0x3D, and the DBC does not say which one is meant: choose one, "
        "as with --sender UDS_ECU=0x07"
    ]
    assert any_sender({"UDS_ECU": 7}).undecided({(GROUP | 0x3D, True), (GROUP | 0x07, True)}) == []


@pytest.mark.parametrize(
    ("senders", "message"),
    [
        ({"EEC1": 0}, "vendors.dbc: a sender is chosen for EEC1; messages of J1939 with wanted signals: UDS_ECU"),
        ({"UDS_ECU": 0xFE}, "vendors.dbc: sender 254 is chosen for UDS_ECU; an address is one of 0x00 to 0xFD"),
    ],
)
def test_a_sender_that_cannot_be_chosen_is_refused(senders: dict[str, int], message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}"):
        any_sender(senders)


ADDRESSED = """VERSION ""
BS_:
BU_: A
BO_ {first} TSC1: 8 A
 SG_ torque : 0|8@1+ (1,0) [0|0] "1" A
BO_ {second} ANOTHER: 8 A
 SG_ other : 0|8@1+ (1,0) [0|0] "1" A
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
"""
EFF = 0x8000_0000


@pytest.mark.parametrize("written", [0x0C000003, 0x0C000B03, 0x0C00FF03])
def test_the_destination_is_no_part_of_an_addressed_group(written: int) -> None:
    text = ADDRESSED.format(first=EFF | written, second=EFF | 0x0CEF0003)
    table = compile_dbc(text, {"torque": "1"}, "m.dbc")
    for destination in (0x00, 0x0F, 0xFF):
        assert table.decode(0x0C000003 | destination << 8, True, bytes(8))
    assert table.decode(0x0C000004, True, bytes(8)) == []
    assert table.rejected.other_source == {"TSC1": 1}
    assert Wanted(0, 0x03FF0000, True) in table.wanted
    assert not table.decode(0x0C010003, True, bytes(8))


def test_it_is_where_another_message_of_the_dbc_differs_in_nothing_else() -> None:
    text = ADDRESSED.format(first=EFF | 0x0C000003, second=EFF | 0x0C000F03)
    for units in ({"torque": "1"}, {"torque": "1", "other": "1"}):
        table = compile_dbc(text, units, "m.dbc")
        assert names(table.decode(0x0C000003, True, bytes(8))) == {"torque": "GOOD"}
        assert names(table.decode(0x0C000F03, True, bytes(8))) == {name: "GOOD" for name in units if name == "other"}


def test_of_two_messages_of_a_group_the_one_with_the_senders_address_has_its_frames() -> None:
    text = ADDRESSED.format(first=EFF | 0x18FF10FE, second=EFF | 0x18FF1003)
    table = compile_dbc(text, {"torque": "1", "other": "1"}, "m.dbc")
    assert names(table.decode(0x18FF1003, True, bytes(8))) == {"other": "GOOD"}
    assert names(table.decode(0x18FF1004, True, bytes(8))) == {"torque": "GOOD"}
    assert names(table.decode(0x18FF1003, True, bytes(8))) == {"other": "GOOD"}
    assert table.senders == {"TSC1": {4: 1}}


def test_any_number_of_destinations_and_senders_is_decoded_in_bounded_memory() -> None:
    text = ADDRESSED.format(first=EFF | 0x0C0000FE, second=EFF | 0x0CEF0003)
    table = compile_dbc(text, {"torque": "1"}, "m.dbc")
    table.decode(0x0C000000, True, bytes(8))
    for destination in range(256):
        for source in range(40, 256, 40):
            identifier = 0x0C000000 | destination << 8 | source
            assert names(table.decode(identifier, True, bytes(8))) == {"torque": "DOUBTED"}
    assert len(table._j1939) <= BOUND
    assert sum(table.senders["TSC1"].values()) == 1 + 256 * 6


LONG = ANY.replace("UDS_ECU: 8 ACM", "UDS_ECU: 20 ACM").replace("n_p : 16|16@1+", "n_p : 136|16@1+")


def in_parts(payload: bytes, source: int, pgn: int = 0xFF10) -> list[tuple[int, bytes]]:
    count = -(-len(payload) // 7)
    begin = bytes([0x20]) + len(payload).to_bytes(2, "little") + bytes([count, 0xFF]) + pgn.to_bytes(3, "little")
    parts = [bytes([k + 1]) + payload[7 * k : 7 * k + 7].ljust(7, b"\xff") for k in range(count)]
    return [(0x1CECFF00 | source, begin), *((0x1CEBFF00 | source, part) for part in parts)]


@pytest.mark.parametrize("dbc", [LONG, LONG.replace(str(0x98FF10FE), str(0x98FF103D))])
def test_a_message_in_parts_is_decoded_with_the_last_of_them(dbc: str) -> None:
    table = compile_dbc(dbc, {"y_p_du": "Pa", "n_p": "1/s"}, "long.dbc")
    payload = bytes([0x10, 0x27, *bytes(15), 0x88, 0x13, 0])
    for t in (0.0, 0.2, 0.4):
        *first, last = in_parts(payload, 0x3D)
        for can_id, data in first:
            assert table.decode(can_id, True, data, t) == []
        found = table.decode(last[0], True, last[1], t + 0.1)
        assert names(found) == BOTH_GOOD
        assert [value for _, value, _ in found] == pytest.approx([500e3, 10.0])
    assert table.taken == {"UDS_ECU": 3}
    assert {Wanted(0x00EB0000, 0x03FF0000, True), Wanted(0x00EC0000, 0x03FF0000, True)} < set(table.wanted)
    assert table.carries(0x1CECFF3D, True)
    assert table.decode(0x18FF103D, True, bytes(8), 1.0) == []
    assert table.rejected.short == {"UDS_ECU": 1}


def test_a_second_sender_of_a_message_in_parts_is_seen() -> None:
    table = compile_dbc(LONG, {"y_p_du": "Pa"}, "long.dbc")
    found = [table.decode(*frame[:1], True, frame[1], 0.0) for frame in in_parts(bytes(20), 0x3D)]
    assert names(found[-1]) == {"y_p_du": "GOOD"}
    found = [table.decode(*frame[:1], True, frame[1], 0.1) for frame in in_parts(bytes(20), 0x21)]
    assert names(found[-1]) == {"y_p_du": "DOUBTED"}
    chosen = compile_dbc(LONG, {"y_p_du": "Pa"}, "long.dbc", {"UDS_ECU": 0x3D})
    assert not any(chosen.decode(can_id, True, data, 0.0) for can_id, data in in_parts(bytes(20), 0x21))
    assert chosen.rejected.other_source == {"UDS_ECU": 1}
    assert not chosen.carries(0x1CECFF21, True)


def test_frames_of_somebody_else_within_a_message_in_parts_are_known_by_when_the_message_comes() -> None:
    table = compile_dbc(LONG, {"y_p_du": "Pa"}, "long.dbc")
    for k in range(100):
        for can_id, data in in_parts(k.to_bytes(20, "little"), 0x3D):
            found = table.decode(can_id, True, data, 0.2 * k)
    assert names(found) == {"y_p_du": "GOOD"}
    for can_id, data in in_parts(b"forged !".ljust(20), 0x3D):
        found = table.decode(can_id, True, data, 19.86)
    assert names(found) == {"y_p_du": "DOUBTED"}


def test_parts_that_are_missing_are_a_condition() -> None:
    table = compile_dbc(LONG, {"y_p_du": "Pa"}, "long.dbc")
    traffic = Traffic(table, [Input(signal="y_p_du", unit="1", maximum_age_s=5.0, lower=0.0, upper=1.0)], 0.0)
    for k in range(3):
        for number, (can_id, data) in enumerate(in_parts(bytes(20), 0x3D)):
            if (k, number) != (1, 2):
                table.decode(can_id, True, data, k)
        traffic.note(k)
    assert traffic.look(2.0, None) == {Condition("incomplete", "UDS_ECU")}
    assert table.incomplete() == {"UDS_ECU": 1}
    assert table.remarks() == [
        "of any sender, by the DBC: UDS_ECU from 0x3D (2 frames)",
        "messages that are not whole, and not used: 1 UDS_ECU in parts (lost)",
    ]


def test_frames_counted_at_once_are_those_counted_one_by_one() -> None:
    rng = np.random.default_rng(4)
    for addresses in ([0x3D] * 5, [0x3D, 0x3D, 0x21, 0x3D], [0x21], rng.integers(0, 3, 40).tolist()):
        one, many = any_sender().sources, any_sender().sources
        [layout] = any_sender().layouts
        expected = sum(one.is_sole(layout, address) for address in addresses)
        assert many.count_sole(layout, np.array(addresses)) == expected
        assert many.counts == one.counts
        more = sum(one.is_sole(layout, address) for address in addresses)
        assert (many.count_sole(layout, np.array(addresses)), many.counts) == (more, one.counts)


def test_frames_of_others_at_once_are_those_one_by_one() -> None:
    table, other = (compile_dbc(UDS, {"y_p_du": "Pa"}, "vendors.dbc") for _ in range(2))
    identifiers = np.array([GROUP | 0x21, GROUP | 0x21, 0x18FEF500, GROUP | 0x07, GROUP | 0x21])
    table.sources.take_others(identifiers)
    for identifier in identifiers.tolist():
        other.sources.take_other(identifier, b"")
    assert (table.sources.others, table.sources.other) == (other.sources.others, other.sources.other)
    assert table.sources.others == {"UDS_ECU": 4}


TWO_BUSES = {"UDS_SENSORS": "body"}


def two_buses(dbc: str = ANY) -> DecodeTable:
    return compile_dbc(dbc, {"y_p_du": "Pa", "y_p_ap": "Pa"}, "vendors.dbc", {}, TWO_BUSES)


def test_messages_of_another_bus_are_decoded_by_its_table_and_counted_with_the_others() -> None:
    table = two_buses()
    body = table.of_bus("body")
    assert (table.of_bus(""), [*table.buses]) == (table, ["body"])
    assert [layout.name for layout in table.all_layouts] == ["UDS_ECU", "UDS_SENSORS"]
    assert names(body.decode(0x18FF20F9, True, bytes(8), 0.0)) == {"y_p_ap": "GOOD"}
    assert table.decode(0x18FF20F9, True, bytes(8), 0.0) == []
    assert names(table.decode(GROUP | 0x3D, True, bytes(8), 0.0)) == {"y_p_du": "GOOD"}
    assert table.taken == body.taken == {"UDS_ECU": 1, "UDS_SENSORS": 1}
    assert body.decode(0x18FF20F9, True, b"1", 0.2) == []
    assert body.decode(0x18FF2007, True, bytes(8), 0.2) == []
    assert (table.rejected.short, table.rejected.other_source) == ({"UDS_SENSORS": 1}, {"UDS_SENSORS": 1})
    assert table.strangers() == []


def test_what_is_worth_knowing_is_known_of_all_buses() -> None:
    both = ANY.replace(str(0x98FF20F9), str(0x98FF20FE))
    table = two_buses(both)
    assert table.remarks() == []
    table.decode(GROUP | 0x3D, True, bytes(8), 0.0)
    table.of_bus("body").decode(0x18FF2007, True, bytes(8), 0.0)
    assert table.remarks() == [
        "of any sender, by the DBC: UDS_ECU from 0x3D (1 frames), UDS_SENSORS from 0x07 (1 frames)"
    ]
    table.of_bus("body").decode(0x18FF2008, True, bytes(8), 0.1)
    assert len(table.strangers()) == 1


def test_the_speed_of_a_replay_is_that_of_all_buses() -> None:
    table = two_buses()
    table.run_at(20.0)
    assert {each.speed for one in (table, table.of_bus("body")) for each in one.arrivals.values()} == {20.0}
    table.run_at(0.5)
    assert {each.speed for one in (table, table.of_bus("body")) for each in one.arrivals.values()} == {1.0}
