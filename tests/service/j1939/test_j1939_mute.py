"""A bus that takes nothing: it listens only, nobody is there, or it is gone."""

import random

import pytest
from j1939_bench import US, Bench, apart, at_work, codes, dm1s, name

from faultline.service.core.j1939.identifiers import ADDRESS_CLAIMED
from faultline.service.j1939.echo import PATIENCE_S
from faultline.service.j1939.frames import Message
from faultline.service.j1939.node import LONGEST_RETRY_S, RETRY_S, Node
from faultline.service.logs import Frame


def status(node: Node) -> str:
    return node.status


def test_on_a_bus_that_takes_nothing_only_a_claim_is_tried_now_and_then() -> None:
    """It listens only, or nobody is there: what comes back of what was sent says so."""
    node = Node(name(1), [144])
    made = Bench([node], deaf=True)
    sent: list[tuple[float, int]] = []
    frames = node.frames

    def watched(now: float) -> list[Frame]:
        out = frames(now)
        sent.extend((now, frame.can_id) for frame in out)
        return out

    node.frames = watched  # type: ignore[method-assign]
    node.begin(0.0)
    node.know(codes(3), 0.0)
    made.run(PATIENCE_S - 0.001)
    assert status(node) == "claiming"
    made.run(PATIENCE_S)
    assert status(node) == "mute"
    made.run(300.0)
    assert {can_id for _, can_id in sent} == {0x18EEFF90}
    times = [t for t, _ in sent]
    between = apart(times)
    assert between[:5] == pytest.approx([PATIENCE_S + RETRY_S, 10.0, 20.0, 40.0, LONGEST_RETRY_S])
    assert max(between) == pytest.approx(LONGEST_RETRY_S)
    made.deaf = False
    made.run(made.now + LONGEST_RETRY_S + 1.0)
    assert status(node) == "claimed"
    assert dm1s(made)


def test_a_bus_that_takes_nothing_any_more_is_noticed() -> None:
    """As when the other devices go to sleep: nobody acknowledges."""
    made = at_work(codes(3))
    made.run(5.4)
    made.deaf = True
    made.run(5.4 + 1.0 + PATIENCE_S)
    assert status(made.nodes[0]) == "mute"
    made.deaf = False
    made.run(60.0)
    assert status(made.nodes[0]) == "claimed"
    back = next(t for t, _ in dm1s(made, 5.4))
    assert 11.0 < back < 13.0


def test_what_had_waited_in_the_controller_says_that_the_bus_is_back() -> None:
    """A controller goes on trying the frame it has: once somebody acknowledges it, the claim comes at once."""
    node = Node(name(1), [144])
    made = Bench([node], deaf=True)
    node.begin(0.0)
    node.know(codes(0), 0.0)
    made.run(1.0)
    [waiting] = [Message(ADDRESS_CLAIMED, name(1).to_bytes(8, "little")).frame(144, 2.0)]
    made.deaf = False
    made.say(waiting)
    made.run(2.4)
    assert status(node) == "claimed"
    assert not node.has_twin


def test_frames_of_which_some_do_not_come_back_are_no_reason_to_stop() -> None:
    """A receive queue may overflow."""
    chance = random.Random(4)  # noqa: S311
    node = Node(name(1), [US])
    made = Bench([node], lost=lambda _: chance.random() < 0.3 and made.now > 0.1)
    node.begin(0.0)
    node.know(codes(32), 0.0)
    made.run(120.0)
    assert status(node) == "claimed"


def test_a_bus_that_goes_and_comes_is_claimed_anew() -> None:
    made = at_work(codes(2))
    made.run(3.02)
    made.nodes[0].end()
    made.run(9.0)
    assert status(made.nodes[0]) == "waiting"
    assert max(frame.t for frame in made.log) < 3.03
    made.nodes[0].begin(9.0)
    made.run(9.2)
    assert [frame.can_id for frame in made.log if frame.t > 9.0] == [0x18EEFF3D, 0x1CECFF3D, 0x1CEBFF3D, 0x1CEBFF3D]


def test_what_was_sent_before_the_bus_went_is_not_waited_for() -> None:
    node = Node(name(1), [144])
    made = Bench([node], deaf=True)
    node.begin(0.0)
    made.run(0.5)
    node.end()
    made.run(30.0)
    assert status(node) == "waiting"
