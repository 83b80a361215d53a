"""Writers of logs, by format.

ASC, BLF, CSV and MF4 are python-can's. Its writer of SQLite loses rows when it ends, that of TRC knows no CAN FD, and
that of candump no flags: those are ours.
"""

import importlib
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from faultline.service.logs.batch import CLASSIC_BYTES, ERROR, EXTENDED, FD, FD_SIZES, REMOTE, SENT, Batch
from faultline.service.logs.log import Log
from faultline.service.logs.parquet import parquet_writer

_ERROR_FLAG = 0x2000_0000
_EPOCH = datetime(1899, 12, 30, tzinfo=UTC)
_DAY_S = 86400.0
_CODES = {size: code for code, size in enumerate(sorted(FD_SIZES))}  # data length code, by bytes


class Row(NamedTuple):
    """A frame with all that a log says of it: time [s], index of its channel, identifier, flags, length, data."""

    t: float
    channel: int
    identifier: int
    flags: int
    length: int
    data: bytes


def rows(batch: Batch) -> Iterator[Row]:
    """Each frame of a batch; remote and error frames have no data."""
    raw, width = batch.data.tobytes(), batch.data.shape[1]
    there = np.where(batch.has_data, batch.length, 0).tolist()
    names = ("time", "channel", "identifier", "flags", "length")
    for k, (count, *values) in enumerate(zip(there, *(getattr(batch, name).tolist() for name in names), strict=True)):
        t, channel, identifier, flags, length = values
        yield Row(t, channel, identifier, flags, length, raw[width * k : width * k + count])


def _all_rows(log: Log) -> Iterator[Row]:
    for batch in log.batches():
        yield from rows(batch)


def write_candump(log: Log, path: Path) -> None:
    """As `candump -L`; as on the screen where the log has no times."""
    line = _log_line if log.format.has_times else _screen_line
    names = [name.replace(" ", "_") or "can0" for name in log.channels]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for batch in log.batches():
            file.writelines([line(row, names[row.channel]) for row in rows(batch)])


def _name(row: Row) -> str:
    if row.flags & ERROR:
        return f"{row.identifier | _ERROR_FLAG:08X}"
    return f"{row.identifier:08X}" if row.flags & EXTENDED else f"{row.identifier:03X}"


def _log_line(row: Row, channel: str) -> str:
    if row.flags & ERROR:
        data = "#" + row.data.hex().upper().ljust(2 * CLASSIC_BYTES, "0")
    elif row.flags & REMOTE:
        data = f"#R{row.length or ''}"
    else:
        data = ("##0" if row.flags & FD else "#") + row.data.hex().upper()
    return f"({row.t:.6f}) {channel} {_name(row)}{data}{' T' if row.flags & SENT else ''}\n"


def _screen_line(row: Row, channel: str) -> str:
    length = f"[{row.length:02d}]" if row.flags & FD else f"[{row.length}]"
    sent = "TX - -  " if row.flags & SENT else ""
    data = " ".join(f"{byte:02X}" for byte in row.data)
    if row.flags & ERROR:
        length, data = f"[{CLASSIC_BYTES}]", " ".join(["00"] * CLASSIC_BYTES) + "   ERRORFRAME"
    elif row.flags & REMOTE:
        data = "remote request"
    return f"  {channel}  {sent}{_name(row)}  {length}  {data}\n"


def write_trc(log: Log, path: Path) -> None:
    """As version 2.1, with time offsets of 1 us."""
    start = log.start_s
    with path.open("w", encoding="ascii", newline="\r\n") as file:
        days = start / _DAY_S - _EPOCH.timestamp() / _DAY_S
        file.write(f";$FILEVERSION=2.1\n;$STARTTIME={days:.10f}\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n")
        begin = (float(f"{days:.10f}") + _EPOCH.timestamp() / _DAY_S) * _DAY_S
        for number, row in enumerate(_all_rows(log), start=1):
            kind = "ER" if row.flags & ERROR else "RR" if row.flags & REMOTE else "FD" if row.flags & FD else "DT"
            name = f"{row.identifier:08X}" if row.flags & EXTENDED else f"{row.identifier:04X}"
            sent = "Tx" if row.flags & SENT else "Rx"
            offset = max(0.0, 1000.0 * (row.t - begin))
            data = " ".join(f"{byte:02X}" for byte in row.data)
            head = f"{number:7} {offset:13.3f} {kind} {row.channel + 1:2} {name:>8} {sent}"
            file.write(f"{head} -  {_CODES[row.length]:2}    {data}\n")


def write_db(log: Log, path: Path) -> None:
    """As python-can's table of messages."""
    path.unlink(missing_ok=True)  # SQLite would take the empty file, but not that of another format
    try:
        with closing(sqlite3.connect(path)) as connection, connection:
            connection.execute(
                "CREATE TABLE messages (ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, "
                "error INTEGER, dlc INTEGER, data BLOB)"
            )
            connection.executemany(
                "INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)",
                (
                    (
                        r.t,
                        r.identifier,
                        r.flags & EXTENDED,
                        bool(r.flags & REMOTE),
                        bool(r.flags & ERROR),
                        r.length,
                        r.data,
                    )
                    for r in _all_rows(log)
                ),
            )
    except sqlite3.OperationalError as error:
        raise OSError(0, str(error), str(path)) from error


def write_parquet(log: Log, path: Path) -> None:
    """As columns (`logs.parquet`)."""
    with parquet_writer(path) as write:
        write(log.batches(), log.channels)


def _through_python_can(kind: str) -> Callable[[Log, Path], None]:
    def write(log: Log, path: Path) -> None:
        import can

        writers: dict[str, Callable[[Path], Any]] = {
            "asc": can.ASCWriter,
            "blf": can.BLFWriter,
            "csv": can.CSVWriter,
        }
        if kind == "mf4":
            import asammdf  # noqa: F401 python-can says less of what is missing
            import can.io.mf4

            writers["mf4"] = importlib.reload(can.io.mf4).MF4Writer  # it was imported without asammdf
        with writers[kind](path) as writer:
            for row in _all_rows(log):
                writer.on_message_received(
                    can.Message(
                        timestamp=row.t,
                        arbitration_id=row.identifier,
                        is_extended_id=bool(row.flags & EXTENDED),
                        is_remote_frame=bool(row.flags & REMOTE),
                        is_error_frame=bool(row.flags & ERROR),
                        is_fd=bool(row.flags & FD),
                        is_rx=not row.flags & SENT,
                        dlc=row.length,
                        data=row.data,
                        channel=row.channel + (kind == "mf4"),  # the others count from 1 themselves
                    )
                )

    return write


class Target(NamedTuple):
    """A format to convert to: its ending, its writer, what it cannot hold of all logs, and of some.

    `flags` are kept; `names_channels` and `has_channels` say whether channels are kept by name or by number;
    `decimals` of a second are kept, 9 being all that a log has.
    """

    ending: str
    write: Callable[[Log, Path], None]
    flags: int
    has_channels: bool
    names_channels: bool
    decimals: int
    is_absolute: bool = True
    needs_times: bool = True


_ALL = EXTENDED | FD | REMOTE | ERROR | SENT
TARGETS = {
    "candump": Target(".log", write_candump, _ALL, True, True, 6, needs_times=False),
    "asc": Target(".asc", _through_python_can("asc"), _ALL, True, False, 6, is_absolute=False),
    "blf": Target(".blf", _through_python_can("blf"), _ALL, True, False, 9),
    "trc": Target(".trc", write_trc, _ALL, True, False, 6),
    "csv": Target(".csv", _through_python_can("csv"), _ALL & ~SENT, False, False, 9),
    "db": Target(".db", write_db, _ALL & ~SENT, False, False, 9),
    "mf4": Target(".mf4", _through_python_can("mf4"), _ALL, True, False, 9),
    "parquet": Target(".parquet", write_parquet, _ALL, True, True, 9, needs_times=False),
}
