"""Operation cycles: the key counts as on while the vehicle's frames come.

Source: AUTOSAR's operation cycle, which counts trips, healing and aging; ignition on and off, as seen on the bus.
"""

from typing import Literal

import msgspec

from faultline.service.core.records.fault import Count

SILENT_S = 60.0
"""After so long without a frame that a bundle wants, the key is off [s]; a loose plug is shorter."""


class Cycle(msgspec.Struct, frozen=True, kw_only=True):
    """The latest operation cycle: its number, in which boot of the machine it was, and whether it lasts."""

    number: Count = 0
    boot: str = ""
    lasts: bool = False


class OperationCycle:
    """Follows the key. A service that is started again goes on with the cycle of the same boot.

    `cycle` is the latest one; `boot` the kernel's identifier of this boot; `now` the monotonic time [s].
    """

    def __init__(self, cycle: Cycle, boot: str, now: float) -> None:
        self.cycle, self._boot = cycle, boot
        self._heard_at = now
        self._frames: int | None = None

    def look(self, frames: int, now: float) -> list[Literal["ended", "begun"]]:
        """Take the count of frames; return the steps of the cycle, which ends before another one begins."""
        heard = frames != (self._frames or 0)
        self._frames = frames
        if heard:
            self._heard_at = now
        if self.cycle.lasts and (self.cycle.boot != self._boot or now - self._heard_at > SILENT_S):
            self.cycle = msgspec.structs.replace(self.cycle, lasts=False)
            return ["ended", *self._begin(heard)]
        return self._begin(heard)

    def end(self) -> list[Literal["ended", "begun"]]:
        """The machine slept: the key was off."""
        if not self.cycle.lasts:
            return []
        self.cycle = msgspec.structs.replace(self.cycle, lasts=False)
        return ["ended"]

    def _begin(self, heard: bool) -> list[Literal["ended", "begun"]]:
        if self.cycle.lasts or not heard:
            return []
        self.cycle = Cycle(number=self.cycle.number + 1, boot=self._boot, lasts=True)
        return ["begun"]
