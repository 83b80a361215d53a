"""A bus in simulated time: nodes are asked when they say that they are due, and at no other time."""

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count, pairwise
from math import inf

from faultline.service.core.j1939.dm1 import Code
from faultline.service.core.j1939.identifiers import ACKNOWLEDGEMENT, DM1, TP_CM, TP_DT
from faultline.service.j1939.dtcs import Known
from faultline.service.j1939.frames import Heard, Message, parse
from faultline.service.j1939.name import name_of
from faultline.service.j1939.node import Node
from faultline.service.logs import Frame

FRAME_S = 0.0005
"""A frame of 131 bits on a bus of 250 kbit/s."""
SPINS = 1000  # turns of one moment: more is a node that is due for nothing


def name(identity: int, *, arbitrary: bool = False) -> int:
    """The lower identity wins; who may take another address loses against all who may not."""
    return name_of(identity_number=identity, manufacturer_code=5, function=7, arbitrary_address_capable=arbitrary)


def codes(number: int, *, amber: bool = True, previous: int = 0) -> Known:
    """So many active codes, from SPN 1000 on, and previous ones from SPN 2000 on."""
    active = tuple(Code(1000 + k, 1, 1) for k in range(number))
    return Known(active, tuple(Code(2000 + k, 2, 3) for k in range(previous)), amber)


@dataclass
class Bench:
    """Delivers what any node sends to all of them, the sender too, and to `ears`, who may answer.

    `deaf`: nothing that is sent is transmitted.
    """

    nodes: list[Node]
    now: float = 0.0
    deaf: bool = False
    log: list[Frame] = field(default_factory=list)
    ears: list[Callable[[Frame], list[Frame]]] = field(default_factory=list)
    _queue: list[tuple[float, int, Frame]] = field(default_factory=list)
    _busy: float = 0.0
    _numbers: "count[int]" = field(default_factory=count)
    lost: Callable[[Frame], bool] = lambda _: False

    def say(self, frame: Frame) -> None:
        """Somebody else sends this frame at its time."""
        heapq.heappush(self._queue, (frame.t, next(self._numbers), frame))

    def run(self, until: float) -> None:
        """Goes on to that time [s]."""
        spins, before = 0, -1.0
        while True:
            dues = [due for node in self.nodes if (due := node.due) is not None]
            at = min([*dues, *(t for t, *_ in self._queue[:1])], default=inf)
            if at > until:
                self.now = until
                return
            self.now = max(self.now, at)
            spins = spins + 1 if self.now == before else 0
            before = self.now
            assert spins < SPINS, f"due at {dues} of {self.now} for nothing"
            self._deliver()
            for node in self.nodes:
                for frame in node.frames(self.now):
                    self._busy = max(self.now, self._busy) + FRAME_S
                    if not self.deaf:
                        self.say(frame._replace(t=self._busy))

    def heard(self, since: float = 0.0) -> "list[tuple[float, int, int, bytes]]":
        """Time, source, group and data of all single frames and reassembled broadcasts."""
        return [each for each in Reader().read(self.log) if each[0] >= since]

    def _deliver(self) -> None:
        while self._queue and self._queue[0][0] <= self.now:
            _, _, frame = heapq.heappop(self._queue)
            self.log.append(frame)
            if self.lost(frame):
                continue
            for node in self.nodes:
                node.hear(frame, self.now)
            for ear in self.ears:
                for answer in ear(frame):
                    self.say(answer)


class Reader:
    """Reassembles broadcasts; asserts what a strict receiver demands: order, gaps, size and filling.

    `gap_s`: between parts, at least and at most; others than a receiver's, where a busy machine may hold up who sends:
    one part is late then, and the next one is not.
    """

    def __init__(self, gap_s: tuple[float, float] = (0.048, 0.2)) -> None:
        self._gap_s = gap_s
        self._open: dict[int, tuple[int, int, int, bytes, float]] = {}

    def read(self, frames: list[Frame]) -> list[tuple[float, int, int, bytes]]:
        told = []
        for frame in frames:
            heard = parse(frame)
            assert heard is not None
            if heard.pgn == TP_CM and heard.data[0] == 0x20:
                assert heard.source not in self._open, "a broadcast began before the last one had ended"
                size, parts = int.from_bytes(heard.data[1:3], "little"), heard.data[3]
                assert (parts, heard.data[4]) == (-(-size // 7), 0xFF)
                pgn = int.from_bytes(heard.data[5:], "little")
                self._open[heard.source] = (pgn, size, 1, b"", frame.t)
            elif heard.pgn == TP_DT and heard.destination == 255:
                pgn, size, number, content, before = self._open.pop(heard.source)
                assert heard.data[0] == number
                assert self._gap_s[0] <= frame.t - before <= self._gap_s[1], f"{frame.t - before} s between parts"
                content += heard.data[1:]
                if len(content) < size:
                    self._open[heard.source] = (pgn, size, number + 1, content, frame.t)
                else:
                    assert set(content[size:]) <= {0xFF}
                    told.append((frame.t, heard.source, pgn, content[:size]))
            else:
                told.append((frame.t, heard.source, heard.pgn, heard.data))
        return told


def request(pgn: int, asker: int, to: int, t: float) -> Frame:
    """A request for a group, `t` [s]."""
    return Message(0xEA00, pgn.to_bytes(3, "little"), to).frame(asker, t)


def claim(address: int, name: int, t: float) -> Frame:
    """Another device's claim."""
    return Message(0xEE00, name.to_bytes(8, "little")).frame(address, t)


US, TOOL = 0x3D, 0xF9
"""Addresses: of a node that is at work at once, and of who asks it."""


def at_work(known: Known | None = None) -> Bench:
    """A bus with one node, at work from the first millisecond on."""
    node = Node(name(1), [US])
    made = Bench([node])
    node.begin(0.0)
    node.know(known, 0.0)
    return made


def dm1s(made: Bench, since: float = 0.0) -> list[tuple[float, bytes]]:
    """When each DM1 was whole, and what it said."""
    return [(t, data) for t, _, pgn, data in made.heard(since) if pgn == DM1]


def begins(made: Bench) -> list[float]:
    """When each DM1 began, single or in parts."""
    heard = [(frame.t, parse(frame)) for frame in made.log]
    return [t for t, each in heard if each is not None and (each.pgn == DM1 or _announces(each))]


def _announces(heard: Heard) -> bool:
    return heard.pgn == TP_CM and heard.data[0] == 0x20 and heard.data[5:] == b"\xca\xfe\x00"


def answers(made: Bench) -> list[Heard]:
    """The node's acknowledgements."""
    read = [parse(frame) for frame in made.log]
    return [each for each in read if each is not None and each.source == US and each.pgn == ACKNOWLEDGEMENT]


def apart(times: list[float]) -> list[float]:
    """The time between each and the next [s]."""
    return [later - earlier for earlier, later in pairwise(times)]
