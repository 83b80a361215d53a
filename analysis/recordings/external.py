"""The second logger's volts as pressures: each column through its sensor's table, and what of it cannot be believed."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from faultline.analysis.recordings.rows import read_rows
from faultline.service.core.errors import InputError
from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.recording import External, Table

OTHER_UNIT = 20.0  # times the table's highest voltage: no sensor gives that, another unit does
LEAST_WITHIN = 0.1  # of all values, else it is another unit: a wire that is off for most of a day is none to use
STUCK = 1e-6  # of the pressure: a sensor's noise is more


class ChannelError(InputError):
    """A column that cannot be what `recording.toml` says it is."""


@dataclass(frozen=True)
class Channel:
    """An added sensor's pressures (N,) [Pa], NaN where it has none.

    `blank` cells held no number, `outside` ones lay beyond its `table`, as with a wire that is off or shorted.
    """

    pressure: FloatArray
    table: Table
    blank: int
    outside: int


@dataclass(frozen=True)
class Samples:
    """Samples on the second logger's clock: `t` (N,) [s], increasing, and the sensors by signal.

    `bad_rows` of the file could not be used; `told` is the first of them.
    """

    t: FloatArray
    channels: dict[str, Channel]
    bad_rows: int
    told: str


def read_external(folder: Path, external: External) -> Samples:
    """The samples of a bench recording's second logger.

    Raises:
        LogError: the file is not such a CSV, lacks a column, has too many bad rows or a clock that was set.
        ChannelError: a column is in another unit, or its sensor is stuck.
    """
    path = folder / external.file
    rows = read_rows(path, external.time_column, [table.column for table in external.tables.values()])
    channels = {
        signal: _channel(volts, table, f"{path}: {table.column} ({signal})")
        for (signal, table), volts in zip(external.tables.items(), rows.columns[1:], strict=True)
    }
    return Samples(rows.columns[0], channels, rows.bad, rows.told)


def _channel(volts: FloatArray, table: Table, where: str) -> Channel:
    """Piecewise linear; NaN outside the table, where the sensor or its wire is broken."""
    known = np.isfinite(volts)
    pressure = np.interp(volts, table.volts, table.pascal, left=np.nan, right=np.nan)
    outside = int((known & np.isnan(pressure)).sum())
    if np.isfinite(pressure).sum() < max(2.0, LEAST_WITHIN * known.sum()):
        middle = float(np.median(volts[known])) if known.any() else np.nan
        likely = ", which looks like mV, give V" if middle > OTHER_UNIT * table.volts[-1] else ""
        within = int(np.isfinite(pressure).sum())
        raise ChannelError(
            f"{where}: only {within} of {known.sum()} values are within its table, {table.volts[0]:g} to "
            f"{table.volts[-1]:g} V; the median is {middle:g}{likely}; check column, unit and table, or leave the "
            "sensor out of external.tables"
        )
    if np.nanmax(pressure) - np.nanmin(pressure) <= STUCK * abs(float(np.nanmax(pressure))):
        raise ChannelError(
            f"{where}: is constant at {np.nanmax(pressure) / 1e5:.3f} bar; the sensor or the logger's channel is "
            "stuck: check it, or leave the sensor out of external.tables"
        )
    return Channel(pressure, table, int((~known).sum()), outside)
