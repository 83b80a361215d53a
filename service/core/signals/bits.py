"""Signals cut out of many frames of one message at once: as `Field.read` does it for one, equal in every bit."""

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.layout import Cut, Field, Layout, Only, Plain
from faultline.service.core.signals.values import FloatArray, Mask, Qualities, Quality

Words = npt.NDArray[np.uint64]
Bytes = npt.NDArray[np.uint8]

WORD = 64
"""Bits that are cut out at once; a message with a longer signal is decoded frame by frame."""

_FLOATS = {16: (np.uint16, np.float16), 32: (np.uint32, np.float32), 64: (np.uint64, np.float64)}
_GOOD, _ERROR, _OUT_OF_RANGE = (int(one) for one in (Quality.GOOD, Quality.ERROR, Quality.OUT_OF_RANGE))
_NOT_AVAILABLE, _RESERVED = int(Quality.NOT_AVAILABLE), int(Quality.RESERVED)


class Bits:
    """The data of K frames of one message, each read as one integer from either end; `data` (K, W), W >= `size`."""

    def __init__(self, data: Bytes, size: int) -> None:
        self._data, self._size = data, size
        self._ends: dict[bool, Words] = {}

    def __len__(self) -> int:
        """The number of frames."""
        return len(self._data)

    def repeat(self) -> Mask:
        """Which frames have the bytes of the one before (K,), the first one aside."""
        same = np.ones(len(self), np.bool_)
        for first in range(0, self._size, 8):
            word = self._word(big_endian=False, first=first)
            same[1:] &= word[1:] == word[:-1]
        return same

    def raw(self, cut: Cut) -> Words:
        """The bits of a signal (K,)."""
        first, shift = (0, cut.shift) if self._size <= 8 else divmod(cut.shift, 8)
        word = self._word(cut.big_endian, first) >> np.uint64(shift)
        if shift + cut.length > WORD:  # it reaches into a ninth byte
            word |= self._word(cut.big_endian, first + 8) << np.uint64(WORD - shift)
        return word & np.uint64((1 << cut.length) - 1)

    def _word(self, big_endian: bool, first: int) -> Words:
        """Eight bytes from the `first` one, counted from the end that the integer begins with."""
        if self._size <= 8:
            if big_endian not in self._ends:
                self._ends[big_endian] = self._eight(big_endian, 0)
            return self._ends[big_endian]
        return self._eight(big_endian, first)

    def _eight(self, big_endian: bool, first: int) -> Words:
        data = self._data[:, : self._size]
        if self._data.shape[1] == self._size == 8:
            word = np.ascontiguousarray(self._data).view("<u8")[:, 0]
            return word.byteswap() if big_endian else word
        some = data[:, ::-1][:, first : first + 8] if big_endian else data[:, first : first + 8]
        whole = np.zeros((len(data), 8), np.uint8)
        whole[:, : some.shape[1]] = some
        return whole.view("<u8")[:, 0]

    def are_there(self, only: Only) -> Mask:
        """Which frames have a multiplexed signal (K,)."""
        there = np.ones(len(self), np.bool_)
        for cut, values in only:
            there &= _is_one_of(self.raw(cut), values)
        return there

    def count_unknown(self, layout: Layout) -> int:
        """Return how many selectors have a value that the DBC does not know."""
        return sum(
            int(np.count_nonzero(self.are_there(one.only) & ~_is_one_of(self.raw(one.cut), one.known)))
            for one in layout.selectors
        )

    def plain_values(self, plain: Plain, j1939: bool) -> tuple[FloatArray, Qualities]:
        """Values and qualities (K,) of a signal that is an unsigned integer and in every frame."""
        _, _, _, least, beyond, scale, offset, field = plain
        raw = self.raw(field.cut)
        good = (raw >= least) & (raw < beyond)
        if good.all():
            with np.errstate(over="ignore"):
                return raw.astype(np.float64) * scale + offset, np.zeros(len(raw), np.int8)
        value, quality = self.values(field, j1939)
        quality[good] = _GOOD
        return value, quality

    def values(self, field: Field, j1939: bool) -> tuple[FloatArray, Qualities]:
        """Values and qualities (K,) of a signal, whether it is there or not."""
        raw = self.raw(field.cut)
        with np.errstate(all="ignore"):  # as Python's floats: what is no finite number is out of range
            number = _numbers(raw, field)
            value = number * field.scale + field.offset
        quality = np.zeros(len(raw), np.int8)
        if field.is_float:
            quality[~np.isfinite(number)] = _ERROR
        elif j1939:
            _mark_words(quality, raw, field.cut.length)
        inside = (field.low <= value) & (value <= field.high) & np.isfinite(value)
        quality[(quality == _GOOD) & ~inside] = _OUT_OF_RANGE
        return value, quality


def _numbers(raw: Words, field: Field) -> FloatArray:
    if field.is_float:
        bits, kind = _FLOATS[field.cut.length]
        return raw.astype(bits).view(kind).astype(np.float64)
    if field.signed:
        room = WORD - field.cut.length
        return ((raw << np.uint64(room)).view(np.int64) >> np.int64(room)).astype(np.float64)
    return raw.astype(np.float64)


def _mark_words(quality: Qualities, raw: Words, length: int) -> None:
    """Mark the raw values that state a quality (`j1939_quality`)."""
    if length == 1:
        return
    if length < 8:
        top = (1 << length) - 1
        quality[raw == top], quality[raw == top - 1] = _NOT_AVAILABLE, _ERROR
        return
    byte = raw >> np.uint64(length - 8)
    quality[byte >= 0xFB] = _RESERVED
    quality[byte == 0xFE], quality[byte == 0xFF] = _ERROR, _NOT_AVAILABLE


def _is_one_of(raw: Words, values: frozenset[int]) -> Mask:
    found = np.zeros(len(raw), np.bool_)
    for value in values:
        found |= raw == value
    return found
