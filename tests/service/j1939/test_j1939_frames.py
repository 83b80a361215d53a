"""Identifiers and NAMEs, bit by bit."""

import random

import pytest

from faultline.service.core.j1939.identifiers import GLOBAL, REQUEST, TP_CM, identifier_of
from faultline.service.j1939.frames import Heard, Message, parse
from faultline.service.j1939.name import FIELDS, delay_s, is_arbitrary, name_of
from faultline.service.logs import Frame


@pytest.mark.parametrize(
    ("pgn", "source", "destination", "priority", "expected"),
    [
        (65226, 0x3D, GLOBAL, 6, 0x18FECA3D),
        (65226, 0x3D, 0x21, 6, 0x18FECA3D),  # a group without a destination
        (59904, 0xF9, 0x3D, 6, 0x18EA3DF9),
        (60928, 0x90, GLOBAL, 6, 0x18EEFF90),
        (60416, 0x90, 0xF9, 7, 0x1CECF990),
        (0x1F01D, 0x00, GLOBAL, 3, 0x0DF01D00),  # data page 1
    ],
)
def test_identifiers_are_those_of_the_standard(
    pgn: int, source: int, destination: int, priority: int, expected: int
) -> None:
    assert identifier_of(pgn, source, destination, priority) == expected
    frame = Message(pgn, b"ab", destination, priority).frame(source, 3.0)
    assert frame == Frame(3.0, expected, True, b"ab")
    told = destination if pgn in (REQUEST, TP_CM) else GLOBAL
    assert parse(frame) == Heard(pgn, source, told, b"ab")


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0.0, 0x123, False, b""),
        Frame(0.0, 0x1BDA00F1, True, b""),  # extended data page: ISO 15765-3
        Frame(0.0, 0x18FECA3D, True, bytes(12)),  # CAN FD
    ],
)
def test_what_is_not_j1939_is_left_alone(frame: Frame) -> None:
    assert parse(frame) is None


def test_the_name_has_its_fields_where_they_belong() -> None:
    """Identity at bit 0, manufacturer 21, instances 32, 35, function 40, reserved 48, system 49, 56, group 60."""
    begins = dict(zip((name for name, _ in FIELDS), (0, 21, 32, 35, 40, 48, 49, 56, 60, 63), strict=True))
    for field, bits in FIELDS:
        assert name_of(**{field: (1 << bits) - 1}) == (1 << bits) - 1 << begins[field]
        with pytest.raises(ValueError, match=f"{field} {1 << bits} does not fit in {bits} bits"):
            name_of(**{field: 1 << bits})
    assert name_of(**{field: (1 << bits) - 1 for field, bits in FIELDS}) == 2**64 - 1
    with pytest.raises(ValueError, match="no field of a NAME: colour"):
        name_of(colour=1)


def test_a_name_by_hand() -> None:
    """A free one: identity 0x12345, manufacturer 0x123, ECU 1, function instance 2, function 0x81, highway vehicle.

    0x123 << 21 | 0x12345 = 0x24612345; 2 << 3 | 1 = 0x11; 0x81; 0; group 1 and arbitrary: 1001 0000.
    """
    made = name_of(
        identity_number=0x12345,
        manufacturer_code=0x123,
        ecu_instance=1,
        function_instance=2,
        function=0x81,
        industry_group=1,
        arbitrary_address_capable=1,
    )
    assert f"{made:016X}" == "9000811124612345"
    assert is_arbitrary(made)
    assert not is_arbitrary(made - (1 << 63))


def test_the_delay_before_giving_up_looks_random_and_is_bounded() -> None:
    chance = random.Random(3)  # noqa: S311
    delays = [delay_s(chance.getrandbits(64), time) for _ in range(300) for time in (1, 2)]
    assert 0.0 <= min(delays) < 0.005
    assert 0.148 < max(delays) <= 0.153 + 1e-9
    assert len(set(delays)) > 200
    assert delay_s(5, 1) == delay_s(5, 1)
