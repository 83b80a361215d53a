"""One pass over a log file: its frames in order of time, and what was lost of them."""

from collections.abc import Iterator

import numpy as np

from faultline.service.logs.batch import ERROR, NO_DATA, REMOTE, Batch
from faultline.service.logs.channels import Channels
from faultline.service.logs.formats import Format
from faultline.service.logs.order import Ordering, without_outliers
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogError, LogReport
from faultline.service.logs.seen import Seen

KEPT = 8 << 20
"""Bytes of batches that are kept from the first pass, so that a short log is read once."""


class Pass:
    """One pass over the file. State: its report, and what came so far."""

    def __init__(self, source: Source, form: Format, channel: str | None) -> None:
        self.report, self.channels = LogReport(), Channels()
        self.first_s: float | None = None
        self._source, self._format = source, form
        self._channel = None if channel is None else channel.encode()
        self._ordering, self._seen = Ordering(self.report), Seen()

    def batches(self) -> Iterator[Batch]:
        """The frames of the channel in order of time."""
        try:
            for batch in self._read():
                self._seen.add(batch.with_data)
                chosen = batch if self._channel is None else batch[batch.channel == self._chosen()]
                yield self._ordering.ordered(chosen) if self._format.has_times else chosen
        except LogError as error:
            raise LogError(f"{self._source.path}: {error}") from error

    def _read(self) -> Iterator[Batch]:
        batches = self._format.read(self._source, self.report, self.channels)
        return without_outliers(batches, self.report) if self._format.has_times else batches

    def all(self) -> tuple[Batch, ...] | None:
        """Read all, for the report; return the batches, None where they are too many to be kept."""
        kept: list[Batch] = []
        size = 0
        for batch in self.batches():
            self._count(batch)
            size += sum(getattr(batch, name).nbytes for name in Batch.__slots__)
            if size > KEPT:
                kept.clear()
            else:
                kept.append(batch)
        self.report.channels = self._seen.by_channel(self.channels.names)
        return tuple(kept) if size <= KEPT else None

    def _chosen(self) -> int:
        """The index of the channel, or one that no frame has."""
        names = self.channels.names
        return names.index(self._channel) if self._channel in names else len(names)

    def _count(self, batch: Batch) -> None:
        frames = batch.with_data
        self.report.frames += len(frames)
        if len(frames) < len(batch):
            self.report.remote += int(np.count_nonzero(batch.flags & NO_DATA == REMOTE))
            self.report.errors += int(np.count_nonzero(batch.flags & ERROR))
        if len(frames) and self._format.has_times:
            self.first_s = float(frames.time[0]) if self.first_s is None else self.first_s
            self.report.length_s = float(frames.time[-1]) - self.first_s
