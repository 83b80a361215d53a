"""A recording: a folder with `recording.toml`, a CAN log, its DBC and, from a bench, the second logger's file.

Kind *bench*: the CAN log holds the vehicle's own frames only; the added sensors are in the external file, in volts, on
another clock. Kind *instrumented*: everything is on CAN; only these are replayed and diagnosed.
"""

import hashlib
import tomllib
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from faultline.service.logs.report import LogError

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
    another clock, the log is another one, but the drive is the same. `channel` is the bus to take of a log of several.
    `senders` are the source addresses to take of messages that several devices send, by the messages' names.
    """

    file: str
    dbc: str
    dbc_sha256: Sha256
    bench_sha256: Sha256 | None = None
    channel: str | None = None
    senders: dict[str, Address] = {}


class Table(_Part, frozen=True):
    """How a column's volts become pascal: piecewise linear through these points, from the sensor's datasheet."""

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
    """What `recording.toml` says. `id` is unique; `start` is the wall clock at the first frame."""

    schema: int
    id: Name
    kind: Literal["bench", "instrumented"]
    source: str
    vehicle: str
    cycle: str
    start: datetime | None = None
    sensor_set: Literal["instrumented", "production"]
    can: Can
    external: External | None = None

    def check_sensors(self, folder: Path, needed: str, what: str) -> None:
        """Whether this recording in `folder` has the added sensors, where `what`, for the sensor set `needed`, does.

        Raises:
            LogError: the recording is of fewer sensors.
        """
        if (self.sensor_set, needed) == ("production", "instrumented"):
            raise LogError(
                f"{folder / FILE}: sensor_set is 'production', {what} needs 'instrumented'; give recordings of an "
                "instrumented vehicle, or tune and export a model without the added sensors (docs/tuning.md)"
            )


def load_recording(folder: Path) -> Recording:
    """The description of a recording whose files are all there and whose DBC is the one it was made with.

    Raises:
        LogError: something is missing, unknown, contradictory or changed; the message names the path in the file.
    """
    path = folder / FILE
    recording = _decode(_read(path, "is this a recording's folder?"), path)
    _check(recording, path)
    _read(folder / recording.can.file, f"{FILE} names it as the CAN log", size=1)
    if recording.external:
        _read(folder / recording.external.file, "a bench recording needs the second logger's file", size=1)
    dbc = _read(folder / recording.can.dbc, f"{FILE} names it as the log's DBC")
    digest = hashlib.sha256(dbc).hexdigest()
    if digest != recording.can.dbc_sha256:
        raise LogError(
            f"{folder / recording.can.dbc}: not the DBC of this recording (SHA-256 {digest[:12]}, can.dbc_sha256 says "
            f"{recording.can.dbc_sha256[:12]}); put the original back"
        )
    return recording


def _read(path: Path, remedy: str, size: int = -1) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(size)
    except FileNotFoundError as error:
        raise LogError(f"{path}: not found; {remedy}") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}; {remedy}") from error


def _decode(raw: bytes, path: Path) -> Recording:
    try:
        tree = tomllib.loads(raw.decode())
        schema = tree.get("schema")
        if schema != SCHEMA:
            raise LogError(f"{path}: schema is {schema!r}, this faultline reads {SCHEMA}")
        return msgspec.convert(tree, Recording)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: not valid TOML: {error}") from error
    except msgspec.ValidationError as error:
        raise LogError(f"{path}: {str(error).replace('`$.', '`').replace('$.', '')}") from error


def _check(recording: Recording, path: Path) -> None:
    """What the types alone cannot say."""
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
