"""Requests (PGN 59904) and the acknowledgement (PGN 59392) that refuses one, SAE J1939-21.

A request to one is answered to that one: where the group is not supported, by a refusal. A request to all is answered
to all, or not at all. Acknowledgements go to all; their fifth byte says who asked.
"""

from enum import IntEnum

from faultline.service.core.j1939.identifiers import ACKNOWLEDGEMENT, REQUEST
from faultline.service.j1939.frames import Heard, Message, pgn_bytes

_SIZE = 3


class Refusal(IntEnum):
    """Control byte of an acknowledgement. `BUSY`: not now; ask again later."""

    NOT_SUPPORTED = 1
    BUSY = 3


def wanted(heard: Heard) -> int | None:
    """The group that a request asks for; None if it is no request."""
    if heard.pgn != REQUEST or len(heard.data) < _SIZE:
        return None
    return int.from_bytes(heard.data[:_SIZE], "little")


def refused(refusal: Refusal, pgn: int, asker: int) -> Message:
    """The answer to `asker`, whose request for `pgn` is not met."""
    return Message(ACKNOWLEDGEMENT, bytes([refusal, 0xFF, 0xFF, 0xFF, asker]) + pgn_bytes(pgn))
