"""A table as Parquet (extra `columns`): columns of numbers, units in the fields' metadata (`unit`)."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.parquet import COLUMNS
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogError, LogReport
from faultline.service.logs.tables.rows import TableRows, distinct, is_time, per_second, title

if TYPE_CHECKING:
    import pyarrow

_ROWS = 1 << 16
_WRITTEN = b"faultline.ticks"


class ParquetTable:
    """A table as Parquet, with a column of times."""

    kind = "PARQUET table of values"

    def __init__(self, source: Source, units: Mapping[str, str], columns: Mapping[str, str], time: str) -> None:
        """`columns` are the names in the file, by those without units; `time` is the file's."""
        self._source, self._columns, self._time = source, columns, time
        self._per_s = per_second(time, units[time])
        self.units = {name: unit for name, unit in units.items() if name != time}

    def streams(self, names: Collection[str], report: LogReport) -> Sequence[Iterator[TableRows]]:
        """Return the rows: see `TableFile`."""
        return [self._rows([name for name in self.units if name in names], report)]

    def _rows(self, names: Sequence[str], report: LogReport) -> Iterator[TableRows]:
        from pyarrow import ArrowException, parquet

        report.unit = "row"
        with self._source.plain(report) as path, parquet.ParquetFile(path) as file:
            first = 0
            for group in range(file.num_row_groups):
                count = file.metadata.row_group(group).num_rows
                try:
                    for part in file.iter_batches(
                        _ROWS, [group], [self._columns[name] for name in (self._time, *names)]
                    ):
                        yield self._usable(part, names, first, report)
                except (ArrowException, OSError) as error:
                    report.reject(first, f"{count} rows cannot be read: {' '.join(str(error).split())[:200]}")
                first += count

    def _usable(self, part: "pyarrow.RecordBatch", names: Sequence[str], first: int, report: LogReport) -> TableRows:
        time = _seconds(part.column(self._columns[self._time])) / self._per_s
        has_time = np.isfinite(time)
        for row in np.flatnonzero(~has_time).tolist():
            report.reject(first + row, "no time")
        values = {name: _numbers(part.column(self._columns[name])) for name in names}
        if has_time.all():
            return TableRows(time, values)
        return TableRows(time[has_time], {name: each[has_time] for name, each in values.items()})


def _numbers(column: "pyarrow.Array") -> FloatArray:
    """Return a column's numbers; what is there and is none is infinite."""
    import pyarrow

    if pyarrow.types.is_boolean(column.type):
        column = column.cast(pyarrow.int8())
    try:
        return np.asarray(column.cast(pyarrow.float64()).to_numpy(zero_copy_only=False), np.float64)
    except pyarrow.ArrowException:
        return np.where(column.is_null().to_numpy(zero_copy_only=False), np.nan, np.inf)


def _seconds(column: "pyarrow.Array") -> FloatArray:
    """Return times as numbers; those of dates in seconds since 1970."""
    import pyarrow

    if pyarrow.types.is_date(column.type) or pyarrow.types.is_timestamp(column.type):
        nanoseconds = column.cast(pyarrow.timestamp("ns", getattr(column.type, "tz", None))).cast(pyarrow.int64())
        return np.asarray(nanoseconds.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False)) / 1e9
    return _numbers(column)


def parquet_table(source: Source, time: str | None = None) -> ParquetTable | None:
    """Return the table that a Parquet file holds; None where it has no column of times, or holds CAN frames.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        LogError: it holds what a diagnosis saw of several recordings.
    """
    from pyarrow import ArrowException, parquet

    with source.plain(LogReport()) as path:
        try:
            schema = parquet.read_schema(path)
        except (ArrowException, OSError):
            return None
    if set(COLUMNS) <= set(schema.names):
        return None
    _check_one_recording(source, schema)
    names = distinct([title(name)[0] for name in schema.names])
    columns = dict(zip(names, schema.names, strict=True))
    at = next((name for name in columns if (name == time if time else is_time(name))), None)
    if at is None:
        return None
    return ParquetTable(source, {name: _unit(schema.field(k)) for k, name in enumerate(names)}, columns, at)


def _check_one_recording(source: Source, schema: "pyarrow.Schema") -> None:
    if _WRITTEN not in (schema.metadata or {}).get(b"schema", b""):
        return
    from pyarrow import compute, parquet

    with source.plain(LogReport()) as path:
        recordings = compute.unique(parquet.read_table(path, columns=["recording"])["recording"]).to_pylist()
    if len(recordings) > 1:
        raise LogError(
            f"{source.path}: holds the ticks of {len(recordings)} recordings, one after the other; write one to a file"
        )


def _unit(field: "pyarrow.Field") -> str:
    """Return a field's unit: that of its metadata, or what stands in brackets behind its name."""
    written = (field.metadata or {}).get(b"unit")
    return written.decode("utf-8", "replace") if written is not None else title(field.name)[1]
