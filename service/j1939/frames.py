"""Messages of SAE J1939-21 as a node sends and hears them, in one frame each."""

from typing import NamedTuple

from faultline.service.core.j1939.identifiers import FRAME, GLOBAL, address_of, identifier_of
from faultline.service.logs import Frame

PRIORITY, TP_PRIORITY = 6, 7
"""Default of requests, acknowledgements, claims and diagnostics; and of what carries a message in parts."""

_EXTENDED_PAGE = 1 << 25  # identifiers of ISO 15765-3, which are not J1939's


class Message(NamedTuple):
    """What is to be sent, by whatever address is ours; at most `FRAME` bytes."""

    pgn: int
    data: bytes
    destination: int = GLOBAL
    priority: int = PRIORITY

    def frame(self, source: int, t: float) -> Frame:
        """The frame that carries it, `t` [s]."""
        return Frame(t, identifier_of(self.pgn, source, self.destination, self.priority), True, self.data)


class Heard(NamedTuple):
    """What a frame says; `destination` is `GLOBAL` where the group addresses all."""

    pgn: int
    source: int
    destination: int
    data: bytes


def parse(frame: Frame) -> Heard | None:
    """What a frame says; None of an 11-bit one, of more than 8 bytes, and of one that is not J1939's."""
    if not frame.is_extended or frame.can_id & _EXTENDED_PAGE or len(frame.data) > FRAME:
        return None
    return Heard(*address_of(frame.can_id), frame.data)


def pgn_bytes(pgn: int) -> bytes:
    """The group's number as it stands in requests and in what announces parts: three bytes, the lowest first."""
    return pgn.to_bytes(3, "little")
