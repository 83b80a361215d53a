"""The formats of logs. A file's content says which it is; its name breaks a tie, and decides where nothing does."""

from collections.abc import Callable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from faultline.service.logs.asc import Asc
from faultline.service.logs.batch import Batch
from faultline.service.logs.blf import read_blf
from faultline.service.logs.candump import CandumpLog, CandumpScreen
from faultline.service.logs.channels import Channels
from faultline.service.logs.delimited import PythonCanCsv, TableCsv, find_table
from faultline.service.logs.mf4 import MF4_MAGIC, read_mf4
from faultline.service.logs.parquet import PARQUET_MAGIC, read_parquet
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogError, LogReport
from faultline.service.logs.sqlite import SQLITE_MAGIC, read_sqlite
from faultline.service.logs.text import Dialect, read_text
from faultline.service.logs.trc import Trc

Reader = Callable[[Source, LogReport, Channels], Iterator[Batch]]
"""Gives the frames of a file in its order, with the times that it has, and reports what is lost."""

_HEAD_LINES = 40
_SEARCHED = 8  # pieces of a text in which a line of any format is looked for
_RISING = 0.8  # of the times; of those since the frame before, half
_LEAST = 8  # times by which it is known whether they rise


class Format(NamedTuple):
    """A format: its name, how it is read, whether its frames have times, and whether it has frames at all."""

    name: str
    read: Reader
    has_times: bool = True
    has_frames: bool = True


BINARY = (
    Format("BLF", read_blf),
    Format("DB", read_sqlite),
    Format("MF4", read_mf4),
    Format("PARQUET", read_parquet),
)
_MAGIC = {b"LOGG": "BLF", SQLITE_MAGIC: "DB", **dict.fromkeys(MF4_MAGIC, "MF4"), PARQUET_MAGIC: "PARQUET"}
_OBJECT = b"LOBJ"
_SUFFIXES = {
    ".asc": "ASC",
    ".blf": "BLF",
    ".csv": "CSV",
    ".db": "DB",
    ".mf4": "MF4",
    ".mdf": "MF4",
    ".parquet": "PARQUET",
    ".sqlite": "DB",
    ".trc": "TRC",
}


def format_of(source: Source) -> Format:
    """The format of a log file."""
    binary = {each.name: each for each in BINARY}
    name = next((name for magic, name in _MAGIC.items() if source.head.startswith(magic)), None)
    if name is not None:
        return binary[name]
    named = _SUFFIXES.get(ending(source.path), "candump")
    for head in chain([source.head], islice(source.pieces(LogReport()), _SEARCHED)):
        candidates = _candidates(head)
        lines = _lines(head)
        scores = {}
        for name in sorted(candidates, key=lambda each: not each.startswith(named)):
            scores[name] = _score(candidates[name](), lines)
            if scores[name][1] == len(lines):  # as of nearly all files under their own name
                break
        best = max(scores.values())
        if best > (0, 0):
            likely = [name for name, score in scores.items() if score == best]
            name = next((each for each in likely if each.startswith(named)), likely[0])
            return _text(name, candidates[name])
    if named in binary or _OBJECT in source.head:
        return binary.get(named, binary["BLF"])
    return _text(named, _candidates(source.head)[named])


def ending(path: Path) -> str:
    """The ending of a file's name, without that of its compression."""
    return (path.with_suffix("") if path.suffix.lower() == ".gz" else path).suffix.lower()


def _text(name: str, make: Callable[[], Dialect]) -> Format:
    def read(source: Source, report: LogReport, channels: Channels) -> Iterator[Batch]:
        return read_text(source, report, channels, make())

    return Format(name, read, getattr(make(), "has_times", True))


def _candidates(head: bytes) -> dict[str, Callable[[], Dialect]]:
    """Each text format as its head shows it."""
    found: dict[str, Callable[[], Dialect]] = {
        "candump": lambda: CandumpLog(is_relative=_sums_up(head, CandumpLog())),
        "candump screen": lambda: CandumpScreen(is_relative=_sums_up(head, CandumpScreen())),
        "candump screen without times": lambda: CandumpScreen(has_times=False),
        "ASC": Asc,
        "TRC": Trc,
        "CSV": PythonCanCsv,
    }
    table = find_table(head)
    if table is not None:
        found["CSV table"] = lambda: TableCsv(table, head)
    return found


def _lines(head: bytes) -> list[bytes]:
    """The first lines that are not blank; the last one may be cut off."""
    lines = head.split(b"\n", _HEAD_LINES)[:-1] or [head]
    return [line for line in lines if line.strip(b"\0 \t\r")]


def _score(dialect: Dialect, lines: list[bytes]) -> tuple[int, int]:
    """How many of the lines hold a frame, and how many it knows at all."""
    frames = known = 0
    for line in lines:
        try:
            if line.startswith(dialect.headers):
                dialect.header(line.strip())
            else:
                frames += dialect.read(line.lstrip(b"\0")) is not None
        except ValueError:
            continue
        except LogError:  # of a version that is not known
            pass
        known += 1
    return frames, known


def _sums_up(head: bytes, dialect: Dialect) -> bool:
    """True if candump's times are those since the frame before (`-t d`): they do not rise from frame to frame."""
    times = []
    for line in _lines(head):
        try:
            found = dialect.read(line)
        except ValueError:
            continue
        times += [found.time] if found is not None else []
    steps = np.diff(times)
    is_small = bool(times) and max(times) < 1e6  # not since 1970
    return is_small and len(times) >= _LEAST and bool(np.mean(steps > 0) < _RISING) and max(times) > 0
