"""The identifiers that came on each channel of a log."""

import numpy as np
import numpy.typing as npt

from faultline.service.logs.batch import EXTENDED, Batch

_BITS = 12
_ODD = np.uint64(0x9E37_79B9_7F4A_7C15)
_NONE = np.uint64(2**64 - 1)
_CHANNEL, _IS_EXTENDED = 40, 32  # bits of a key, above the identifier

Keys = npt.NDArray[np.uint64]


def keys_of(batch: Batch) -> Keys:
    """A number for channel, identifier and whether it has 29 bits (N,)."""
    key = batch.channel.astype(np.uint64) << np.uint64(_CHANNEL)
    key |= (batch.flags & EXTENDED).astype(np.uint64) << np.uint64(_IS_EXTENDED)
    return np.asarray(key | batch.identifier)


def parts_of(key: int) -> tuple[int, int, bool]:
    """The channel, the identifier and whether it has 29 bits."""
    return key >> _CHANNEL, key & 0xFFFF_FFFF, bool(key >> _IS_EXTENDED & 1)


class Seen:
    """State: the keys so far, and the last one of each hash, by which nearly all are known without sorting."""

    def __init__(self) -> None:
        self.keys: set[int] = set()
        self._table = np.full(1 << _BITS, _NONE)

    def add(self, batch: Batch) -> None:
        """Take note of all frames of the batch."""
        keys = keys_of(batch)
        places = (keys * _ODD) >> np.uint64(64 - _BITS)
        new = keys[self._table[places] != keys]
        if len(new):
            found = np.unique(new)
            self.keys.update(found.tolist())
            self._table[(found * _ODD) >> np.uint64(64 - _BITS)] = found

    def by_channel(self, names: list[bytes]) -> dict[str, set[tuple[int, bool]]]:
        """The (identifier, has 29 bits) of each channel that has any, by its name."""
        found: dict[str, set[tuple[int, bool]]] = {}
        for channel, identifier, is_extended in sorted(map(parts_of, self.keys)):
            name = names[channel].decode(errors="replace")
            found.setdefault(name, set()).add((identifier, is_extended))
        return dict(sorted(found.items()))
