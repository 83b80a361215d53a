"""The channels of a log, by their names in the order in which they came."""

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
