"""Digits to numbers, eight characters at a time: each is a byte of a number of 64 bits, and none carries over.

Words are arrays of unsigned numbers of 64 bits, the first character in the lowest byte. All operations are of whole
arrays. The method is known as SIMD within a register.
"""

import numpy as np
import numpy.typing as npt

Words = npt.NDArray[np.uint64]

WIDTH = 8
"""Characters of a word."""


def _each(byte: int) -> np.uint64:
    """A word of eight equal bytes."""
    return np.uint64(int.from_bytes(bytes([byte] * WIDTH)))


_TOP, _ZERO, _LOWER, _NIBBLE, _ONE = (_each(b) for b in (0x80, 0x30, 0x20, 0x0F, 0x01))
_U = np.uint64


def decimal(words: Words, count: int) -> tuple[Words, Words]:
    """The numbers that the last `count` characters of the words are (N,), and what is not zero where they are none."""
    digits = (words ^ _ZERO) & _last(count)
    bad = ((digits + _each(0x76)) | digits) & _TOP
    two = digits * _U(10) + (digits >> _U(8))
    mask = _U(0x0000_00FF_0000_00FF)
    pairs = (two & mask) * _U(0x000F_4240_0000_0064) + ((two >> _U(16)) & mask) * _U(0x0000_2710_0000_0001)
    return pairs >> _U(32), bad


def hexadecimal(words: Words, count: int) -> tuple[npt.NDArray[np.uint32], Words]:
    """The four bytes (N,), first one lowest, of the last `count` characters, and what is not zero where they are none.

    Characters before those count as zeros.
    """
    kept = _last(count)
    words = words & kept  # so that nothing before them carries over
    lower = words | _LOWER
    digit = (words + _each(0x80 - 0x30)) & ~(words + _each(0x80 - 0x3A))
    letter = (lower + _each(0x80 - 0x61)) & ~(lower + _each(0x80 - 0x67))
    bad = (words | ~(digit | letter)) & _TOP & kept
    nibbles = (words & _NIBBLE) + ((words >> _U(6)) & _ONE) * _U(9)
    two = ((nibbles << _U(4)) | (nibbles >> _U(8))) & _U(0x00FF_00FF_00FF_00FF)
    four = (two | (two >> _U(8))) & _U(0x0000_FFFF_0000_FFFF)
    return (four | (four >> _U(16))).astype(np.uint32), bad


def _last(count: int) -> np.uint64:
    """A mask of the last characters of a word."""
    return _U((1 << 8 * WIDTH) - (1 << 8 * (WIDTH - count)))
