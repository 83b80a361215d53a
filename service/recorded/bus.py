"""Bus that replays a log: its frames in batches, at their log times."""

from collections.abc import Iterable
from itertools import islice

from faultline.service.bus.base import BATCH, Bus, BusError
from faultline.service.logs import Frame


class LogBus(Bus):
    """Bus of a log's frames in their order, `t` [s] of log time, and none once all were given."""

    def __init__(self, frames: Iterable[Frame]) -> None:
        super().__init__()
        self._frames = iter(frames)
        self.now = 0.0  # log time of the last frame that was given [s]

    def fileno(self) -> int:
        """Return -1: there is nothing to wait for."""
        return -1

    @property
    def dropped(self) -> int:
        """Return 0: what the logger lost is in no log."""
        return 0

    def receive(self) -> list[Frame]:
        """Return the next frames."""
        frames = list(islice(self._frames, BATCH))
        self.counts.frames += len(frames)
        if frames:
            self.now = frames[-1].t
        return frames

    def send(self, frame: Frame) -> None:
        """Always raises `BusError`."""
        raise BusError(f"a log takes no frame {frame.can_id:X}")

    def close(self) -> None:
        """Do nothing: nothing is open."""
