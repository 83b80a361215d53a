"""The place moves in order, whatever the order of the answers, and nothing is left out."""

import random
from collections.abc import Sequence

import pytest

from faultline.service.mqtt.outbox import WINDOW, Outbox, Passed, Publication
from faultline.service.protocol.records import Record


def record(seq: int, size: int = 10) -> Record:
    return Record(id=f"truck-{seq}", seq=seq, schema="faultline.event/1", wall=None, line=b"x" * size)


def event(one: Record) -> Publication:
    return Publication(topic="t/events", payload=one.id.encode(), of=one.id)


def event_and_state(one: Record) -> list[Publication]:
    return [event(one), Publication(topic="t/faults/1", payload=one.id.encode(), of="state", retain=True)]


def send(outbox: Outbox, count: int, first: int = 1) -> list[Publication]:
    """Sends so many parts, with identifiers from `first`."""
    sent = []
    for identifier in range(first, first + count):
        part = outbox.next_part(lambda one: [event(one)])
        assert part is not None
        outbox.sent(identifier, float(identifier))
        sent.append(part)
    return sent


def seqs(passed: Sequence[Passed]) -> list[int]:
    return [each.record.seq for each in passed]


def filled(count: int) -> Outbox:
    outbox = Outbox()
    for seq in range(1, count + 1):
        outbox.add(record(seq))
    return outbox


def test_answers_in_another_order_move_the_place_in_order() -> None:
    outbox = filled(3)
    send(outbox, 3)
    assert seqs(outbox.answered(2)) == []
    assert seqs(outbox.answered(3)) == []
    assert seqs(outbox.answered(1)) == [1, 2, 3]
    assert outbox.next_part(lambda one: [event(one)]) is None
    assert outbox.in_flight == 0


def test_a_record_is_done_once_all_its_parts_are() -> None:
    outbox = filled(1)
    for identifier in (1, 2):
        assert outbox.next_part(event_and_state) is not None
        outbox.sent(identifier, 0.0)
    assert outbox.next_part(event_and_state) is None
    assert seqs(outbox.answered(1)) == []
    assert seqs(outbox.answered(2)) == [1]


def test_after_a_broken_connection_all_that_is_not_done_is_sent_again_in_order() -> None:
    outbox = filled(4)
    send(outbox, 3)
    assert seqs(outbox.answered(1)) == [1]
    assert seqs(outbox.answered(3)) == []  # taken, but what comes before it is not
    outbox.disconnected()
    assert outbox.in_flight == 0
    assert [part.payload for part in send(outbox, 3)] == [b"truck-2", b"truck-3", b"truck-4"]


def test_a_part_that_waits_goes_again_with_its_record() -> None:
    outbox = filled(1)
    assert outbox.next_part(event_and_state) is not None
    outbox.sent(1, 0.0)
    outbox.disconnected()
    parts = []
    for identifier in (2, 3):
        part = outbox.next_part(event_and_state)
        assert part is not None
        parts.append(part.topic)
        outbox.sent(identifier, 0.0)
    assert parts == ["t/events", "t/faults/1"]


def test_after_a_refusal_what_is_in_flight_counts_until_it_is_answered_and_moves_nothing() -> None:
    outbox = filled(3)
    send(outbox, 3)
    outbox.refused(1)
    assert outbox.in_flight == 2
    assert outbox.find(2) == (event(record(2)), False)
    assert outbox.answered(2) == outbox.answered(3) == []
    assert outbox.in_flight == 0
    assert [part.payload for part in send(outbox, 3, first=4)] == [b"truck-1", b"truck-2", b"truck-3"]
    assert seqs([*outbox.answered(4), *outbox.answered(5), *outbox.answered(6)]) == [1, 2, 3]


def test_an_answer_from_before_a_refusal_is_not_one_to_what_is_sent_again() -> None:
    outbox = filled(2)
    send(outbox, 2)
    outbox.refused(1)
    send(outbox, 1, first=3)
    assert outbox.answered(2) == []  # the first try of the second record
    assert seqs(outbox.answered(3)) == [1]


@pytest.mark.parametrize(("part", "given_up"), [(1, True), (2, False)])
def test_a_refused_state_is_no_lost_record(part: int, given_up: bool) -> None:
    outbox = filled(1)
    for identifier in (1, 2):
        outbox.next_part(event_and_state)
        outbox.sent(identifier, 0.0)
    passed = [*outbox.answered(3 - part), *outbox.answered(part, given_up=True)]
    assert [each.given_up for each in passed] == [given_up]


def test_what_cannot_be_sent_is_given_up_in_its_turn() -> None:
    outbox = filled(2)
    send(outbox, 1)
    outbox.next_part(lambda one: [event(one)])
    assert outbox.give_up_next() == []
    assert [(each.record.seq, each.given_up) for each in outbox.answered(1)] == [(1, False), (2, True)]


def test_states_besides_move_nothing() -> None:
    outbox = filled(1)
    outbox.sent_besides(7, event(record(1)), 3.0)
    assert (outbox.in_flight, outbox.oldest) == (1, 3.0)
    assert outbox.answered(7) == []
    assert outbox.answered(7) == []  # twice, or one that nobody sent
    assert outbox.next_part(lambda one: [event(one)]) is not None


def test_the_oldest_in_flight_is_known() -> None:
    outbox = filled(3)
    assert outbox.oldest is None
    send(outbox, 3)
    outbox.answered(1)
    assert outbox.oldest == 2.0


def test_there_is_room_for_so_many_records_and_bytes() -> None:
    outbox = filled(WINDOW - 1)
    room = [outbox.has_room]
    outbox.add(record(WINDOW))
    room.append(outbox.has_room)
    send(outbox, 1)
    room.append(outbox.has_room)  # what is in flight is held, too
    outbox.answered(1)
    room.append(outbox.has_room)
    outbox.add(record(WINDOW + 1, size=1 << 20))
    room.append(outbox.has_room)
    assert room == [True, False, False, True, False]


@pytest.mark.parametrize("seed", range(20))
def test_by_chance_every_record_is_done_once_and_none_without_an_answer(seed: int) -> None:
    """A broker that takes, refuses, is silent and hangs up as it likes, over 300 records of one to three parts."""
    chance = random.Random(seed)  # noqa: S311
    outbox = Outbox()
    parts = {seq: chance.choice([1, 1, 2, 3]) for seq in range(1, 301)}
    taken: set[tuple[int, int]] = set()
    flying: dict[int, tuple[int, int]] = {}
    done: list[int] = []
    identifier, added = 0, 0

    def parts_of(one: Record) -> list[Publication]:
        return [Publication(topic=f"t/{k}", payload=str(one.seq).encode(), of="") for k in range(parts[one.seq])]

    for _ in range(100_000):
        if len(done) == 300:
            break
        if added < 300 and outbox.has_room:
            added += 1
            outbox.add(record(added))
        part = outbox.next_part(parts_of) if outbox.in_flight < 20 else None
        if part is not None:
            identifier += 1
            outbox.sent(identifier, 0.0)
            flying[identifier] = int(part.payload), int(part.topic.removeprefix("t/"))
        what = chance.random()
        if what < 0.01:
            outbox.disconnected()
            flying.clear()
        elif flying and what < 0.6:
            answered = chance.choice(list(flying))
            about = flying.pop(answered)
            if what < 0.05:
                outbox.refused(answered)
            else:
                taken.add(about)
                done += seqs(outbox.answered(answered))
        assert outbox.in_flight == len(flying)
        assert all((seq, k) in taken for seq in done[-5:] for k in range(parts[seq]))
    assert done == list(range(1, 301))
