"""Data channels of an MF4 as tables, one for each of its groups (extra `mf4`)."""

from collections import deque
from collections.abc import Collection, Generator, Iterator, Sequence
from contextlib import ExitStack
from tempfile import TemporaryFile

import numpy as np

from faultline.service.logs.mf4 import check_asammdf, messages, note_end
from faultline.service.logs.mf4_worker import Ended
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogReport
from faultline.service.logs.tables.mf4_worker import DataChannel, DataChannels, DataRows
from faultline.service.logs.tables.rows import TableRows

_WORKER = "faultline.service.logs.tables.mf4_worker"
_MESSAGES = DataChannels | DataRows | Ended


class Mf4Tables:
    """The data channels of an MF4."""

    kind = "MF4 with data channels"

    def __init__(self, source: Source, channels: Sequence[DataChannel]) -> None:
        self._source = source
        self.units = {each.name: each.unit for each in channels}
        self._groups = {each.name: each.group for each in channels}

    def streams(self, names: Collection[str], report: LogReport) -> Sequence[Iterator[TableRows]]:
        """Return the rows: see `TableFile`."""
        report.unit = "record"
        groups = sorted({group for name, group in self._groups.items() if name in names or not names})
        told = _read(self._source, names, report)
        waiting: dict[int, deque[TableRows]] = {group: deque() for group in groups}
        return [_of(group, waiting, told) for group in groups]


def _of(group: int, waiting: dict[int, deque[TableRows]], parts: Iterator[DataRows]) -> Iterator[TableRows]:
    """Yield the rows of a group; those of others that come before wait."""
    while True:
        while waiting[group]:
            yield waiting[group].popleft()
        part = next(parts, None)
        if part is None:
            return
        values = {name: np.frombuffer(raw, np.float64) for name, raw in part.values.items()}
        waiting[part.group].append(TableRows(np.frombuffer(part.time, np.float64), values))


def _read(source: Source, names: Collection[str], report: LogReport) -> Generator[DataRows, None, None]:
    with ExitStack() as stack:
        path, errors = stack.enter_context(source.plain(report)), stack.enter_context(TemporaryFile())
        for message in messages(_WORKER, [str(path), *names], _MESSAGES, errors, report):
            if isinstance(message, DataRows):
                yield message
            elif isinstance(message, Ended):
                note_end(message.missing, message.bad, report)


def mf4_tables(source: Source) -> Mf4Tables | None:
    """Return the tables that an MF4 holds; None where it has no data channels.

    Raises:
        ModuleNotFoundError: asammdf is not installed.
    """
    check_asammdf()
    with source.plain(LogReport()) as path, TemporaryFile() as errors:
        first = next(messages(_WORKER, [str(path), ""], _MESSAGES, errors, LogReport()), None)
    return Mf4Tables(source, first.channels) if isinstance(first, DataChannels) and first.channels else None
