"""Which files are tables of values."""

from importlib.util import find_spec

from faultline.service.logs.mf4 import MF4_MAGIC
from faultline.service.logs.parquet import PARQUET_MAGIC
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogError
from faultline.service.logs.tables.rows import TableFile
from faultline.service.logs.tables.text import text_table


def find_table_file(source: Source, time: str | float | None = None) -> TableFile | None:
    """Return the table that a file holds, whose times are in the column `time`; None where it holds none.

    Where `time` is a number it is that of seconds from row to row, and no column has times.

    A file of CAN frames is none, but an MF4 may have data channels beside them.

    Raises:
        ModuleNotFoundError: pyarrow or asammdf is not installed, and the file is theirs.
        LogError: rows are counted, and the file is no text.
    """
    if isinstance(time, float):
        if source.head.startswith(PARQUET_MAGIC) or is_mf4(source):
            raise LogError(f"{source.path}: only rows of text may be without times; write them to a column")
        return text_table(source, time)
    if source.head.startswith(PARQUET_MAGIC):
        if find_spec("pyarrow") is None:
            raise ModuleNotFoundError("No module named 'pyarrow'", name="pyarrow")
        from faultline.service.logs.tables.parquet import parquet_table

        return parquet_table(source, time)
    if is_mf4(source):
        from faultline.service.logs.tables.mf4 import mf4_tables

        return mf4_tables(source)
    return text_table(source, time)


def is_mf4(source: Source) -> bool:
    """Return True of an MF4, whose data channels are looked for in a process of its own, which takes a second."""
    return source.head.startswith(MF4_MAGIC)
