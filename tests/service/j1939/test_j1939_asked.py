"""Who asks is answered: to all, in parts, to that one, or with a refusal."""

import random

import pytest
from j1939_bench import TOOL, US, Bench, Reader, answers, apart, at_work, begins, codes, dm1s, name, request

from faultline.service.core.j1939.dm1 import decode, encode
from faultline.service.core.j1939.identifiers import ACKNOWLEDGEMENT, DM1, DM2, GLOBAL, NULL, TP_CM, TP_DT
from faultline.service.j1939.frames import Heard, Message, parse
from faultline.service.j1939.node import Node
from faultline.service.j1939.outbox import CONNECTIONS
from faultline.service.logs import Frame


@pytest.mark.parametrize("to", [GLOBAL, US])
@pytest.mark.parametrize(("pgn", "number"), [(DM1, 0), (DM1, 1), (DM2, 0), (DM2, 1)])
def test_what_fits_in_a_frame_is_told_to_all(to: int, pgn: int, number: int) -> None:
    known = codes(number, previous=number)
    made = at_work(known)
    made.say(request(pgn, TOOL, to, 5.5))
    made.run(5.6)
    expected = encode(known.active if pgn == DM1 else known.previous, amber=True)
    assert [(each, data) for t, _, each, data in made.heard(5.5001)] == [(pgn, expected)]
    assert made.log[-1].t < 5.502


@pytest.mark.parametrize(("number", "pgn"), [(3, DM2), (32, DM2), (40, DM2), (3, DM1)])
def test_what_all_ask_for_is_broadcast(number: int, pgn: int) -> None:
    known = codes(number if pgn == DM1 else 0, previous=number)
    made = at_work(known)
    made.say(request(pgn, TOOL, GLOBAL, 5.5))
    made.run(9.0)
    told = [(t, data) for t, _, each, data in made.heard(5.5) if each == pgn]
    expected = encode(known.active if pgn == DM1 else known.previous, amber=True)
    assert {data for _, data in told} == {expected}
    parts = -(-len(expected) // 7)
    assert told[0][0] == pytest.approx(5.5 + 0.05 * parts, abs=0.002)
    assert begins(made)[:6] == pytest.approx([0.001 + k for k in range(6)], abs=0.001)


def test_one_broadcast_at_a_time_and_dm1_has_its_turn() -> None:
    """DM2 of 40 codes takes 1.2 s, and may have begun just before a DM1 was due. The reader asserts the rest."""
    made = at_work(codes(3, previous=40))
    for k in range(60):
        made.say(request(DM2, TOOL, GLOBAL, 3.0 + 0.2 * k))
    made.run(15.0)
    assert len([1 for _, _, pgn, _ in made.heard() if pgn == DM2]) >= 7
    times = [t for t, _ in dm1s(made)]
    assert max(apart(times)) < 2.25


def take(made: Bench, at_once: int = 255) -> list[bytes]:
    """An ear that takes what is sent to the tool alone, so many parts at once; gives what was received."""
    whole: list[bytes] = []
    state = {"size": 0, "parts": 0}
    content = bytearray()

    def answer(*begin: int) -> list[Frame]:
        return [Message(TP_CM, bytes([*begin, 0xCB, 0xFE, 0x00]), US, 7).frame(TOOL, made.now + 0.02)]

    def ear(frame: Frame) -> list[Frame]:
        heard = parse(frame)
        if heard is None or heard.source != US or heard.destination != TOOL:
            return []
        if heard.pgn == TP_CM and heard.data[0] == 0x10:
            state.update(size=int.from_bytes(heard.data[1:3], "little"), parts=heard.data[3])
            content.clear()
            return answer(0x11, min(at_once, heard.data[3]), 1, 0xFF, 0xFF)
        if heard.pgn != TP_DT:
            return []
        assert heard.data[0] == len(content) // 7 + 1
        content.extend(heard.data[1:])
        if heard.data[0] == state["parts"]:
            whole.append(bytes(content[: state["size"]]))
            return answer(0x13, *state["size"].to_bytes(2, "little"), state["parts"], 0xFF)
        if heard.data[0] % at_once == 0:
            return answer(0x11, min(at_once, state["parts"] - heard.data[0]), heard.data[0] + 1, 0xFF, 0xFF)
        return []

    made.ears.append(ear)
    return whole


@pytest.mark.parametrize(("number", "at_once"), [(3, 255), (40, 255), (40, 1), (445, 16)])
def test_what_one_asks_for_goes_to_that_one(number: int, at_once: int) -> None:
    known = codes(0, previous=number)
    made = at_work(known)
    received = take(made, at_once)
    made.say(request(DM2, TOOL, US, 2.5))
    made.run(20.0)
    assert received == [encode(known.previous, amber=True)]
    assert not [1 for frame in made.log if frame.can_id >> 8 == 0x1CECFF]  # no broadcast
    assert begins(made) == pytest.approx([0.001 + k for k in range(20)], abs=0.012)  # DM1 goes on beside it


def test_who_asks_twice_is_sent_it_once() -> None:
    made = at_work(codes(0, previous=5))
    received = take(made)
    for t in (2.5, 2.51, 2.52):
        made.say(request(DM2, TOOL, US, t))
    made.run(10.0)
    assert len(received) == 1
    assert not answers(made)


def test_who_asks_for_two_at_a_time_or_is_one_too_many_is_asked_to_come_later() -> None:
    made = at_work(codes(5, previous=5))
    askers = [0x80 + k for k in range(CONNECTIONS + 1)]
    for asker in askers:
        made.say(request(DM2, asker, US, 2.5))
    made.say(request(DM1, askers[0], US, 2.6))
    made.run(2.7)
    busy = [(each.data[0], each.data[4], each.data[5:]) for each in answers(made)]
    assert busy == [(3, askers[-1], b"\xcb\xfe\x00"), (3, askers[0], b"\xca\xfe\x00")]
    made.run(10.0)  # nobody takes anything: all are given up
    made.say(request(DM2, askers[-1], US, 10.5))
    made.run(10.6)
    assert made.log[-1].can_id == 0x1CEC0000 | askers[-1] << 8 | US


@pytest.mark.parametrize("pgn", [0xFECC, 0xFEE5, 0xFED3, 0xEF00, 0x1F01D, 0xEA00])
def test_what_is_not_supported_is_refused_to_who_asks_us(pgn: int) -> None:
    """1 = not supported, group function and reserved FF, who asked, and for what, the lowest byte first; to all."""
    made = at_work(codes(0, amber=False))
    made.say(request(pgn, TOOL, US, 1.5))
    made.say(request(pgn, TOOL, GLOBAL, 2.5))
    made.say(request(pgn, TOOL, 0x00, 3.5))
    made.say(request(pgn, NULL, US, 4.5))  # who has no address cannot be told
    made.run(6.0)
    expected = bytes([1, 0xFF, 0xFF, 0xFF, TOOL]) + pgn.to_bytes(3, "little")
    assert answers(made) == [Heard(ACKNOWLEDGEMENT, US, GLOBAL, expected)]
    [frame] = [frame for frame in made.log if frame.data == expected]
    assert frame.can_id == 0x18E8FF3D
    assert frame.t < 1.502


def test_a_request_that_is_too_short_is_none() -> None:
    made = at_work(codes(0))
    made.say(request(0xFEE5, TOOL, US, 1.5)._replace(data=b"\xe5\xfe"))
    made.run(3.0)
    assert not answers(made)


def test_nothing_is_told_before_there_is_an_address() -> None:
    node = Node(name(1), [144])
    made = Bench([node])
    node.know(codes(3), 0.0)
    made.run(1.0)
    assert made.log == []
    node.begin(1.0)
    for pgn in (DM1, DM2, 0xFEE5):
        made.say(request(pgn, TOOL, 144, 1.1))
    made.run(1.2)
    assert {(frame.can_id & 0xFF, frame.can_id >> 16 & 0xFF) for frame in made.log} == {(144, 0xEE), (TOOL, 0xEA)}


def test_what_a_receiver_says_of_another_group_is_not_about_this_one() -> None:
    made = at_work(codes(0, previous=5))
    made.say(request(DM2, TOOL, US, 1.5))
    made.run(1.51)
    for begin in (bytes([0xFF, 2]), bytes([0x11, 3, 1])):
        data = begin.ljust(5, b"\xff") + b"\xca\xfe\x00"
        made.say(Message(TP_CM, data, US, 7).frame(TOOL, 1.6))
    made.run(2.7)
    assert not [1 for frame in made.log if frame.can_id == 0x1CEBF93D]
    made.run(2.8)
    assert [frame.data[0] for frame in made.log if frame.can_id == 0x1CECF93D] == [0x10, 0xFF]  # given up in time


def test_what_others_want_to_send_us_in_parts_is_refused() -> None:
    made = at_work(codes(0))
    made.say(Message(TP_CM, bytes.fromhex("10 14 00 03 FF 00 EF 00"), US, 7).frame(TOOL, 1.5))
    made.run(1.6)
    assert made.log[-1] == Frame(made.log[-1].t, 0x1CECF93D, True, bytes.fromhex("FF 02 FF FF FF 00 EF 00"))


@pytest.mark.parametrize("seed", range(5))
def test_whatever_is_heard_the_node_goes_on(seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311
    made = at_work(codes(5, previous=12))
    for k in range(3000):
        group = chance.choice([0xEA00, 0xEB00, 0xEC00, 0xEE00, 0xE800, 0xFECA, chance.getrandbits(17)])
        data = chance.randbytes(chance.choice([0, 3, 8, 8, 8]))
        if data and chance.random() < 0.5:
            data = bytes([chance.choice([0x10, 0x11, 0x13, 0x20, 0xFF, 0xCA, 0xCB])]) + data[1:]
        if group == 0xEE00 and len(data) == 8:
            data = data[:7] + b"\xff"  # a NAME that is higher than ours
        source = chance.choice([TOOL, 0x00, US, NULL, 255])
        made.say(Message(group, data, chance.choice([US, GLOBAL, 0x11])).frame(source, 1.0 + k / 300))
    made.run(60.0)
    assert (made.nodes[0].status, made.nodes[0].address) == ("claimed", US), f"seed {seed}"
    ours = [frame for frame in made.log if frame.can_id & 0xFF == US and frame.t > 45.0]
    assert {len(decode(data).codes) for t, _, pgn, data in Reader().read(ours) if pgn == DM1} == {5}
