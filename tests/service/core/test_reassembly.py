"""Messages that come in parts: what is put together, what is not and why, against a straightforward model."""

from collections import Counter
from itertools import accumulate, pairwise
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.core.j1939.dm1 import decode
from faultline.service.core.j1939.identifiers import DM1, GLOBAL, TP_CM, TP_DT, group_of, identifier_of
from faultline.service.core.j1939.transport import LARGEST, SESSIONS, T1_S, T2_S, Reassembler, Whole

GROUP, OTHER = 0xFF10, 0xFEDA
NAMES = {GROUP: "wanted"}


def fresh(most: int = SESSIONS) -> Reassembler:
    return Reassembler(lambda identifier: NAMES.get(group_of(identifier)), most)


class Sent(NamedTuple):
    identifier: int
    data: bytes


def announced(kind: int, pgn: int, payload: bytes, source: int, destination: int = GLOBAL) -> Sent:
    size, count = len(payload).to_bytes(2, "little"), -(-len(payload) // 7)
    data = bytes([kind]) + size + bytes([count, 0xFF]) + pgn.to_bytes(3, "little")
    return Sent(identifier_of(TP_CM, source, destination, 7), data)


def parts(payload: bytes, source: int, destination: int = GLOBAL) -> list[Sent]:
    identifier = identifier_of(TP_DT, source, destination, 7)
    pieces = [payload[k : k + 7].ljust(7, b"\xff") for k in range(0, len(payload), 7)]
    return [Sent(identifier, bytes([number]) + piece) for number, piece in enumerate(pieces, 1)]


def broadcast(payload: bytes, source: int = 0x3D, pgn: int = GROUP) -> list[Sent]:
    return [announced(0x20, pgn, payload, source), *parts(payload, source)]


def answered(kind: int, receiver: int, sender: int, begin: bytes = b"\xff\xff\xff\xff", pgn: int = GROUP) -> Sent:
    return Sent(identifier_of(TP_CM, receiver, sender, 7), bytes([kind]) + begin + pgn.to_bytes(3, "little"))


def taken(reassembler: Reassembler, sent: list[Sent], begin_s: float = 0.0, step_s: float = 0.05) -> list[Whole]:
    found = [reassembler.take(begin_s + step_s * k, *each) for k, each in enumerate(sent)]
    return [each for each in found if each is not None]


@pytest.mark.parametrize("size", [9, 14, 15, 100, LARGEST])
def test_a_broadcast_is_put_together_with_its_last_part(size: int) -> None:
    payload = bytes(k % 251 for k in range(size))
    reassembler = fresh()
    sent = broadcast(payload)
    assert taken(reassembler, sent[:-1]) == []
    assert len(reassembler) == 1
    assert reassembler.unfinished == {"wanted": 1}
    assert reassembler.take(0.05 * len(sent), *sent[-1]) == Whole(identifier_of(GROUP, 0x3D), payload)
    assert (len(reassembler), reassembler.complete, reassembler.losses) == (0, {"wanted": 1}, {})


def test_a_real_trucks_trouble_codes() -> None:
    reassembler = Reassembler(lambda identifier: "DM1" if group_of(identifier) == DM1 else None)
    lines = ["20 0e 00 02 ff ca fe 00", "01 43 ff bf 00 09 08 54", "02 00 09 08 ed 14 1f 01"]
    frames = [Sent(0x1CECFF00, bytes.fromhex(lines[0])), *(Sent(0x1CEBFF00, bytes.fromhex(line)) for line in lines[1:])]
    [whole] = taken(reassembler, frames)
    assert whole == Whole(0x00FECA00, bytes.fromhex("43ff bf000908 54000908 ed141f01"))
    found = decode(whole.data)
    assert (found.lamps.malfunction, found.lamps.red, found.lamps.amber, found.lamps.protect) == (1, 0, 0, 3)
    assert [(code.spn, code.fmi, code.oc) for code in found.codes] == [(191, 9, 8), (84, 9, 8), (5357, 31, 1)]


def test_an_addressed_one_is_put_together_as_its_receiver_clears_it() -> None:
    payload = bytes(range(30))
    sent = parts(payload, 0x3D, 0xF9)
    talk = [
        announced(0x10, GROUP, payload, 0x3D, 0xF9),
        answered(0x11, 0xF9, 0x3D, bytes([3, 1, 0xFF, 0xFF])),
        *sent[:3],
        answered(0x11, 0xF9, 0x3D, bytes([0, 0xFF, 0xFF, 0xFF])),  # wait
        answered(0x11, 0xF9, 0x3D, bytes([3, 3, 0xFF, 0xFF])),  # the third once more, and the others
        *sent[2:],
        answered(0x13, 0xF9, 0x3D),
    ]
    reassembler = fresh()
    assert taken(reassembler, talk) == [Whole(identifier_of(GROUP, 0x3D), payload)]
    assert not reassembler.losses


def test_a_group_with_a_destination_keeps_it() -> None:
    reassembler = Reassembler(lambda identifier: "addressed" if group_of(identifier) == 0xEF00 else None)
    payload = bytes(9)
    sent = [announced(0x10, 0xEF00, payload, 0x3D, 0xF9), *parts(payload, 0x3D, 0xF9)]
    assert taken(reassembler, sent) == [Whole(0x00EFF93D, payload)]


def test_messages_of_several_senders_interleave() -> None:
    one, two, three = bytes(range(20)), bytes(range(100, 120)), bytes(range(200, 220))
    rows = zip(broadcast(one, 1), broadcast(two, 2), broadcast(three, 2 + 1, OTHER), strict=True)
    reassembler = fresh()
    found = taken(reassembler, [each for row in rows for each in row])
    assert found == [Whole(identifier_of(GROUP, 1), one), Whole(identifier_of(GROUP, 2), two)]


CASES: dict[str, tuple[list[Sent], dict[tuple[str, str], int]]] = {}
PAYLOAD = bytes(range(21))
_FRAMES = broadcast(PAYLOAD)
_ASKED = [announced(0x10, GROUP, PAYLOAD, 0x3D, 0xF9), *parts(PAYLOAD, 0x3D, 0xF9)]
CASES["a part is lost"] = [*_FRAMES[:2], _FRAMES[3]], {("wanted", "lost"): 1}
CASES["parts are exchanged"] = [_FRAMES[0], _FRAMES[2], _FRAMES[1], _FRAMES[3]], {("wanted", "lost"): 1}
CASES["another one begins"] = [*_FRAMES[:2], *broadcast(bytes(9), pgn=OTHER)], {("wanted", "restarted"): 1}
CASES["it is broken off"] = [*_FRAMES[:2], answered(0xFF, 0x3D, GLOBAL), *_FRAMES[2:]], {("wanted", "aborted"): 1}
CASES["its receiver breaks it off"] = [*_ASKED[:2], answered(0xFF, 0xF9, 0x3D), *_ASKED[2:]], {("wanted", "aborted"): 1}
CASES["acknowledged, though not all is here"] = [*_ASKED[:3], answered(0x13, 0xF9, 0x3D)], {("wanted", "lost"): 1}
CASES["parts that were missed are cleared past"] = (
    [*_ASKED[:2], answered(0x11, 0xF9, 0x3D, bytes([1, 3, 0xFF, 0xFF])), _ASKED[3]],
    {("wanted", "lost"): 1},
)
CASES["a wrong number of parts"] = (
    [Sent(_FRAMES[0].identifier, bytes([0x20, 21, 0, 9, 255]) + GROUP.to_bytes(3, "little")), *_FRAMES[1:]],
    {("wanted", "malformed"): 1},
)
CASES["to all, though asked for"] = [announced(0x10, GROUP, PAYLOAD, 0x3D), *_FRAMES[1:]], {("wanted", "malformed"): 1}
CASES["too small for parts"] = broadcast(bytes(8)), {("wanted", "malformed"): 1}
CASES["a part is cut"] = (
    [*_FRAMES[:2], Sent(_FRAMES[2].identifier, _FRAMES[2].data[:5]), _FRAMES[3]],
    {("wanted", "malformed"): 1},
)
CASES["parts of nothing"] = _FRAMES[1:], {}
CASES["a control message that is cut"] = [Sent(_FRAMES[0].identifier, _FRAMES[0].data[:6]), *_FRAMES[1:]], {}
CASES["an empty part"] = [*_FRAMES[:2], Sent(_FRAMES[2].identifier, b""), *_FRAMES[2:]], {("wanted", "lost"): 1}


@pytest.mark.parametrize("what", CASES)
def test_what_is_not_whole_is_not_taken_and_counted_with_its_reason(what: str) -> None:
    sent, losses = CASES[what]
    reassembler = fresh()
    assert taken(reassembler, sent) == []
    assert dict(reassembler.losses) == losses
    assert len(reassembler) == 0
    [whole] = taken(reassembler, _FRAMES, 100.0)
    assert whole.data == PAYLOAD


def test_what_a_gateway_repeats_counts_once() -> None:
    reassembler = fresh()
    sent = broadcast(PAYLOAD)
    assert taken(reassembler, [sent[0], *(each for part in sent[1:] for each in (part, part))])
    assert not reassembler.losses
    asked = [_ASKED[0], _ASKED[0], *_ASKED[1:]]
    assert taken(reassembler, asked, 10.0)
    assert not reassembler.losses


@pytest.mark.parametrize(("sent", "limit_s"), [(_FRAMES, T1_S), (_ASKED, T2_S)])
@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_parts_may_be_late_by_so_much_of_real_time(sent: list[Sent], limit_s: float, speed: float) -> None:
    for gap_s, comes in ((0.99 * limit_s, True), (1.01 * limit_s, False)):
        reassembler = fresh()
        reassembler.speed = speed
        assert bool(taken(reassembler, sent, step_s=gap_s * speed)) == comes
        assert dict(reassembler.losses) == ({} if comes else {("wanted", "timeout"): 1})


def test_no_more_than_so_many_are_open() -> None:
    reassembler = fresh(4)
    for source in range(6):
        reassembler.take(0.01 * source, *broadcast(PAYLOAD, source)[0])
    assert len(reassembler) == 4
    assert reassembler.losses == {("wanted", "crowded out"): 2}
    assert taken(reassembler, parts(PAYLOAD, 0), 0.1) == []
    assert taken(reassembler, parts(PAYLOAD, 5), 0.3)
    for source in range(10, 14):
        reassembler.take(20.0, *broadcast(PAYLOAD, source)[0])
    assert reassembler.losses["wanted", "timeout"] == 3


def test_a_new_log_begins_with_nothing_open() -> None:
    reassembler = fresh()
    assert taken(reassembler, _FRAMES[:3], 50.0) == []
    assert taken(reassembler, _FRAMES[3:], 0.0) == []
    assert reassembler.losses == {("wanted", "timeout"): 1}


class Step(NamedTuple):
    gap_s: float
    sent: Sent


@st.composite
def traffic(draw: st.DrawFn) -> list[Step]:
    """Broadcasts of a few senders, interleaved; frames lost, doubled, exchanged and late."""
    queues: list[list[Sent]] = []
    for source in range(draw(st.integers(1, 3))):
        queue: list[Sent] = []
        for _ in range(draw(st.integers(1, 3))):
            payload = draw(st.binary(min_size=9, max_size=30))
            queue += broadcast(payload, source, draw(st.sampled_from([GROUP, GROUP, OTHER])))
        queues.append(queue)
    sent: list[Sent] = []
    while any(queues):
        queue = draw(st.sampled_from([each for each in queues if each]))
        frame = queue.pop(0)
        fate = draw(st.sampled_from(["whole"] * 12 + ["lost", "doubled", "swapped"]))
        if fate != "lost":
            sent.append(frame)
        if fate == "doubled":
            sent.append(frame)
        if fate == "swapped" and len(sent) > 1:
            sent[-2:] = sent[:-3:-1]
    return [Step(draw(st.sampled_from([0.05] * 9 + [0.8])), each) for each in sent]


def model(steps: list[Step], source: int) -> tuple[list[Whole], int]:
    """The whole messages of one sender, and how many of its wanted announcements did not become one.

    All frames of the sender are cut at its announcements. A message is whole if the frames behind its own, repetitions
    apart, begin with 1 to n in order, none of them late. An announcement that is only repeated is none of its own.
    """
    times = accumulate(gap_s for gap_s, _ in steps)
    own = [(t, sent) for t, (_, sent) in zip(times, steps, strict=True) if sent.identifier & 0xFF == source]
    begins = [k for k, (_, sent) in enumerate(own) if group_of(sent.identifier) == TP_CM]
    runs = [own[begin:end] for begin, end in pairwise([*begins, len(own)])]
    wholes, lost = list[Whole](), 0
    for run, after in zip(runs, [*runs, []][1:], strict=True):
        begun_s, announcement = run[0]
        if int.from_bytes(announcement.data[5:8], "little") != GROUP:
            continue
        kept = _in_order(run)
        if len(kept) == announcement.data[3]:
            size = int.from_bytes(announcement.data[1:3], "little")
            wholes.append(Whole(identifier_of(GROUP, source), b"".join(each.data[1:] for each in kept)[:size]))
        elif not (len(run) == 1 and after and after[0][1] == announcement and after[0][0] - begun_s <= T1_S):
            lost += 1
    return wholes, lost


def _in_order(run: list[tuple[float, Sent]]) -> list[Sent]:
    """The parts behind an announcement that come in their order and in time; repetitions once."""
    last_s, before = run[0]
    kept: list[Sent] = []
    for t, sent in run[1:]:
        if len(kept) == run[0][1].data[3] or t - last_s > T1_S:
            break
        if sent != before and sent.data[0] != len(kept) + 1:
            break
        if sent != before:
            kept.append(sent)
            last_s, before = t, sent
    return kept


@given(traffic())
def test_what_is_put_together_is_what_a_simple_model_finds(steps: list[Step]) -> None:
    reassembler, t = fresh(), 0.0
    found: Counter[int] = Counter()
    wholes: dict[int, list[Whole]] = {}
    for gap_s, sent in steps:
        t += gap_s
        whole = reassembler.take(t, *sent)
        if whole is not None:
            wholes.setdefault(whole.identifier & 0xFF, []).append(whole)
            found[whole.identifier & 0xFF] += 1
    lost = sum(reassembler.losses.values()) + sum(reassembler.unfinished.values())
    expected = [model(steps, source) for source in range(3)]
    assert wholes == {source: each for source, (each, _) in enumerate(expected) if each}
    assert lost == sum(count for _, count in expected)
    assert reassembler.complete.total() == found.total()


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 2.0),
            st.sampled_from([0x1CECFF00, 0x1CEBFF00, 0x1CECF900, 0x1CEB00F9]),
            st.binary(max_size=8),
        )
    )
)
def test_no_frames_break_it(frames: list[tuple[float, int, bytes]]) -> None:
    reassembler, t = Reassembler(lambda _identifier: "any", 3), 0.0
    for gap_s, identifier, data in frames:
        t += gap_s
        reassembler.take(t, identifier, data)
    assert len(reassembler) <= 3


def test_a_time_before_the_last_loses_what_is_open_for_want_of_more() -> None:
    sent, reassembler = broadcast(bytes(20)), fresh()
    taken(reassembler, sent[:2], begin_s=-50.0)
    assert reassembler.losses == {}
    reassembler.take(-60.0, *sent[0])
    assert reassembler.losses == {("wanted", "timeout"): 1}
    assert (len(reassembler), reassembler.not_whole()) == (
        1,
        ["1 wanted in parts (timeout)", "1 wanted in parts (cut off by the end)"],
    )


def test_each_announcement_that_makes_no_sense_is_counted() -> None:
    reassembler, payload = fresh(), bytes(20)
    right = announced(0x20, GROUP, payload, 0x3D)
    for size, count in ((20, 4), (20, 2), (8, 2), (0, 0), (LARGEST + 1, 256 & 0xFF)):
        data = bytes([0x20]) + size.to_bytes(2, "little") + bytes([count]) + right.data[4:]
        reassembler.take(0.0, right.identifier, data)
    to_one = announced(0x20, GROUP, payload, 0x3D, 0xF9)
    reassembler.take(0.0, *to_one)
    assert (reassembler.losses, len(reassembler)) == ({("wanted", "malformed"): 6}, 0)


def test_a_part_that_was_missed_is_lost_and_not_late() -> None:
    """Of an addressed message: its receiver may ask again, and does not."""
    payload, reassembler = bytes(range(30)), fresh()
    taken(reassembler, [announced(0x10, GROUP, payload, 0x3D, 0xF9)])
    first, _, third, *_ = parts(payload, 0x3D, 0xF9)
    assert taken(reassembler, [first, third], begin_s=0.1) == []
    assert reassembler.losses == {}
    reassembler.take(0.2 + 2.0 * T2_S, *third)
    assert reassembler.losses == {("wanted", "lost"): 1}
    taken(reassembler, [announced(0x10, GROUP, payload, 0x3D, 0xF9), first], begin_s=20.0)
    reassembler.take(21.0 + 2.0 * T2_S, *third)
    assert reassembler.losses == {("wanted", "lost"): 1, ("wanted", "timeout"): 1}


def test_the_one_that_is_due_first_is_crowded_out() -> None:
    reassembler = fresh(most=2)
    for k, source in enumerate((0x33, 0x22, 0x11)):
        reassembler.take(0.1 * k, *announced(0x20, GROUP, bytes(20), source))
    assert reassembler.losses == {("wanted", "crowded out"): 1}
    for k, (source, whole) in enumerate([(0x33, 0), (0x22, 1), (0x11, 1)]):
        assert len(taken(reassembler, parts(bytes(20), source), begin_s=0.3 + 0.05 * k, step_s=0.01)) == whole


def test_an_empty_part_is_none_and_a_short_last_one_is_not_whole() -> None:
    payload, reassembler = bytes(range(1, 17)), fresh()
    [announcement, first, second, last] = broadcast(payload)
    taken(reassembler, [announcement, first, second])
    assert reassembler.take(0.3, last.identifier, last.data[:2]) is None
    assert reassembler.losses == {("wanted", "malformed"): 1}
    taken(reassembler, [announcement, first], begin_s=1.0)
    reassembler.take(1.2, first.identifier, b"")
    assert reassembler.losses == {("wanted", "malformed"): 1, ("wanted", "lost"): 1}


def test_a_last_part_that_is_repeated_with_what_fills_it_is_a_repetition() -> None:
    """Of two parts of 9 bytes: the second has 2 of the message, and whatever behind them."""
    payload, reassembler = bytes(range(1, 24)), fresh()
    sent = broadcast(payload)
    taken(reassembler, sent[:3])
    again = Sent(sent[2].identifier, sent[2].data)
    assert taken(reassembler, [again, *sent[3:]], begin_s=0.2) == [Whole(identifier_of(GROUP, 0x3D), payload)]
    assert reassembler.losses == {}
