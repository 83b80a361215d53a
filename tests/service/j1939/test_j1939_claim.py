"""Who gets an address, and what those do that do not."""

import random

import pytest
from j1939_bench import Bench, claim, codes, name, request

from faultline.service.core.j1939.identifiers import ADDRESS_CLAIMED, DM1, GLOBAL, NULL
from faultline.service.j1939.claim import VIOLATED_S, WAIT_S
from faultline.service.j1939.node import Node

LOW, HIGH = name(1), name(2)
TOOL = 0xF9


def claims(bench: Bench, since: float = 0.0) -> list[tuple[int, int]]:
    """Address and NAME of each claim that was on the bus."""
    return [(s, int.from_bytes(d, "little")) for _, s, pgn, d in bench.heard(since) if pgn == ADDRESS_CLAIMED]


def begun(*nodes: Node, at: tuple[float, ...] = ()) -> Bench:
    """All nodes on one bus, each begun at its time, with nothing wrong."""
    bench = Bench(list(nodes))
    for t, node in sorted(zip(at or (0.0,) * len(nodes), nodes, strict=True), key=lambda each: each[0]):
        bench.run(t)
        node.begin(t)
        node.know(codes(0, amber=False), t)
    return bench


@pytest.mark.parametrize("address", [128, 200, 247])
def test_an_address_that_is_taken_dynamically_is_used_after_a_quarter_of_a_second(address: int) -> None:
    bench = begun(Node(LOW, [address]))
    bench.run(WAIT_S)
    assert [frame.can_id for frame in bench.log] == [0x18EEFF00 | address]
    assert bench.nodes[0].status == "claiming"
    bench.run(WAIT_S + 0.002)
    assert [pgn for _, _, pgn, _ in bench.heard()] == [ADDRESS_CLAIMED, DM1]
    assert (bench.nodes[0].status, bench.nodes[0].address) == ("claimed", address)


@pytest.mark.parametrize("address", [0, 0x3D, 127, 248, 253])
def test_an_address_that_is_assigned_is_used_once_the_claim_was_sent(address: int) -> None:
    bench = begun(Node(LOW, [address]))
    bench.run(0.002)
    assert [pgn for _, _, pgn, _ in bench.heard()] == [ADDRESS_CLAIMED, DM1]
    assert bench.log[1].t - bench.log[0].t < 0.002


@pytest.mark.parametrize("order", [(LOW, HIGH), (HIGH, LOW)])
@pytest.mark.parametrize("later", [0.0, 0.1, 0.4, 3.0])
def test_of_two_that_want_one_address_the_lower_name_has_it(order: tuple[int, int], later: float) -> None:
    """Whether the other one comes first, while the first one waits, or after it has long been at work."""
    nodes = [Node(each, [144]) for each in order]
    bench = begun(*nodes, at=(0.0, later))
    bench.run(later + 2.0)
    winner, loser = sorted(nodes, key=lambda node: node._claim.name)
    assert [(each.status, each.address) for each in (winner, loser)] == [("claimed", 144), ("cannot", NULL)]
    assert loser.winner == LOW
    told = claims(bench)
    assert told[-1] == (NULL, HIGH)
    assert told.count((NULL, HIGH)) == 1
    lost = next(frame.t for frame in bench.log if frame.can_id == 0x18EEFFFE)
    last = max(frame.t for frame in bench.log if frame.can_id == 0x18EEFF90)
    assert 0.0 <= lost - last <= 0.155  # a delay that looks random, of 153 ms at most
    after = [source for t, source, pgn, _ in bench.heard() if pgn == DM1 and t > last + 0.01]
    assert set(after) == {144}
    before = [f.data[:4] for f in bench.log if f.can_id == 0x18FECA90 and f.t < later]
    assert len(before) == (3 if later == 3.0 else 1 if later == 0.4 else 0)


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
@pytest.mark.parametrize("later", [0.0, 0.1, 3.0])
def test_who_may_take_another_address_does(order: tuple[int, int], later: float) -> None:
    nodes = [Node(name(each, arbitrary=True), [144, 145]) for each in order]
    bench = begun(*nodes, at=(0.0, later))
    bench.run(later + 2.0)
    winner, loser = sorted(nodes, key=lambda node: node._claim.name)
    assert [(each.status, each.address) for each in (winner, loser)] == [("claimed", 144), ("claimed", 145)]
    assert {source for _, source, pgn, _ in bench.heard(later + 1.0) if pgn == DM1} == {144, 145}
    moved = next(frame.t for frame in bench.log if frame.can_id == 0x18EEFF91)
    first = next(frame.t for frame in bench.log if frame.can_id == 0x18FECA91)
    assert first - moved >= WAIT_S


def test_who_may_not_take_another_address_wins_against_who_may() -> None:
    """The bit is the NAME's highest."""
    nodes = [Node(name(1, arbitrary=True), [144, 145]), Node(name(9), [144])]
    bench = begun(*nodes)
    bench.run(2.0)
    assert [node.address for node in nodes] == [145, 144]


def test_who_may_not_keeps_to_its_first_address() -> None:
    bench = begun(Node(HIGH, [144, 145]))
    bench.say(claim(144, LOW, 1.0))
    bench.run(2.0)
    assert bench.nodes[0].status == "cannot"


def test_addresses_that_others_were_heard_to_have_are_left_out() -> None:
    bench = begun(Node(name(9, arbitrary=True), [144, 145, 146]))
    for address in (145, 144):
        bench.say(claim(address, name(address - 143), 1.0))
    bench.run(2.0)
    assert claims(bench, 1.0001) == [(146, name(9, arbitrary=True))]
    assert bench.nodes[0].address == 146


def test_an_address_whose_owner_has_moved_is_free_again() -> None:
    bench = begun(Node(name(9, arbitrary=True), [144, 145]))
    for t, address in ((0.9, 145), (1.0, 150)):
        bench.say(claim(address, name(3), t))
    bench.say(claim(144, name(1), 1.1))
    bench.run(2.0)
    assert bench.nodes[0].address == 145


def test_an_address_is_defended_each_time() -> None:
    bench = begun(Node(LOW, [144]))
    for k in range(5):
        bench.say(claim(144, HIGH + k, 1.0 + k))
    bench.run(10.0)
    assert claims(bench, 0.9) == [each for k in range(5) for each in ((144, HIGH + k), (144, LOW))]
    assert bench.nodes[0].status == "claimed"
    answers = [frame.t for frame in bench.log if frame.data == LOW.to_bytes(8, "little")][1:]
    assert all(answer - (1.0 + k) < 0.002 for k, answer in enumerate(answers))


def test_a_claim_of_no_interest_changes_nothing() -> None:
    bench = begun(Node(HIGH, [144]))
    bench.say(claim(145, LOW, 1.0))
    bench.say(claim(NULL, LOW, 1.1))
    bench.say(claim(144, LOW, 1.2)._replace(data=LOW.to_bytes(8, "little")[:7]))  # a claim has 8 bytes
    bench.run(2.0)
    assert (bench.nodes[0].status, bench.nodes[0].has_twin) == ("claimed", False)


@pytest.mark.parametrize("to", [GLOBAL, 144])
def test_who_asks_is_told_who_is_there(to: int) -> None:
    bench = begun(Node(LOW, [144]))
    for t, asker in ((0.1, TOOL), (1.0, NULL), (2.0, TOOL)):  # in mid-claim, and from one that has no address yet
        bench.say(request(ADDRESS_CLAIMED, asker, to, t))
    bench.run(3.0)
    told = [frame.t for frame in bench.log if frame.can_id == 0x18EEFF90]
    assert told == pytest.approx([0.0005, 0.1005, 1.0005, 2.0005], abs=1e-6)
    assert bench.nodes[0].status == "claimed"


def test_who_asks_another_one_is_not_told() -> None:
    bench = begun(Node(LOW, [144]))
    bench.say(request(ADDRESS_CLAIMED, TOOL, 145, 1.0))
    bench.run(3.0)
    assert claims(bench) == [(144, LOW)]


def test_who_asks_is_told_that_there_is_no_address() -> None:
    """All answers of this kind have one identifier: none comes without its own delay. A request is for all, then."""
    bench = begun(Node(HIGH, [144]))
    bench.say(claim(144, LOW, 0.1))
    for k in range(20):
        bench.say(request(ADDRESS_CLAIMED, TOOL, GLOBAL, 1.0 + k))
    bench.say(request(ADDRESS_CLAIMED, TOOL, 144, 50.0))
    bench.say(request(ADDRESS_CLAIMED, TOOL, NULL, 51.0))
    bench.run(60.0)
    told = [frame.t for frame in bench.log if frame.can_id == 0x18EEFFFE]
    assert len(told) == 21
    delays = {round(t - 1.0 - k, 4) for k, t in enumerate(told[1:])}
    assert all(0.0 <= delay <= 0.154 for delay in delays)
    assert len(delays) > 10
    assert not [each for each in bench.heard() if each[2] == DM1]


def test_another_device_with_our_name_is_told_and_never_answered() -> None:
    """Neither is the lower one: two that defend themselves would go on for ever."""
    nodes = [Node(LOW, [144]), Node(LOW, [144])]
    bench = begun(*nodes)
    bench.run(9.0)
    assert [node.has_twin for node in nodes] == [True, True]
    assert len(claims(bench)) == 6  # each at first, and twice because the other one uses its address


def test_an_address_that_another_one_uses_unasked_is_claimed_again_now_and_then() -> None:
    bench = begun(Node(LOW, [144]))
    for k in range(100):
        bench.say(request(0xFEE5, 144, GLOBAL, 1.0 + 0.1 * k))
    bench.run(20.0)
    told = [frame.t for frame in bench.log if frame.can_id == 0x18EEFF90]
    assert told == pytest.approx([0.0005, 1.0005, 1.0005 + VIOLATED_S], abs=0.11)


def test_what_was_being_sent_ends_with_the_address() -> None:
    bench = begun(Node(name(9, arbitrary=True), [144, 145]))
    bench.nodes[0].know(codes(32), 0.0)
    bench.say(claim(144, LOW, 0.6))
    bench.run(0.599)
    assert [frame.can_id & 0xFF for frame in bench.log if frame.can_id >> 8 == 0x1CEBFF]  # parts are under way
    bench.run(3.0)
    assert not [frame for frame in bench.log if frame.t > 0.6 and frame.can_id == 0x1CEBFF90]
    assert [frame.can_id for frame in bench.log if frame.t > 0.6][:2] == [0x18EEFF91, 0x1CECFF91]


@pytest.mark.parametrize("seed", range(10))
def test_any_number_of_nodes_share_what_addresses_there_are(seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311
    addresses = list(range(144, 144 + chance.randint(1, 5)))
    names = chance.sample(range(1, 50), chance.randint(2, 7))
    nodes = [Node(name(each, arbitrary=True), addresses) for each in names]
    bench = begun(*nodes, at=tuple(chance.choice([0.0, chance.uniform(0.0, 2.0)]) for _ in nodes))
    bench.run(8.0)
    have = [node.address for node in nodes if node.status == "claimed"]
    assert sorted(have) == addresses[: len(names)], f"seed {seed}"
    lost = [each for each, node in zip(names, nodes, strict=True) if node.status == "cannot"]
    assert len(lost) == max(0, len(names) - len(addresses))
    last = {address: bench.heard(6.0) for address in have}
    assert {source for each in last.values() for _, source, pgn, _ in each if pgn == DM1} == set(have)
