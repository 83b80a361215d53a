"""A log as a bus: its frames in batches, at their log times."""

from collections.abc import Iterable
from itertools import islice

from faultline.service.bus.base import BATCH, Bus, BusError
from faultline.service.logs import Frame


class LogBus(Bus):
    """Gives the frames in their order, `t` [s] of log time, and none once all were given."""

    def __init__(self, frames: Iterable[Frame]) -> None:
        super().__init__()
        self._frames = iter(frames)
        self.now = 0.0  # log time of the last frame that was given [s]

    def fileno(self) -> int:
        """Nothing to wait for."""
        return -1

    @property
    def dropped(self) -> int:
        """None: what the logger lost is in no log."""
        return 0

    def receive(self) -> list[Frame]:
        """The next frames."""
        frames = list(islice(self._frames, BATCH))
        self.counts.frames += len(frames)
        if frames:
            self.now = frames[-1].t
        return frames

    def send(self, frame: Frame) -> None:
        """Always raises `BusError`."""
        raise BusError(f"a log takes no frame {frame.can_id:X}")

    def close(self) -> None:
        """Nothing is open."""
