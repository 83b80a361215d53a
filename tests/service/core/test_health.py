"""Conditions with their patience, and what is wrong with how frames come."""

from importlib import resources

import msgspec
import numpy as np
import pytest

from faultline.service.core.manifest import Input
from faultline.service.core.records.health import (
    CLEARED_S,
    RAISED_S,
    SCHEMA,
    Condition,
    Conditions,
    Health,
    Kind,
    Standing,
)
from faultline.service.core.records.line import encode
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.traffic import EXPECTED_S, WINDOW_S, Traffic
from faultline.service.core.signals.values import Quality

DOWN, LOST = Condition("bus-down", "can0"), Condition("frames-lost", "can0")


def test_a_condition_is_told_once_it_lasts_and_gone_once_it_was_away() -> None:
    conditions = Conditions()
    assert not conditions.update(0.0, [DOWN])
    assert conditions.update(RAISED_S, [DOWN])
    assert list(conditions.standing) == [DOWN]
    assert not conditions.update(RAISED_S + CLEARED_S - 0.1, [])
    assert conditions.update(RAISED_S + CLEARED_S, [])
    assert list(conditions.standing) == []


def test_what_does_not_last_is_not_told_and_a_loose_plug_is_one_message() -> None:
    conditions, changes = Conditions(), 0
    for k in range(1000):
        changes += conditions.update(0.1 * k, [LOST] if k % 15 < 10 else [])  # a second there, half a second away
    assert changes == 0
    for k in range(1000):
        changes += conditions.update(100.0 + 0.1 * k, [DOWN] if k % 60 < 30 else [])  # three seconds and three
    assert (changes, list(conditions.standing)) == (1, [DOWN])


def test_no_traffic_ends_with_the_frames_that_refute_it() -> None:
    """Ten seconds more are 200 s of log time at 20x, in which values run beside it."""
    silent, conditions = Condition("no-traffic", "UDS_ECU"), Conditions()
    for t in (0.0, RAISED_S):
        conditions.update(t, [silent, LOST])
    assert list(conditions.standing) == [LOST, silent]
    assert conditions.update(RAISED_S + 1.0, [])
    assert list(conditions.standing) == [LOST], "others have their patience"


def test_a_record_is_a_line_and_reads_back() -> None:
    standing = [Standing(kind="bus-down", of="can0", since="2026-01-01T00:00:00.000+00:00")]
    health = Health(schema=SCHEMA, id="truck-3", seq=3, wall=None, conditions=standing)
    line = encode(health)
    assert line.endswith(b"}\n")
    assert line.count(b"\n") == 1
    assert msgspec.json.decode(line, type=Health) == health


DBC = resources.files("faultline.dbc").joinpath("uds.dbc").read_text()
ECU, BROADCAST = 0x18FF103D, 0x0CF0233D
SIGNALS = {"y_p_du": "Pa", "def_doser_pressure": "Pa"}


class Road:
    """Frames of the controller at their periods, looked at every second."""

    def __init__(self) -> None:
        self.table: DecodeTable = compile_dbc(DBC, SIGNALS, "uds.dbc")
        self.inputs = [Input(signal=name, unit="Pa", maximum_age_s=1.0, lower=0.0, upper=1e7) for name in SIGNALS]
        self.traffic = Traffic(self.table, self.inputs, 0.0)
        self.t = 0.0
        self.quality = np.zeros(len(self.inputs), dtype=np.int8)

    def drive(self, seconds: float, times: float = 1.0, frame: bytes = bytes(8)) -> set[Condition]:
        """What is found at the end of so many seconds in which frames come `times` as often as they should."""
        found: set[Condition] = set()
        due = {ECU: [self.t, 0.2], BROADCAST: [self.t, 0.05]}
        for _ in range(round(seconds)):
            self.t += 1.0
            for can_id, (at, period) in due.items():
                while times and at < self.t:
                    self.table.decode(can_id, True, frame)
                    at += period / times
                due[can_id][0] = at
            self.traffic.note(self.t)
            found = self.traffic.look(self.t, self.quality)
        return found


def kinds(found: set[Condition]) -> dict[Kind, set[str]]:
    return {kind: {each.of for each in found if each.kind == kind} for kind in {each.kind for each in found}}


def test_ordinary_traffic_is_no_condition() -> None:
    assert Road().drive(60.0) == set()


def test_twice_as_many_frames_are_of_two_senders_until_one_stops() -> None:
    road = Road()
    assert kinds(road.drive(3 * WINDOW_S, 2.0)) == {"second-sender": {"UDS_ECU", "A1SCRDSI1"}}
    assert road.drive(7 * WINDOW_S) == set()


def test_signals_of_two_senders_are_doubted() -> None:
    road = Road()
    road.drive(3 * WINDOW_S, 2.0)
    assert {*road.traffic.doubted} == {*SIGNALS}
    road.drive(7 * WINDOW_S)
    assert not road.traffic.doubted


CLAIM = 0x18EEFF3D
"""The controller's address is 0x3D."""


def test_another_device_that_claims_the_senders_address_is_told() -> None:
    road = Road()
    road.drive(WINDOW_S)
    for name in (b"the same", b"the same"):
        assert road.table.decode(CLAIM, True, name) == []
    assert road.drive(2 * WINDOW_S) == set()
    road.table.decode(CLAIM, True, b"another.")
    road.table.decode(CLAIM + 1, True, b"somebody")
    found = road.drive(WINDOW_S - 1)
    assert {each.kind for each in found} == {"address-claim"}
    assert "UDS_ECU" in {each.of for each in found}
    assert "y_p_du" in road.traffic.doubted
    assert road.drive(2 * WINDOW_S) == set()


def test_claims_are_counted_by_address_and_name() -> None:
    """Who claims again what it has is nobody else; what is no NAME says nothing; each address has its own."""
    table = Road().table

    def claimed(address: int, name: bytes) -> int:
        before = table.rejected.claimed.get("UDS_ECU", 0)
        table.decode(0x18EEFF00 | address, True, name)
        return table.rejected.claimed.get("UDS_ECU", 0) - before

    assert [claimed(0x3D, b"the first"[:8]), claimed(0xF9, b"another.")] == [0, 0]
    assert [claimed(0x3D, b"short"), claimed(0x3D, b"the firs")] == [0, 0]
    assert [claimed(0x3D, b"another."), claimed(0x3D, b"another."), claimed(0x3D, b"the firs")] == [1, 0, 1]
    assert claimed(0x3E, b"nobody's") == 0


def test_a_second_source_is_told_of_groups_that_mean_the_same_of_everybody() -> None:
    """A proprietary group of another sender may be anything."""
    road = Road()
    for _ in range(20):
        road.drive(1.0)
        for can_id in (ECU, BROADCAST):
            road.table.decode(can_id ^ 1, True, bytes(8))
    assert kinds(road.drive(1.0)) == {"second-sender": {"A1SCRDSI1"}}
    assert not road.traffic.doubted, "the DBC's own sender is known by its address"
    assert road.drive(2 * WINDOW_S) == set()


def test_short_frames_are_told_by_message() -> None:
    road = Road()
    road.drive(1.0)
    assert kinds(road.drive(2 * WINDOW_S, frame=bytes(5))) == {"short-frames": {"UDS_ECU", "A1SCRDSI1"}}


def test_no_frame_at_all_is_one_condition_not_one_of_every_signal() -> None:
    """Before the ignition and after it; its being turned off is no fault of each sensor."""
    road = Road()
    road.quality[:] = Quality.MISSING
    assert road.drive(EXPECTED_S - 1, 0.0) == set()
    assert kinds(road.drive(2.0, 0.0)) == {"no-traffic": {"UDS_ECU, A1SCRDSI1"}}
    assert kinds(road.drive(1.0)) == {"missing": {*SIGNALS}}
    road.quality[:] = Quality.LATE
    assert {each.kind for _ in range(3) for each in road.drive(1.0, 0.0)} <= {"missing"}
    assert road.drive(1.0, 0.0) == set()
    assert kinds(road.drive(2.0, 0.0)) == {"no-traffic": {"UDS_ECU, A1SCRDSI1"}}


def test_two_senders_are_seen_within_three_seconds() -> None:
    road = Road()
    road.drive(60.0)
    assert kinds(road.drive(3.0, 2.0)) == {"second-sender": {"UDS_ECU", "A1SCRDSI1"}}


def test_every_third_frame_more_is_seen_within_a_minute() -> None:
    road = Road()
    road.drive(120.0)
    assert road.drive(60.0, 1.1) == set(), "a clock that is fast is no second sender"
    assert kinds(road.drive(70.0, 4 / 3)) == {"second-sender": {"UDS_ECU", "A1SCRDSI1"}}


def test_what_waited_for_the_beginning_is_no_crowd() -> None:
    """Controllers say much when they start, and a device's queue is emptied at once."""
    road = Road()
    for _ in range(10):
        assert not road.drive(1.0, 1.35)
    road = Road()
    for _ in range(100):
        road.table.decode(BROADCAST, True, bytes(8))
    assert not road.drive(9.0)


def test_messages_that_come_seldom_are_waited_for() -> None:
    road = Road()
    slow = DBC.replace('BA_ "GenMsgCycleTime" BO_ 2566852669 200;', 'BA_ "GenMsgCycleTime" BO_ 2566852669 10000;')
    assert slow != DBC
    table = compile_dbc(slow, {"y_p_du": "Pa"}, "uds.dbc")
    traffic = Traffic(table, road.inputs[:1], 0.0)
    for second in range(60):
        if second % 10 == 0:
            table.decode(ECU, True, bytes(8))
        traffic.note(float(second))
        assert traffic.look(float(second), road.quality[:1]) == set()


def test_frames_that_waited_are_counted_when_they_came() -> None:
    """The process was held up for eight seconds; frames have the kernel's stamps."""
    road = Road()
    road.drive(60.0)
    for k in range(1, 9):
        for can_id, count in ((ECU, 5), (BROADCAST, 20)):
            for _ in range(count):
                road.table.decode(can_id, True, bytes(8))
        road.traffic.note(60.0 + k)
    assert road.traffic.look(68.0, road.quality) == set()


def test_at_twenty_times_real_time_a_stutter_of_the_sender_is_none() -> None:
    """A tenth of a second without a frame and then all of them, which is two seconds of log time."""
    road = Road()
    road.traffic = Traffic(road.table, road.inputs, 0.0, 20.0)
    road.drive(60.0)
    for k in range(1, 60):
        for can_id, count in ((ECU, 5), (BROADCAST, 20)):
            for _ in range(2 * count * (k % 2)):
                road.table.decode(can_id, True, bytes(8))
        road.traffic.note(60.0 + k)
        assert not {each.kind for each in road.traffic.look(60.0 + k, road.quality)} & {"second-sender"}


def test_at_twenty_times_real_time_a_first_frame_has_as_much_real_time() -> None:
    """Log time begins with the first frame: whoever starts a replay has 30 s for that, not 1.5."""
    road = Road()
    road.traffic = Traffic(road.table, road.inputs, 0.0, 20.0)
    assert road.drive(20 * EXPECTED_S - 20, 0.0) == set()
    assert kinds(road.drive(40.0, 0.0)) == {"no-traffic": {"UDS_ECU, A1SCRDSI1"}}


@pytest.mark.parametrize("quality", [q for q in Quality if q not in (Quality.GOOD, Quality.DOUBTED)])
def test_every_quality_that_is_no_number_is_a_condition_of_its_signal(quality: Quality) -> None:
    road = Road()
    road.quality[1] = quality
    assert {each.of for each in road.drive(2.0)} == {"def_doser_pressure"}
