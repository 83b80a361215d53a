"""Rows of a table: times, and what its columns had then."""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.report import LogReport

TIME_UNITS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "ns": 1e9, "min": 1 / 60}
"""How many there are in a second."""
_TIMES = frozenset(("t", "ts", "epoch", "date", "datetime", "zeit", "elapsed", "elapsedtime", "logs", "offset"))
_TITLE = re.compile(r"([^\[(]*?)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*")


class TableRows(NamedTuple):
    """N rows: log times (N,) [s], and by column its values (N,): NaN: there is none; infinite: it is no number."""

    time: FloatArray
    values: Mapping[str, FloatArray]


class TableFile(Protocol):
    """A file that holds a table, or several with clock rates of their own.

    `kind` is its format's name, `units` are those of its columns by name as the file has them (empty where it has
    none), without the times.
    """

    @property
    def kind(self) -> str:
        """The name of its format."""

    @property
    def units(self) -> Mapping[str, str]:
        """The units of its columns by name."""

    def streams(self, names: Collection[str], report: LogReport) -> Sequence[Iterator[TableRows]]:
        """Return the rows of each table with any of these columns, of all tables where `names` is empty.

        Raises:
            LogError: the file cannot be read any more; the message does not name it.
        """


def title(text: str) -> tuple[str, str]:
    """Return a title's name and unit.

    >>> title("p_du [kPa]"), title("speed (1/min) "), title("q")
    (('p_du', 'kPa'), ('speed', '1/min'), ('q', ''))
    """
    match = _TITLE.fullmatch(text.strip())
    return (match[1].strip(), match[2] or "") if match else (text.strip(), "")


def distinct(names: Sequence[str]) -> list[str]:
    """Return names of which each is one column's: those that several columns have get its number, from 1.

    >>> distinct(["t", "p", "q", "p"])
    ['t', 'p (column 2)', 'q', 'p (column 4)']
    """
    counts = Counter(names)
    return [f"{name} (column {k})" if counts[name] > 1 and name else name for k, name in enumerate(names, 1)]


def is_time(name: str) -> bool:
    """True of a column's name that says that it is the time.

    >>> [is_time(name) for name in ("time_exp", "Timestamp", "t", "torque", "log_s", "t_ms")]
    [True, True, True, False, True, True]
    """
    plain = re.sub(r"[\s_]", "", name.lower())
    front, _, unit = name.rpartition("_")
    return plain in _TIMES or plain.startswith("time") or (front in _TIMES and unit in TIME_UNITS and unit != "min")


def per_second(name: str, unit: str) -> float:
    """Return how many units of a time are in a second, by its unit, or what its name ends with; 1.0 if none says it.

    >>> per_second("t", "ms"), per_second("time_us", ""), per_second("t", "")
    (1000.0, 1000000.0, 1.0)
    """
    return TIME_UNITS.get(unit or name.rpartition("_")[2], 1.0)
