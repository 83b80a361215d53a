"""Frames as Parquet (extra `columns`), a row group at a time.

Columns: `time` [s] float64, `channel` text, `identifier` uint32 without flags, `flags` uint8 (1: 29 bits, 2: CAN FD,
4: remote, 8: error, 16: sent), `length` uint8, of a remote frame what it asks for, and `data` binary. The times are
null where the log had none.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from faultline.service.logs.batch import CLASSIC_BYTES, FD_BYTES, NO_DATA, Batch, impossible
from faultline.service.logs.channels import Channels
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogError, LogReport

if TYPE_CHECKING:
    import pyarrow

PARQUET_MAGIC = b"PAR1"
COLUMNS = ("time", "channel", "identifier", "flags", "length", "data")
_ROWS = 1 << 16  # of a row group, and read at once


def read_parquet(source: Source, report: LogReport, channels: Channels) -> Iterator[Batch]:
    """The frames of a log in the file's order. A row group that is damaged is left out.

    Raises:
        LogError: its columns are others.
        ModuleNotFoundError: pyarrow is not installed.
    """
    from pyarrow import ArrowException, parquet

    report.unit = "row"
    with source.plain(report) as path:
        try:
            file = parquet.ParquetFile(path)
        except (ArrowException, OSError) as error:
            report.missing = f"it has no index: {_line(error)}"
            return
        with file:
            if lacking := [name for name in COLUMNS if name not in file.schema_arrow.names]:
                raise LogError(
                    f"a Parquet file without {', '.join(lacking)} holds no frames; its columns are "
                    f"{', '.join(file.schema_arrow.names[:20])}"
                )
            first = 0
            for group in range(file.num_row_groups):
                count = file.metadata.row_group(group).num_rows
                try:
                    for part in file.iter_batches(_ROWS, [group], list(COLUMNS)):
                        yield from _batch(part, first, report, channels)
                except (ArrowException, OSError) as error:
                    report.reject(first, f"{count} rows cannot be read: {_line(error)}")
                first += count


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _batch(part: "pyarrow.RecordBatch", first: int, report: LogReport, channels: Channels) -> Iterator[Batch]:
    """The frames of a part."""
    columns: dict[str, Any] = {name: part.column(name) for name in COLUMNS}
    names = columns["channel"].dictionary_encode()
    index = np.array([channels.index(each.encode()) for each in names.dictionary.to_pylist()], dtype=np.uint8)
    length = columns["length"].to_numpy(zero_copy_only=False).astype(np.uint8)
    flags = columns["flags"].to_numpy(zero_copy_only=False).astype(np.uint8)
    raw = columns["data"].cast("binary").to_pylist()
    width = CLASSIC_BYTES if length.max(initial=0) <= CLASSIC_BYTES else FD_BYTES
    data = np.frombuffer(b"".join([(each or b"")[:width].ljust(width, b"\0") for each in raw]), np.uint8)
    batch = Batch(
        columns["time"].to_numpy(zero_copy_only=False).astype(np.float64),
        index[names.indices.to_numpy()],
        columns["identifier"].to_numpy(zero_copy_only=False).astype(np.uint32),
        flags,
        length,
        data.reshape(-1, width),
    )
    wrong = np.array([len(each or b"") for each in raw]) != np.where(flags & NO_DATA, 0, length)
    bad = impossible(batch) | (length > FD_BYTES) | (wrong & batch.has_data)
    for row in np.flatnonzero(bad).tolist():
        report.reject(first + row, "no frame, or another length than it says")
    yield batch[~bad] if bad.any() else batch


@contextmanager
def parquet_writer(path: Path) -> Iterator[Any]:
    """A writer that takes (batch, names of the channels), for as long as the context lasts."""
    import pyarrow
    from pyarrow import parquet

    schema = pyarrow.schema(
        [
            ("time", pyarrow.float64()),
            ("channel", pyarrow.dictionary(pyarrow.int32(), pyarrow.string())),
            ("identifier", pyarrow.uint32()),
            ("flags", pyarrow.uint8()),
            ("length", pyarrow.uint8()),
            ("data", pyarrow.binary()),
        ],
        metadata={"schema": "faultline.frames/1"},
    )
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:

        def write(batches: Iterable[Batch], names: Sequence[str]) -> None:
            for batch in batches:
                writer.write_batch(_rows(batch, names, schema), row_group_size=_ROWS)

        yield write


def _rows(batch: Batch, names: Sequence[str], schema: "pyarrow.Schema") -> "pyarrow.RecordBatch":
    import pyarrow

    there = np.where(batch.has_data, batch.length, 0)
    offsets = np.concatenate([[0], np.cumsum(there)]).astype(np.int32)
    inside = np.arange(batch.data.shape[1]) < there[:, np.newaxis]
    buffers = [None, pyarrow.py_buffer(offsets), pyarrow.py_buffer(batch.data[inside])]
    data = pyarrow.BinaryArray.from_buffers(pyarrow.binary(), len(batch), buffers)
    channel = pyarrow.DictionaryArray.from_arrays(batch.channel.astype(np.int32), pyarrow.array(list(names), "string"))
    time = pyarrow.array(batch.time, mask=np.isnan(batch.time))
    columns = [pyarrow.array(each) for each in (batch.identifier, batch.flags, batch.length)]
    return pyarrow.RecordBatch.from_arrays([time, channel, *columns, data], schema=schema)
