"""Which files are tables of values."""

from importlib.util import find_spec

from faultline.service.logs.mf4 import MF4_MAGIC
from faultline.service.logs.parquet import PARQUET_MAGIC
from faultline.service.logs.pieces import Source
from faultline.service.logs.tables.rows import TableFile
from faultline.service.logs.tables.text import text_table


def find_table_file(source: Source, time: str | None = None) -> TableFile | None:
    """Return the table that a file holds, whose times are in the column `time`; None where it holds none.

    A file of CAN frames is none, but an MF4 may have data channels beside them.

    Raises:
        ModuleNotFoundError: pyarrow or asammdf is not installed, and the file is theirs.
    """
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
