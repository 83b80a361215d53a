"""Digits to numbers, eight characters at a time: each is a byte of a number of 64 bits, and none carries over.

Words are arrays of unsigned numbers of 64 bits, the first character in the lowest byte. All operations are of whole
arrays. The method is known as SIMD within a register.
"""

import numpy as np
import numpy.typing as npt

Words = npt.NDArray[np.uint64]

WIDTH = 8
"""Characters of a word."""

_ALPHABET = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"
_NO_SIX = 255
_SIX = np.full(256, _NO_SIX, dtype=np.uint8)
_SIX[np.frombuffer(_ALPHABET, np.uint8)] = np.arange(64)
_SIX[ord("=")] = 0


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


def base64(characters: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
    """The bytes (N, 3 L / 4) that characters (N, L) are, L a multiple of 4, and which rows have other characters (N,).

    Padding counts as zeros.
    """
    six = _SIX[characters]
    four = six.astype(np.uint32).reshape(len(six), -1, 4)
    number = four[..., 0] << np.uint32(18) | four[..., 1] << np.uint32(12) | four[..., 2] << np.uint32(6) | four[..., 3]
    whole = number.astype(">u4").view(np.uint8).reshape(len(six), -1, 4)[..., 1:]
    return whole.reshape(len(six), -1), np.asarray((six == _NO_SIX).any(axis=1))


def _last(count: int) -> np.uint64:
    """A mask of the last characters of a word."""
    return _U((1 << 8 * WIDTH) - (1 << 8 * (WIDTH - count)))
