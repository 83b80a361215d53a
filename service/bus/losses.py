"""What did not reach the diagnosis: frames lost, left alone or not as in the DBC, and an interface that went away."""

from service.bus.base import Bus
from service.core.decode import DecodeTable


class Losses:
    """Counts of one bus and the table that decodes its frames, in words."""

    def __init__(self, bus: Bus, table: DecodeTable) -> None:
        self._bus = bus
        self._table = table
        self._told: dict[str, int] = {}

    def news(self) -> str | None:
        """All that was lost since the start, where that is more than when it was last asked for."""
        counts, rejected = self._bus.counts, self._table.rejected
        now = {
            "frames dropped by the kernel": self._bus.dropped,
            "remote frames": counts.remote,
            "no frames": counts.malformed,
            "sent by this machine": counts.local,
            "error frames": counts.errors,
            "shorter than in the DBC": sum(rejected.short.values()),
            "of another sender": sum(rejected.other_source.values()),
            "multiplexed by an unknown value": sum(rejected.unknown_selector.values()),
            "times bus-off": counts.bus_offs,
            "times the interface went down": counts.link_downs,
            "times it was removed": counts.removals,
        }
        now = {what: count for what, count in now.items() if count}
        if now == self._told:
            return None
        self._told = now
        return "since the start: " + ", ".join(f"{what} {count}" for what, count in now.items())
