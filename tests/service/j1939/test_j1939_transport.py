"""Messages in parts: the broadcast's pace, and what a receiver may ask, delay, lose or refuse."""

import pytest

from faultline.service.core.j1939.identifiers import TP_CM, TP_DT
from faultline.service.j1939.frames import Message
from faultline.service.j1939.transport import (
    GAP_S,
    LONGEST_S,
    PACE_S,
    RETRIES,
    T3_S,
    T4_S,
    Broadcast,
    Connection,
    Parts,
)

PGN, US = 0xFECB, 0xF9
TR_S = 0.2
BYTES = bytes(range(1, 21))  # 20 bytes, 3 parts


def cts(parts: int, first: int) -> bytes:
    return bytes([0x11, parts, first, 0xFF, 0xFF, 0xCB, 0xFE, 0x00])


END = bytes([0x13, 20, 0, 3, 0xFF, 0xCB, 0xFE, 0x00])
ABORT = bytes([0xFF, 2, 0xFF, 0xFF, 0xFF, 0xCB, 0xFE, 0x00])


def aborted(reason: int) -> list[bytes]:
    return [bytes([0xFF, reason, 0xFF, 0xFF, 0xFF, 0xCB, 0xFE, 0x00])]


@pytest.mark.parametrize(
    ("size", "parts", "announced"),
    [
        # 0x20, size 14 = 0E 00, 2 parts, FF, PGN 0x00FECB lowest byte first
        (14, 2, "20 0E 00 02 FF CB FE 00"),
        (9, 2, "20 09 00 02 FF CB FE 00"),
        # 130 bytes, 32 codes: 19 parts; 162, 40 codes: 24
        (130, 19, "20 82 00 13 FF CB FE 00"),
        (162, 24, "20 A2 00 18 FF CB FE 00"),
        (1785, 255, "20 F9 06 FF FF CB FE 00"),
    ],
)
def test_a_broadcast_is_announced_and_cut(size: int, parts: int, announced: str) -> None:
    payload = bytes(k % 251 for k in range(size))
    sent: list[tuple[float, Message]] = []
    broadcast, now = Broadcast(PGN, payload, 5.0), 5.0
    while not broadcast.done:
        assert broadcast.poll(broadcast.due - 1e-6) == []
        now = broadcast.due
        sent += [(now, message) for message in broadcast.poll(now)]
    assert broadcast.due == pytest.approx(now + PACE_S)  # and before that none may begin
    (first, message), *rest = sent
    assert (first, message) == (5.0, Message(TP_CM, bytes.fromhex(announced), 255, 7))
    assert [round(t - 5.0, 6) for t, _ in rest] == [round(0.05 * k, 6) for k in range(1, parts + 1)]
    assert {(part.pgn, part.destination, part.priority, len(part.data)) for _, part in rest} == {(TP_DT, 255, 7, 8)}
    assert [part.data[0] for _, part in rest] == list(range(1, parts + 1))
    content = b"".join(part.data[1:] for _, part in rest)
    assert content == payload + b"\xff" * (7 * parts - size)


def test_times_are_the_standards() -> None:
    assert (GAP_S, T3_S, T4_S) == (0.05, 1.25, 1.05)


def test_parts_are_never_closer_than_the_standard_allows_though_one_was_late() -> None:
    broadcast = Broadcast(PGN, BYTES, 0.0)
    for now in (0.0, 0.05, 0.12):  # the last one is 20 ms late
        assert len(broadcast.poll(now)) == 1
    assert broadcast.due == pytest.approx(0.12 + GAP_S)


@pytest.mark.parametrize("size", [0, 8, 1786])
def test_what_does_not_go_in_parts_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match=f"^{size} bytes do not go in parts"):
        Parts(PGN, bytes(size), 255)


class Talk:
    """A connection in time, and what it has sent."""

    def __init__(self, payload: bytes = BYTES) -> None:
        self.connection = Connection(PGN, payload, US, 0.0)
        self.now = 0.0
        self.asked = self.said()

    def said(self, seconds: float = 0.0) -> list[bytes]:
        """What it sends within that time."""
        end, sent = self.now + seconds, []
        while not self.connection.done and self.connection.due <= end:
            self.now = max(self.now, self.connection.due)
            sent += self.connection.poll(self.now)
        assert {message.destination for message in sent} <= {US}
        self.now = end
        return [message.data for message in sent]

    def hears(self, data: bytes) -> None:
        self.connection.hear(data, self.now)


def parts(*numbers: int) -> list[bytes]:
    whole = BYTES + b"\xff"
    return [bytes([k]) + whole[7 * k - 7 : 7 * k] for k in numbers]


def test_a_receiver_takes_it_all_at_once() -> None:
    talk = Talk()
    assert talk.asked == [bytes.fromhex("10 14 00 03 FF CB FE 00")]  # RTS, 20 bytes, 3 parts, no limit
    assert talk.said(T3_S - 0.001) == []
    talk.hears(cts(3, 1))
    assert talk.said(TR_S) == parts(1, 2, 3)
    talk.hears(END)
    assert talk.said(60.0) == []
    assert talk.connection.done


def test_a_receiver_takes_it_part_by_part() -> None:
    talk = Talk()
    for number in (1, 2, 3):
        talk.hears(cts(1, number))
        assert talk.said(TR_S) == parts(number)
    talk.hears(END)
    assert talk.connection.done


def test_parts_come_within_the_time_that_a_receiver_waits() -> None:
    connection = Connection(PGN, BYTES, US, 0.0)
    connection.poll(0.0)
    connection.hear(cts(3, 1), 1.0)
    times: list[float] = []
    while len(times) < 3:
        times.append(connection.due)
        connection.poll(connection.due)
    assert times == pytest.approx([1.0, 1.0 + PACE_S, 1.0 + 2 * PACE_S])
    assert PACE_S <= TR_S


def test_a_receiver_may_ask_to_wait() -> None:
    talk = Talk()
    for _ in range(5):
        talk.hears(cts(0, 0xFF))
        assert talk.said(T4_S - 0.001) == []
    talk.hears(cts(255, 1))  # more than there are
    assert talk.said(TR_S) == parts(1, 2, 3)
    talk.hears(END)
    assert talk.connection.done


def test_a_receiver_that_asks_to_wait_and_forgets_is_given_up() -> None:
    talk = Talk()
    talk.hears(cts(0, 0xFF))
    assert talk.said(T4_S - 0.001) == []
    assert talk.said(0.002) == aborted(3)
    assert talk.connection.done


def test_a_receiver_that_asks_to_wait_for_ever_is_given_up() -> None:
    talk, said = Talk(), []
    while not talk.connection.done:
        talk.hears(cts(0, 0xFF))
        said += talk.said(1.0)
        assert talk.now <= LONGEST_S + 1.0
    assert said == aborted(3)


@pytest.mark.parametrize("answered", [False, True])
def test_a_receiver_that_does_not_answer_is_given_up(answered: bool) -> None:
    """To the request, and after the last part."""
    talk = Talk()
    if answered:
        talk.hears(cts(3, 1))
        assert talk.said(2 * PACE_S) == parts(1, 2, 3)
    assert talk.said(T3_S - 0.001) == []
    assert talk.said(0.002) == aborted(3)
    assert talk.said(60.0) == []
    assert talk.connection.done
    talk.hears(cts(3, 1))  # too late
    assert talk.said(1.0) == []


def test_a_part_that_was_lost_is_sent_again() -> None:
    talk = Talk()
    talk.hears(cts(3, 1))
    assert talk.said(TR_S) == parts(1, 2, 3)
    talk.hears(cts(1, 2))
    assert talk.said(TR_S) == parts(2)
    talk.hears(cts(2, 2))
    assert talk.said(TR_S) == parts(2, 3)
    talk.hears(END)
    assert talk.connection.done


def test_a_part_that_is_asked_for_again_and_again_ends_it() -> None:
    talk = Talk()
    talk.hears(cts(2, 1))
    assert talk.said(TR_S) == parts(1, 2)
    for _ in range(RETRIES):
        talk.hears(cts(1, 2))
        assert talk.said(TR_S) == parts(2)
    talk.hears(cts(1, 2))
    assert talk.said(TR_S) == aborted(5)
    assert talk.connection.done


@pytest.mark.parametrize("first", [0, 4, 255])
def test_a_part_that_there_is_not_ends_it(first: int) -> None:
    talk = Talk()
    talk.hears(cts(1, first))
    assert talk.said(TR_S) == aborted(7)


def test_going_ahead_while_parts_are_sent_ends_it() -> None:
    talk = Talk()
    talk.hears(cts(3, 1))
    assert talk.said(0.0) == parts(1)
    talk.hears(cts(3, 1))
    assert talk.said(TR_S) == aborted(4)


@pytest.mark.parametrize("cleared", [False, True])
def test_a_receiver_may_end_it_and_is_not_answered(cleared: bool) -> None:
    talk = Talk()
    if cleared:
        talk.hears(cts(3, 1))
        assert talk.said(0.0) == parts(1)
    talk.hears(ABORT)
    assert talk.said(60.0) == []
    assert talk.connection.done


def test_an_answer_from_before_the_question_is_none() -> None:
    connection = Connection(PGN, BYTES, US, 0.0)
    connection.hear(cts(3, 1), 0.0)
    [asked] = connection.poll(0.0)
    assert asked.data[0] == 0x10
    assert connection.poll(1.0) == []
