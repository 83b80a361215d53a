"""What did not reach the diagnosis: frames lost, left alone or too short, and an interface that went down."""

from service.bus.base import Bus
from service.core.decode import DecodeTable


class Losses:
    """Counts of one bus and the table that decodes its frames, in words."""

    def __init__(self, bus: Bus, table: DecodeTable) -> None:
        self._bus = bus
        self._table = table
        self._told = (0, 0, 0, 0)

    def news(self) -> str | None:
        """All that was lost since the start, where that is more than when it was last asked for."""
        counts = (self._bus.dropped, self._bus.skipped, self._table.short_frames, self._bus.link_downs)
        if counts == self._told:
            return None
        self._told = counts
        dropped, skipped, short, downs = counts
        return (
            f"since the start: frames dropped by the kernel {dropped}, no data frames {skipped}, "
            f"shorter than in the DBC {short}; times the interface went down {downs}"
        )
