"""A recording: a folder with `recording.toml`, a CAN log with its DBC, or a table, and a bench's second logger's file.

Kind *bench*: the CAN log holds the vehicle's own frames only; the added sensors are in the external file, in volts, on
another clock. Kind *instrumented*: everything is on CAN, or in a table; only these are diagnosed.
"""

import hashlib
import tomllib
from collections.abc import Iterator, Mapping
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from faultline.fill_in import unfilled
from faultline.service.logs.report import LogError
from faultline.service.logs.tables.table import ColumnMap

FILE = "recording.toml"
SCHEMA = 1

Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$")]
"""Usable as a folder's name."""
Sha256 = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Common strictness: no field unknown, nothing changes after loading."""


Address = Annotated[int, msgspec.Meta(ge=0, le=253)]
"""A source address of SAE J1939."""


class Can(_Part, frozen=True):
    """The CAN log (candump format) and its DBC, both relative to the folder; the DBC's SHA-256 in hexadecimal.

    `bench_sha256` is that of the bench's own CAN log, where this recording was ingested from it: ingested again, with
    another clock, the log is another one, but the drive is the same. `signals` are the DBC's names, SIGNAL or
    MESSAGE.SIGNAL, of those signals that have other ones there. `channel` is the bus to take of a log of several.
    `senders` are the source addresses to take of messages that several devices send, by the messages' names. Where the
    signals are on several buses, `buses` are the channels of those with a name, and `messages` name the bus of a
    message.
    """

    file: str
    dbc: str
    dbc_sha256: Sha256
    bench_sha256: Sha256 | None = None
    channel: str | None = None
    signals: dict[str, str] = {}
    senders: dict[str, Address] = {}
    buses: dict[str, str] = {}
    messages: dict[str, str] = {}


def is_simulated(source: str) -> bool:
    """Return True if a recording's `source` says that it is simulated.

    >>> is_simulated("simulated by the rig; ingested"), is_simulated("truck 17, winter")
    (True, False)
    """
    return "simulat" in source.lower()


class Columns(_Part, frozen=True):
    """A table of values (CSV, Parquet, MF4), relative to the folder: which columns are signals, and its clock.

    `time` names the column of the times, where its name does not say so; where there is none `period_s` lies between
    two rows. `signals` give the column by the signal's name; without an entry a column is the signal of its own name.
    Log time = `offset_s` + the table's time; without it the table's clock is that of the CAN log beside it, or begins
    with its own first row.
    """

    file: str
    time: str | None = None
    period_s: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    offset_s: float | None = None
    signals: dict[str, str | ColumnMap] = {}

    @property
    def maps(self) -> dict[str, ColumnMap]:
        """The columns by the signals' names."""
        return {name: ColumnMap(each) if isinstance(each, str) else each for name, each in self.signals.items()}


class Table(_Part, frozen=True):
    """Calibration table of a column, from volts to pascal: piecewise linear, from the sensor's datasheet."""

    column: str
    volts: Annotated[list[float], msgspec.Meta(min_length=2)]
    pascal: Annotated[list[float], msgspec.Meta(min_length=2)]


class External(_Part, frozen=True):
    """The second logger's CSV: its own clock in `time_column` [s] and one table per signal."""

    file: str
    time_column: str
    unit: Literal["V"]
    tables: dict[str, Table]


class Recording(_Part, frozen=True, kw_only=True):
    """Content of `recording.toml`. `id` is unique; `start` is the wall clock at the first frame.

    The signals are in a CAN log, in a table, or in both.
    """

    schema: int
    id: Name
    kind: Literal["bench", "instrumented"]
    source: str
    vehicle: str
    cycle: str
    start: datetime | None = None
    sensor_set: Literal["instrumented", "production"]
    can: Can | None = None
    table: Columns | None = None
    external: External | None = None

    @property
    def file(self) -> str:
        """The name of the file that the recording is known by: its CAN log, else its table."""
        return self.can.file if self.can is not None else self.table.file if self.table is not None else ""

    @property
    def can_log(self) -> Can:
        """The CAN log.

        Raises:
            LogError: there is none.
        """
        if self.can is None:
            raise LogError(
                f"{self.id}: its signals are in a table, and this needs a CAN log; give a recording with one"
            )
        return self.can

    def check_sensors(self, folder: Path, needed: str, what: str) -> None:
        """Refuse a recording without the added sensors, where `what`, for the sensor set `needed`, has them.

        Raises:
            LogError: the recording is of fewer sensors.
        """
        if (self.sensor_set, needed) == ("production", "instrumented"):
            raise LogError(
                f"{folder / FILE}: sensor_set is 'production', {what} needs 'instrumented'; give recordings of an "
                "instrumented vehicle, or tune and export a model without the added sensors (docs/tuning.md)"
            )


def load_recording(folder: Path) -> Recording:
    """Load the description of a recording whose files are all there and whose DBC is the one it was made with.

    Raises:
        LogError: something is missing, unknown, contradictory or changed; the message names the path in the file.
    """
    path = folder / FILE
    recording = _decode(
        _read(path, "is this a recording's folder? `faultline ingest --init LOG` writes one for files of your own"),
        path,
    )
    _check(recording, path)
    if recording.table:
        _read(folder / recording.table.file, f"{FILE} names it as the table", size=1)
    if recording.external:
        _read(folder / recording.external.file, "a bench recording needs the second logger's file", size=1)
    if recording.can:
        _check_can(recording.can, folder)
    return recording


def _check_can(can: Can, folder: Path) -> None:
    _read(folder / can.file, f"{FILE} names it as the CAN log", size=1)
    digest = hashlib.sha256(_read(folder / can.dbc, f"{FILE} names it as the log's DBC")).hexdigest()
    if digest != can.dbc_sha256:
        raise LogError(
            f"{folder / can.dbc}: not the DBC of this recording (SHA-256 {digest[:12]}, can.dbc_sha256 says "
            f"{can.dbc_sha256[:12]}); put the original back"
        )


def _read(path: Path, remedy: str, size: int = -1) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(size)
    except FileNotFoundError as error:
        raise LogError(f"{path}: not found; {remedy}") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}; {remedy}") from error


def toml_of(raw: bytes, path: Path) -> dict[str, object]:
    """Return the tables of a file.

    Raises:
        LogError: it is no TOML.
    """
    try:
        return tomllib.loads(raw.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: not valid TOML: {error}") from error


def _decode(raw: bytes, path: Path) -> Recording:
    tree = toml_of(raw, path)
    try:
        schema = tree.get("schema", SCHEMA)
        if schema != SCHEMA:
            raise LogError(f"{path}: schema is {schema!r}, this faultline reads {SCHEMA}")
        if lacking := _lacking(tree):
            raise LogError(f"{path}: {lacking}")
        return msgspec.convert(tree, Recording)
    except msgspec.ValidationError as error:
        raise LogError(f"{path}: {str(error).replace('`$.', '`').replace('$.', '')}") from error


def _lacking(tree: Mapping[str, object]) -> str:
    """Return a sentence that names every required field that is absent, and every one that is still marked."""
    absent, marked = ", ".join(_absent(tree)), ", ".join(unfilled(tree))
    said = [f"required and not there: {absent}; add them, or let `faultline ingest --init` write it"] if absent else []
    return "; ".join(said + ([f"still to be filled in: {marked}"] if marked else []))


def _absent(tree: Mapping[str, object]) -> Iterator[str]:
    """Yield the places of required fields that a file lacks."""
    external = tree.get("external")
    tables = external.get("tables") if isinstance(external, dict) else None
    parts: list[tuple[str, object, type[_Part]]] = [("", tree, Recording), ("external.", external, External)]
    parts += [("can.", tree.get("can"), Can), ("table.", tree.get("table"), Columns)]
    parts += [
        (f"external.tables.{name}.", each, Table) for name, each in (tables.items() if isinstance(tables, dict) else ())
    ]
    for place, part, form in parts:
        if isinstance(part, dict):
            fields = msgspec.structs.fields(form)
            yield from (place + each.name for each in fields if each.required and each.name not in part)


def _check(recording: Recording, path: Path) -> None:
    """Check what the types do not express."""
    if recording.can is None and (recording.table is None or recording.kind == "bench"):
        needs = "bench recording has" if recording.kind == "bench" else "recording has a [table] or"
        raise LogError(f"{path}: there is no [can]; a {needs} a CAN log: name it there")
    if recording.kind == "bench" and recording.external is None:
        raise LogError(f"{path}: kind is bench but there is no [external]; name the second logger's file there")
    if recording.kind == "instrumented" and recording.external is not None:
        raise LogError(f"{path}: kind is instrumented but there is an [external]; one of the two is wrong")
    for signal, table in (recording.external.tables if recording.external else {}).items():
        place = f"{path}: external.tables.{signal}"
        if len(table.volts) != len(table.pascal):
            raise LogError(f"{place}: {len(table.volts)} volts for {len(table.pascal)} pascal; give them in pairs")
        if any(high <= low for low, high in pairwise(table.volts)):
            raise LogError(f"{place}.volts: must increase from point to point")
