"""The tables of a fleet, as Parquet files by vehicle and date: one file a drive, by the digest of what it is made of.

    OUT/drives/vehicle=truck-17/date=2026-03-02/DIGEST.parquet       a row: the drive and its verdict
    OUT/events/vehicle=truck-17/date=2026-03-02/DIGEST.parquet       its events

The file of `drives` is written last: where it is, the drive is done. The columns' meanings are in docs/fleet.md.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import pyarrow
from pyarrow import dataset, parquet

from faultline.analysis.fleet.drives import safe
from faultline.writing import written_whole

DRIVES, EVENTS = "drives", "events"
UNDATED = "__HIVE_DEFAULT_PARTITION__"
"""How readers of such folders write that there is no value."""

_TEXT, _TEXTS, _FLOAT = pyarrow.string(), pyarrow.list_(pyarrow.string()), pyarrow.float64()
_SIZE = pyarrow.struct([("low", _FLOAT), ("high", _FLOAT), ("unit", _TEXT), ("of", _TEXT)])
_DIAGNOSES = pyarrow.list_(
    pyarrow.struct(
        [
            ("faults", _TEXTS),
            ("components", _TEXTS),
            ("rank", pyarrow.int32()),
            ("p", _FLOAT),
            ("near", _TEXTS),
            ("sizes", pyarrow.list_(_SIZE)),
        ]
    )
)
DRIVE = pyarrow.schema(
    [
        ("url", _TEXT),
        ("recording", _TEXT),
        ("start", pyarrow.timestamp("ms", "UTC")),
        ("bundle", _TEXT),
        ("verdict", _TEXT),
        ("reason", _TEXT),
        ("span_s", _FLOAT),
        ("frames", pyarrow.int64()),
        ("ticks", pyarrow.int64()),
        ("occurred_s", _FLOAT),
        ("since_s", _FLOAT),
        ("diagnoses", _DIAGNOSES),
        ("simulated", pyarrow.bool_()),
        ("native", pyarrow.bool_()),
        ("cpu_s", _FLOAT),
        ("version", _TEXT),
        ("asked", _TEXTS),
        ("vin", _TEXT),
        ("latitude", _FLOAT),
        ("longitude", _FLOAT),
    ]
)
EVENT = pyarrow.schema(
    [
        ("recording", _TEXT),
        ("seq", pyarrow.int64()),
        ("t_s", _FLOAT),
        ("transition", _TEXT),
        ("suspected", pyarrow.bool_()),
        ("settled", pyarrow.bool_()),
        ("alarm", _TEXTS),
        ("cannot_tell", _TEXTS),
        ("diagnoses", _DIAGNOSES),
        ("event", _TEXT),
    ]
)

Row = Mapping[str, Any]


def place_of(out: Path, table: str, vehicle: str, day: date | None, key: str) -> Path:
    """Return the file of a drive in a table.

    >>> place_of(Path("out"), "drives", "truck 7", None, "ab12").as_posix()
    'out/drives/vehicle=truck%207/date=__HIVE_DEFAULT_PARTITION__/ab12.parquet'
    """
    when = UNDATED if day is None else day.isoformat()
    return out / table / f"vehicle={safe(vehicle)}" / f"date={when}" / f"{key}.parquet"


def files_of(out: Path, vehicle: str, key: str) -> list[Path]:
    """Return the file of a drive, if it is there, whatever its date."""
    return sorted((out / DRIVES / f"vehicle={safe(vehicle)}").glob(f"date=*/{key}.parquet"))


def write(path: Path, schema: pyarrow.Schema, rows: Sequence[Row]) -> None:
    """Write a file whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    with written_whole(path) as partial:
        parquet.write_table(pyarrow.Table.from_pylist(list(rows), schema), partial, compression="zstd")


def verdict_in(path: Path) -> tuple[str, float, list[str]]:
    """Return the verdict in a drive's file, the hours that it has, and what was asked for besides."""
    row = parquet.read_table(path, schema=DRIVE, partitioning=None).to_pylist()[0]
    return row["verdict"], (row["span_s"] or 0.0) / 3600.0, row["asked"] or []


def drives(out: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of all drives, with their vehicle and date, by vehicle and time."""
    if not any((out / DRIVES).glob("vehicle=*")):
        return
    kinds = pyarrow.schema([("vehicle", _TEXT), ("date", pyarrow.date32())])
    schema = pyarrow.unify_schemas([DRIVE, kinds])
    table = parquet.read_table(out / DRIVES, schema=schema, partitioning=dataset.partitioning(kinds, flavor="hive"))
    yield from table.sort_by([("vehicle", "ascending"), ("start", "ascending"), ("url", "ascending")]).to_pylist()
