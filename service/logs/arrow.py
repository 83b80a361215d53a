"""Batches as Arrow, without a copy (extra `columns`)."""

from typing import TYPE_CHECKING

import numpy as np

from faultline.service.logs.batch import Batch

if TYPE_CHECKING:
    import pyarrow


def arrow(batch: Batch) -> "pyarrow.RecordBatch":
    """View a batch as Arrow's: its columns by their names, data as binary of fixed size.

    The buffers are the batch's own.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
    """
    import pyarrow

    width = batch.data.shape[1]
    raw = pyarrow.py_buffer(np.ascontiguousarray(batch.data))
    data = pyarrow.FixedSizeBinaryArray.from_buffers(pyarrow.binary(width), len(batch), [None, raw])
    names = ("time", "channel", "identifier", "flags", "length")
    columns = [pyarrow.array(np.ascontiguousarray(getattr(batch, name))) for name in names]
    return pyarrow.RecordBatch.from_arrays([*columns, data], [*names, "data"])
