"""What did not reach the diagnosis: frames lost, left alone or not as in the DBC, and an interface that went away."""

from collections.abc import Sequence

from faultline.service.bus.base import Bus
from faultline.service.core.signals.decode import DecodeTable, Rejected


class Losses:
    """Counts of one bus and of the tables that decode its frames, in words."""

    def __init__(self, bus: Bus, tables: Sequence[DecodeTable]) -> None:
        self._bus, self.tables = bus, tables
        self._told: dict[str, int] = {}

    def news(self) -> str | None:
        """All that was lost since the start, where that is more than when it was last asked for."""
        counts, rejected = self._bus.counts, [table.rejected for table in self.tables]
        now = {
            "frames dropped by the kernel": self._bus.dropped,
            "remote frames": counts.remote,
            "no frames": counts.malformed,
            "sent by this machine": counts.local,
            "error frames": counts.errors,
            "shorter than in the DBC": _all(rejected, "short"),
            "of another sender": _all(rejected, "other_source"),
            "too early to be the same sender's": _all(rejected, "early"),
            "claims of their senders' addresses by others": _all(rejected, "claimed"),
            "from several senders, of which none is chosen": _all(rejected, "unclear"),
            "messages in parts that were not all there": sum(sum(each.incomplete().values()) for each in self.tables),
            "multiplexed by an unknown value": _all(rejected, "unknown_selector"),
            "times bus-off": counts.bus_offs,
            "times the interface went down": counts.link_downs,
            "times it was removed": counts.removals,
        }
        now = {what: count for what, count in now.items() if count}
        if now == self._told:
            return None
        self._told = now
        strangers = [text for table in self.tables for text in table.strangers()]
        counted = ", ".join(f"{what} {count}" for what, count in now.items())
        return "; ".join([f"since the start: {counted}", *strangers])


def _all(rejected: Sequence[Rejected], what: str) -> int:
    return sum(sum(getattr(each, what).values()) for each in rejected)
