"""When codes are told: once a second, and at once when they change."""

import random

import pytest
from j1939_bench import TOOL, US, answers, apart, at_work, begins, codes, dm1s, name, request

from faultline.service.core.j1939.dm1 import Code, decode, encode
from faultline.service.core.j1939.identifiers import ADDRESS_CLAIMED, DM1, DM2, GLOBAL
from faultline.service.j1939.dtcs import Known
from faultline.service.j1939.node import Node


@pytest.mark.parametrize("number", [0, 1, 2, 3, 32])
def test_codes_are_told_once_a_second(number: int) -> None:
    made = at_work(codes(number, amber=bool(number)))
    made.run(100.5)
    told = dm1s(made)
    assert {data for _, data in told} == {encode(codes(number).active, amber=bool(number))}
    assert begins(made) == pytest.approx([0.001 + k for k in range(101)], abs=0.001)


@pytest.mark.parametrize(("number", "period"), [(33, 1.01), (40, 1.21), (100, 2.91)])
def test_a_longer_list_comes_as_often_as_it_goes_and_never_overlaps(number: int, period: float) -> None:
    """33 codes: 134 bytes, 20 parts, 50 ms each, and 10 ms before the next begins; 40: 24 parts; 100: 58."""
    made = at_work(codes(number))
    made.run(60.0)
    assert {len(decode(data).codes) for _, data in dm1s(made)} == {number}
    times = begins(made)
    between = apart(times)
    assert between == pytest.approx([period] * len(between), abs=0.002)
    assert len(between) > 15


def test_what_nobody_knows_is_not_told() -> None:
    """Silence is not the same as no fault."""
    made = at_work(codes(3))
    made.run(5.2)
    made.nodes[0].know(None, 5.2)
    made.run(20.0)
    assert max(t for t, _ in dm1s(made)) < 6.0
    for frame in (request(DM1, TOOL, GLOBAL, 21.0), request(DM2, TOOL, US, 21.5), request(0xEE00, TOOL, US, 22.0)):
        made.say(frame)
    made.run(30.0)
    assert not dm1s(made, 6.0)
    [busy] = answers(made)
    assert busy.data == bytes([3, 0xFF, 0xFF, 0xFF, TOOL, 0xCB, 0xFE, 0x00])  # cannot respond now
    assert [pgn for t, _, pgn, _ in made.heard(22.0) if pgn != 0xEA00] == [ADDRESS_CLAIMED]  # still defended
    made.nodes[0].know(codes(1), 30.0)
    made.run(30.01)
    assert [data for _, data in dm1s(made, 30.0)] == [encode(codes(1).active, amber=True)]


def test_a_change_is_told_at_once_and_the_next_one_a_second_later() -> None:
    made = at_work(codes(0, amber=False))
    made.run(3.4)
    made.nodes[0].know(codes(1), 3.4)
    made.run(3.41)
    assert [data for t, data in dm1s(made, 3.3)] == [encode(codes(1).active, amber=True)]
    made.run(6.0)
    assert begins(made) == pytest.approx([0.001, 1.001, 2.001, 3.001, 3.4005, 4.4005, 5.4005], abs=0.001)


def test_states_that_change_often_are_told_once_a_second_on_change() -> None:
    made = at_work(codes(0, amber=False))
    made.run(10.25)
    for k in range(100):
        made.nodes[0].know(codes(k % 2 + 1 if k % 3 else 0, amber=bool(k % 3)), made.now)
        made.run(10.25 + 0.05 * (k + 1))
    made.nodes[0].know(codes(7), made.now)
    made.run(20.0)
    times = begins(made)
    for begin in times:
        assert sum(begin <= t < begin + 0.99 for t in times) <= 2
    assert len([t for t in times if 10.25 <= t < 15.25]) <= 10
    assert dm1s(made)[-1][1] == encode(codes(7).active, amber=True)
    last = next(t for t, data in dm1s(made) if data == encode(codes(7).active, amber=True))
    assert last < 15.25 + 1.3


def test_a_count_that_goes_up_is_no_change_of_state() -> None:
    made = at_work(Known((Code(1, 1, 1),), (), amber=True))
    made.run(2.5)
    made.nodes[0].know(Known((Code(1, 1, 2),), (), amber=True), 2.5)
    made.run(4.5)
    assert begins(made) == pytest.approx([0.001, 1.001, 2.001, 3.001, 4.001], abs=0.001)
    assert [decode(data).codes[0].oc for _, data in dm1s(made)] == [1, 1, 1, 2, 2]


def test_a_change_while_the_old_list_is_sent_comes_after_it() -> None:
    """What comes last is what a receiver believes."""
    made = at_work(codes(32))
    made.run(5.3)
    made.nodes[0].know(codes(1), 5.3)
    made.run(7.5)
    told = [(round(t, 2), len(decode(data).codes)) for t, data in dm1s(made, 5.0)]
    assert told[:2] == [(5.95, 32), (5.95, 1)]
    assert [number for _, number in told] == [32, 1, 1]


@pytest.mark.parametrize("seed", range(6))
def test_whatever_changes_the_last_word_is_the_last_state(seed: int) -> None:
    """The reader asserts the order and gaps of parts, and that no broadcast begins before the last one has ended."""
    chance = random.Random(seed)  # noqa: S311
    made, known = at_work(), codes(0, amber=False)
    made.run(0.3)
    for _ in range(60):
        number = chance.choice([0, 1, 2, 5, 32, 40])
        known = codes(number, amber=bool(number), previous=chance.choice([0, 1, 9]))
        made.nodes[0].know(None if chance.random() < 0.1 else known, made.now)
        if chance.random() < 0.5:
            made.say(request(chance.choice([DM1, DM2]), TOOL, chance.choice([GLOBAL, US]), made.now))
        made.run(made.now + chance.choice([0.0, 0.03, 0.4, 1.0, 2.0]))
    made.nodes[0].know(known, made.now)
    changed = made.now
    made.run(changed + 6.0)
    assert dm1s(made)[-1][1] == encode(known.active, known.amber), f"seed {seed}"
    times = [t for t, _ in dm1s(made, changed)]
    assert max(apart(times)) < 1.35


def test_who_is_called_late_does_not_drift() -> None:
    node, now = Node(name(1), [US]), 0.0
    node.begin(now)
    node.know(codes(1), now)
    times = []
    while now < 100.0:
        for frame in node.frames(now):
            node.hear(frame, now)
            times += [now] if frame.can_id == 0x18FECA3D else []
        assert node.due is not None
        now = max(now, node.due) + 0.005
    assert times == pytest.approx([times[0] + k for k in range(len(times))], abs=0.02)
    assert len(times) >= 99


def test_after_a_pause_nothing_is_made_up_for() -> None:
    """The process was stopped."""
    made = at_work(codes(1))
    made.run(3.5)
    made.now = 60.0
    made.run(63.5)
    assert begins(made)[4:] == pytest.approx([60.0, 61.0, 62.0, 63.0], abs=0.002)
