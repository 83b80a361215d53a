"""Bytes of DM1 and DM2: those of real trucks, and those computed by hand."""

import random

import pytest

from faultline.service.core.j1939.dm1 import MOST, Code, Lamps, decode, encode

OFF, ON, NONE = 0, 1, 3
STEADY = (NONE, NONE, NONE, NONE)


@pytest.mark.parametrize(
    ("payload", "lamps", "codes"),
    [
        # Three codes as a truck's engine sends them each second: MIL on, no protect lamp.
        (
            "43FF BF000908 54000908 ED141F01",
            Lamps(ON, OFF, OFF, NONE, STEADY),
            [(191, 9, 8), (84, 9, 8), (5357, 31, 1)],
        ),
        # As a kernel's J1939 socket reassembled it; MIL off.
        (
            "04FF EE101201 12150702 16110003",
            Lamps(OFF, OFF, ON, OFF, STEADY),
            [(4334, 18, 1), (5394, 7, 2), (4374, 0, 3)],
        ),
        # No fault, of a device that has all lamps.
        ("00FF 00000000 FFFF", Lamps(OFF, OFF, OFF, OFF, STEADY), []),
        # One code, in one frame.
        ("C4FF 7D140A01 FFFF", Lamps(NONE, OFF, ON, OFF, STEADY), [(5245, 10, 1)]),
        # SPN 524287: not available.
        ("C0FF FFFFFFFF FFFF", Lamps(NONE, OFF, OFF, OFF, STEADY), []),
    ],
)
def test_reads_what_others_send(payload: str, lamps: Lamps, codes: list[tuple[int, int, int]]) -> None:
    read = decode(bytes.fromhex(payload))
    assert (read.lamps, list(read.codes)) == (lamps, [Code(*code) for code in codes])


def test_flashing_lamps_and_old_layouts_are_told() -> None:
    """Byte 2 in the order of byte 1: 01 fast, 00 slow, 11 not. CM is the top bit of a code's fourth byte."""
    read = decode(bytes.fromhex("54 4F BF000988 FFFF"))  # 01 01 01 00, flash 01 00 11 11; 0x88 = CM 1, OC 8
    assert read.lamps == Lamps(ON, ON, ON, OFF, (1, 0, NONE, NONE))
    assert read.codes == (Code(191, 9, 8, is_old=True),)


@pytest.mark.parametrize(
    ("codes", "amber", "payload"),
    [
        # MIL 11 not there, red 00, amber 00, protect 00: 1100 0000; none flashes: 1111 1111; no code; filling.
        ([], False, "C0 FF 00 00 00 00 FF FF"),
        # Amber 01: 1100 0100. 5245 = 0x147D, its upper 3 bits 000 before FMI 10 = 01010; OC 1.
        ([(5245, 10, 1)], True, "C4 FF 7D 14 0A 01 FF FF"),
        # 524286 = 0b111 1111 1111 1111 1110: FE, FF, then 111 and FMI 31 = 11111: FF; OC 126 = 7E, CM 0.
        ([(524286, 31, 126)], True, "C4 FF FE FF FF 7E FF FF"),
        # 65536 = 0b001 0000 0000 0000 0000: 00, 00, 001 and 00001: 21. 255: FF, 00, 000 and 00000.
        ([(65536, 1, 2), (255, 0, 127)], True, "C4 FF 00 00 21 02 FF 00 00 7F"),
        # A real truck's six codes, 26 bytes: 1761 = 06E1, 3703 = 0E77, 3698 = 0E72, 3697 = 0E71, 917 = 0395.
        (
            [(5245, 10, 1), (1761, 10, 1), (3703, 9, 1), (3698, 9, 1), (3697, 9, 1), (917, 9, 1)],
            True,
            "C4 FF 7D140A01 E1060A01 770E0901 720E0901 710E0901 95030901",
        ),
    ],
)
def test_writes_what_was_computed_by_hand(codes: list[tuple[int, int, int]], amber: bool, payload: str) -> None:
    assert encode([Code(*code) for code in codes], amber) == bytes.fromhex(payload)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_written_is_read_again(seed: int) -> None:
    chance = random.Random(seed)  # noqa: S311
    codes = [
        Code(chance.randrange(1, 0x7FFFF), chance.randrange(32), chance.randrange(128))
        for _ in range(chance.choice([0, 1, 2, 3, 32, MOST]))
    ]
    amber = chance.random() < 0.5
    payload = encode(codes, amber)
    assert len(payload) == max(8, 2 + 4 * len(codes)) <= 1785
    assert (payload[0] >> 6, payload[1]) == (NONE, 0xFF)  # never a word about the malfunction indicator
    read = decode(payload)
    assert (list(read.codes), read.lamps) == (codes, Lamps(NONE, OFF, ON if amber else OFF, OFF, STEADY))


def test_of_too_many_codes_the_first_are_sent() -> None:
    codes = [Code(k + 1, 0, 1) for k in range(MOST + 5)]
    assert list(decode(encode(codes, amber=True)).codes) == codes[:MOST]
    assert MOST == 445  # (1785 - 2) / 4


@pytest.mark.parametrize("code", [(0x80000, 0, 0), (-1, 0, 0), (1, 32, 0), (1, -1, 0), (1, 0, 128), (1, 0, -1)])
def test_numbers_that_do_not_fit_are_refused(code: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="do not fit in 19, 5 and 7 bits"):
        encode([Code(*code)], amber=True)


@pytest.mark.parametrize("size", [0, 1, 2, 5, 7, 9, 11, 13])
def test_a_length_that_no_message_has_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match=f"^{size} bytes are no DM1"):
        decode(bytes(size))
