"""Quality of a received signal: a value with its quality, never a number alone."""

from enum import IntEnum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Qualities = npt.NDArray[np.int8]
Indices = npt.NDArray[np.intp]


class Quality(IntEnum):
    """Quality of a value: only `GOOD` is a number to compute with.

    `NOT_AVAILABLE`, `ERROR` and `RESERVED` are the sender's own words (SAE J1939-71 value ranges), `ERROR` also for a
    floating-point number that is none; `OUT_OF_RANGE` is beyond what the DBC allows. `MISSING` has never been received,
    `LATE` not for longer than is useful. `FROZEN` and `JUMP` are numbers that no sensor of the kind gives: one that has
    not changed for longer, or is further from those before, than was ever seen without a fault.
    `DOUBTED` is one of more than one sender: nobody knows whose.
    """

    GOOD = 0
    MISSING = 1
    NOT_AVAILABLE = 2
    ERROR = 3
    RESERVED = 4
    OUT_OF_RANGE = 5
    LATE = 6
    FROZEN = 7
    JUMP = 8
    DOUBTED = 9


_GOOD = int(Quality.GOOD)


def are_good(qualities: Qualities) -> Mask:
    """Return which are `GOOD`, whatever the shape: as a plain number, as comparing with an enum's costs 5 us."""
    return np.asarray(qualities == _GOOD)


def j1939_quality(raw: int, length: int) -> Quality:
    """Return the quality that a J1939 raw value of `length` bits states (SAE J1939-71, transmitted signal ranges).

    From 8 bits on the most significant byte decides: FF not available, FE error, FB to FD reserved. Shorter fields use
    all ones for not available and all ones less one for error; a single bit has room for neither.

    >>> j1939_quality(0xFFFF, 16).name, j1939_quality(0xFE00, 16).name, j1939_quality(0xFAFF, 16).name
    ('NOT_AVAILABLE', 'ERROR', 'GOOD')
    >>> j1939_quality(3, 2).name, j1939_quality(1, 1).name
    ('NOT_AVAILABLE', 'GOOD')
    """
    if length < 8:
        top = (1 << length) - 1
        if length > 1 and raw >= top - 1:
            return Quality.NOT_AVAILABLE if raw == top else Quality.ERROR
        return Quality.GOOD
    byte = raw >> (length - 8)
    if byte < 0xFB:
        return Quality.GOOD
    return {0xFF: Quality.NOT_AVAILABLE, 0xFE: Quality.ERROR}.get(byte, Quality.RESERVED)
