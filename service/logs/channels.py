"""The channels of a log, by their names in the order in which they came."""

import numpy as np

from faultline.service.logs.batch import Bytes

MOST_CHANNELS = 255


class Channels:
    """State: the names so far; at most 255, as more are damage."""

    def __init__(self) -> None:
        self.names: list[bytes] = []
        self._index: dict[bytes, int] = {}

    def index(self, name: bytes) -> int:
        """The channel's index; raises `ValueError` where there are too many."""
        found = self._index.get(name)
        if found is None:
            if len(self.names) == MOST_CHANNELS:
                raise ValueError("the 256th channel")
            found = self._index[name] = len(self.names)
            self.names.append(name)
        return found

    def came_in_order(self, since: int, column: Bytes) -> Bytes:
        """Number the channels from `since` on as they came first in a column (N,) of indices; return it renumbered."""
        first = [int(np.argmax(column == k)) for k in range(since, len(self.names))]
        order = [*range(since), *(since + k for k in sorted(range(len(first)), key=first.__getitem__))]
        self.names = [self.names[k] for k in order]
        self._index = {name: k for k, name in enumerate(self.names)}
        return np.argsort(order).astype(np.uint8)[column]
