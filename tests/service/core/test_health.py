"""Conditions with their patience, and what is wrong with how frames come."""

from importlib import resources

import numpy as np
import pytest

from service.core.dbc import compile_dbc
from service.core.decode import DecodeTable
from service.core.health import (
    CLEARED_S,
    RAISED_S,
    SCHEMA,
    Condition,
    Conditions,
    Health,
    Kind,
    Standing,
    decode_health,
    encode_health,
)
from service.core.manifest import Input
from service.core.signals import Quality
from service.core.traffic import EXPECTED_S, WINDOW_S, Traffic

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


def test_a_record_is_a_line_and_reads_back() -> None:
    standing = [Standing(kind="bus-down", of="can0", since="2026-01-01T00:00:00.000+00:00")]
    health = Health(schema=SCHEMA, id="truck-3", seq=3, wall=None, conditions=standing)
    line = encode_health(health)
    assert line.endswith(b"}\n")
    assert line.count(b"\n") == 1
    assert decode_health(line) == health


DBC = resources.files("dbc").joinpath("uds.dbc").read_text()
ECU, BROADCAST = 0x18FF103D, 0x0CF0233D
SIGNALS = {"y_p_du": "Pa", "def_doser_pressure": "Pa"}


class Road:
    """Frames of the controller at their periods, looked at every second."""

    def __init__(self) -> None:
        self.table: DecodeTable = compile_dbc(DBC, SIGNALS, "uds.dbc")
        inputs = [Input(signal=name, unit="Pa", maximum_age_s=1.0, lower=0.0, upper=1e7) for name in SIGNALS]
        self.traffic = Traffic(self.table, inputs, 0.0)
        self.t = 0.0
        self.quality = np.zeros(len(inputs), dtype=np.int8)

    def drive(self, seconds: float, times: float = 1.0, frame: bytes = bytes(8), source: int = 0) -> set[Condition]:
        """What is found at the end of so many seconds in which frames come `times` as often as they should."""
        found: set[Condition] = set()
        due = {ECU ^ source: [self.t, 0.2], BROADCAST ^ source: [self.t, 0.05]}
        for _ in range(round(seconds)):
            self.t += 1.0
            for can_id, (at, period) in due.items():
                while times and at < self.t:
                    self.table.decode(can_id, True, frame)
                    at += period / times
                due[can_id][0] = at
            found = self.traffic.look(self.t, self.quality)
        return found


def kinds(found: set[Condition]) -> dict[Kind, set[str]]:
    return {kind: {each.of for each in found if each.kind == kind} for kind in {each.kind for each in found}}


def test_ordinary_traffic_is_no_condition() -> None:
    assert Road().drive(60.0) == set()


def test_twice_as_many_frames_are_of_two_senders_until_one_stops() -> None:
    road = Road()
    assert kinds(road.drive(3 * WINDOW_S, 2.0)) == {"second-sender": {"UDS_ECU", "A1SCRDSI1"}}
    assert road.drive(2 * WINDOW_S) == set()


def test_signals_of_two_senders_are_doubted() -> None:
    road = Road()
    road.drive(3 * WINDOW_S, 2.0)
    assert road.traffic.doubted == {*SIGNALS}
    road.drive(2 * WINDOW_S)
    assert road.traffic.doubted == frozenset()


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
    found = road.drive(WINDOW_S + 1)
    assert {each.kind for each in found} == {"address-claim"}
    assert "UDS_ECU" in {each.of for each in found}
    assert "y_p_du" in road.traffic.doubted
    assert road.drive(2 * WINDOW_S) == set()


def test_a_second_source_is_told_of_groups_that_mean_the_same_of_everybody() -> None:
    """A proprietary group of another sender may be anything."""
    road = Road()
    road.drive(1.0)
    road.drive(WINDOW_S, source=1)
    assert kinds(road.drive(WINDOW_S, source=1)) == {"second-sender": {"A1SCRDSI1"}}


def test_short_frames_are_told_by_message() -> None:
    road = Road()
    road.drive(1.0)
    assert kinds(road.drive(2 * WINDOW_S, frame=bytes(5))) == {"short-frames": {"UDS_ECU", "A1SCRDSI1"}}


def test_no_frame_at_all_is_one_condition_not_one_of_every_signal() -> None:
    road = Road()
    road.quality[:] = Quality.MISSING
    assert road.drive(EXPECTED_S - 1, 0.0) == {Condition("missing", name) for name in SIGNALS}
    assert kinds(road.drive(2.0, 0.0)) == {"no-traffic": {"UDS_ECU, A1SCRDSI1"}}
    assert kinds(road.drive(1.0)) == {"missing": {*SIGNALS}}


@pytest.mark.parametrize("quality", [q for q in Quality if q not in (Quality.GOOD, Quality.DOUBTED)])
def test_every_quality_that_is_no_number_is_a_condition_of_its_signal(quality: Quality) -> None:
    road = Road()
    road.quality[1] = quality
    assert {each.of for each in road.drive(2.0)} == {"def_doser_pressure"}
