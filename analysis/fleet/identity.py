"""Whose drive, and where: VIN and position as SAE J1939-71 has them in a log's frames, where they are asked for.

They make a drive somebody's. So nothing else in a fleet's tables says them, and a drive that was diagnosed with them is
diagnosed again where they are not asked for any more.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from faultline.service.core.j1939.identifiers import FRAME, TP_CM, TP_DT, group_of
from faultline.service.core.j1939.transport import Reassembler
from faultline.service.logs import Frame, Log

VIN, POSITION = "vin", "position"
KINDS = (VIN, POSITION)

VEHICLE_IDENTIFICATION, VEHICLE_POSITION = 65260, 65267
"""Parameter groups: SPN 237, text that ends with an asterisk; SPN 584 and 585, latitude and longitude."""
DEGREES, SOUTH_WEST = 1e-7, -210.0
"""A number stands for so many degrees each, beginning at this one [deg]."""
LAST_VALID = 0xFAFFFFFF
"""Numbers above it stand for an error, or for none."""
_GROUP, _FORMAT = np.uint32(0x3FFFF00), np.uint32(0xFF0000)


class Identity(NamedTuple):
    """The VIN in a log and its last latitude and longitude [deg]; None is what the log does not say."""

    vin: str | None = None
    latitude: float | None = None
    longitude: float | None = None


def identity_of(log: Log, asked: Collection[str]) -> Identity:
    """Return what of `KINDS` is asked for and the frames of a log say.

    Raises:
        LogError: the log cannot be read.
    """
    found = Identity()
    if not asked or not log.format.has_frames:
        return found
    parts = Reassembler(lambda identifier: VIN if group_of(identifier) == VEHICLE_IDENTIFICATION else None)
    for frame in _of_interest(log, asked):
        group, data = group_of(frame.can_id), frame.data
        if group in (TP_CM, TP_DT):
            whole = parts.take(frame.t, frame.can_id, frame.data)
            if whole is None:
                continue
            group, data = VEHICLE_IDENTIFICATION, whole.data
        if group == VEHICLE_IDENTIFICATION:
            found = found._replace(vin=_vin(data) or found.vin)
        elif place := _place(data):
            found = found._replace(latitude=place[0], longitude=place[1])
    return found


def _of_interest(log: Log, asked: Collection[str]) -> list[Frame]:
    """The frames that may say what is asked for, and of positions only the last valid one."""
    frames: list[Frame] = []
    last: Frame | None = None
    for batch in log.batches():
        number = batch.identifier & _GROUP
        if VIN in asked:
            parts = np.isin(batch.identifier & _FORMAT, [TP_CM << 8, TP_DT << 8])
            said = batch.is_extended & (parts | (number == VEHICLE_IDENTIFICATION << 8))
            frames += batch[said].with_data.frames()
        if POSITION in asked:
            placed = batch[batch.is_extended & (number == VEHICLE_POSITION << 8)].with_data
            last = next((frame for frame in reversed([*placed.frames()]) if _place(frame.data)), last)
    return frames if last is None else [*frames, last]


def _vin(data: bytes) -> str:
    """The text before the asterisk; "" where there is none.

    >>> _vin(b"WDB9634031L123456*" + bytes([255] * 3)), _vin(bytes([255] * 8))
    ('WDB9634031L123456', '')
    """
    text = data.partition(b"*")[0].strip(b"\0\xff ")
    return text.decode("ascii", errors="replace") if text.isascii() else ""


def _place(data: bytes) -> tuple[float, float] | None:
    """Latitude and longitude [deg]; None where one is an error or not there.

    >>> _place(bytes.fromhex("00 D5 23 9B 40 2B 7F 82"))
    (50.2816768, 8.9372224)
    """
    if len(data) != FRAME:
        return None
    numbers = int.from_bytes(data[:4], "little"), int.from_bytes(data[4:], "little")
    if max(numbers) > LAST_VALID:
        return None
    latitude, longitude = (round(number * DEGREES + SOUTH_WEST, 7) for number in numbers)
    return (latitude, longitude) if abs(latitude) <= 90.0 and abs(longitude) <= 180.0 else None
