"""Ticks and events of recordings as two Parquet files (extra `columns`), written by row groups.

The columns, with their units and meaning, are in the files' schemas and in docs/diagnose-out.md.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from faultline.service.core.decision.decision import Decision
from faultline.service.core.manifest import EDGE, Manifest
from faultline.service.core.records.event import Diagnosis, Event
from faultline.service.core.records.line import encode
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.values import Quality
from faultline.writing import written_whole

if TYPE_CHECKING:
    import pyarrow

SCHEMA = "faultline.ticks/1"
EVENTS = ".events.parquet"
"""What the file of the events has in place of the ending of the file of the ticks."""
ROWS = 4096
"""Of a row group."""

QUALITIES = [quality.name.lower() for quality in Quality]

Column = tuple[str, str, str, str]
"""Name, type, unit, meaning."""

TICK_COLUMNS: tuple[Column, ...] = (
    ("recording", "text", "", "its id, or the log file's name without ending; its path where that was there before"),
    ("tick", "number", "", "number of the sample, from 0"),
    ("t_s", "float", "s", "time since sample 0, as in events"),
    ("log_s", "float", "s", "time since the first frame or row of the log"),
    ("mode", "text", "", f"operating mode of the system, or {EDGE}: just after a step, or unknown"),
    ("suspected", "flag", "", "something is suspected, and nothing confirmed yet"),
    ("alarm", "texts", "", "tests that alarm"),
    ("cannot_tell", "texts", "", "tests that cannot tell"),
    ("diagnoses", "diagnoses", "", "explanations of a confirmed fault, best first, as in events"),
)
EVENT_COLUMNS: tuple[Column, ...] = (
    ("recording", "text", "", "its id, or the log file's name without ending; its path where that was there before"),
    ("seq", "number", "", "number of the event in its recording, from 1"),
    ("tick", "number", "", "sample at which it was decided"),
    ("t_s", "float", "s", "time since sample 0"),
    ("transition", "text", "", "what changed (docs/events.md)"),
    ("suspected", "flag", "", "something is suspected, and nothing confirmed yet"),
    ("alarm", "texts", "", "tests that alarm"),
    ("cannot_tell", "texts", "", "tests that cannot tell"),
    ("diagnoses", "diagnoses", "", "explanations of a confirmed fault, best first"),
    ("event", "string", "", "the whole event, as `faultline diagnose --json` prints it"),
)


def columns_of(manifest: Manifest) -> list[Column]:
    """Return the columns of a bundle's ticks: of every tick, of its signals and of its residual generators."""
    unit = {channel.signal: channel.unit for channel in manifest.inputs}
    found = list(TICK_COLUMNS)
    for signal in unit:
        found.append((signal, "float", unit[signal], "last good value at or before the tick; null before the first"))
        found.append((f"{signal}.quality", "text", "", f"what it was worth: {', '.join(QUALITIES)}"))
        found.append(
            (f"{signal}.age_s", "float", "s", "time since the frame that the value is of; null before the first")
        )
    for each in manifest.generators:
        of = unit.get(each.predicts, "")
        found.append((f"{each.name}.residual", "float", of, f"{each.predicts}, measured less predicted; null: none"))
        found.append((f"{each.name}.usable", "flag", "", "the residual says something: the test can tell"))
        meaning = "largest statistic of its level detectors in parts of their thresholds, signed: alarms from 1"
        found.append((f"{each.name}.detector", "float", "1", meaning))
    return found


class TickTable:
    """Takes ticks and events of one recording after another, all of bundles with the same columns."""

    def __init__(self, ticks: "_Rows", events: "_Rows", manifest: Manifest) -> None:
        self._ticks, self._events = ticks, events
        self._signals = [channel.signal for channel in manifest.inputs]
        self._generators = [each.name for each in manifest.generators]
        self._period_s, self._modes = manifest.period_s, manifest.modes.names
        self._recording = ""
        self._begun: set[str] = set()

    def begin(self, recording: str, path: str) -> None:
        """Begin a recording: what is added from now on is of it. One whose id was there before is named by its path."""
        self._recording = path if recording in self._begun else recording
        self._begun.add(self._recording)

    def add(self, tick: Tick, decision: Decision) -> None:
        """Add a tick that has ages, with what was decided at it."""
        row: list[object] = [
            self._recording,
            tick.number,
            round(tick.number * self._period_s, 6),
            tick.t_s,
            self._modes[tick.mode],
            decision.suspected,
            decision.alarm,
            decision.cannot_tell,
            _told(decision.diagnoses),
        ]
        for value, quality, age in zip(tick.z.tolist(), tick.quality.tolist(), tick.ages.tolist(), strict=True):
            row += [None if value != value else value, QUALITIES[quality], None if age != age else round(age, 6)]
        said = tick.residuals
        for r, usable, level in zip(said.r.tolist(), said.usable.tolist(), decision.sums.tolist(), strict=True):
            row += [None if r != r else r, usable, level]
        self._ticks.add(row)

    def add_event(self, event: Event) -> None:
        """Add an event."""
        diagnoses = _told(event.diagnoses)
        lists = event.alarm, event.cannot_tell, diagnoses
        told = [event.seq, event.tick, event.t_s, event.transition, event.suspected]
        self._events.add([self._recording, *told, *lists, encode(event).decode().strip()])


def _told(diagnoses: Sequence[Diagnosis]) -> list[Mapping[str, object]]:
    return [{"faults": one.faults, "rank": one.rank, "p": one.p, "near": one.near} for one in diagnoses]


@contextmanager
def tick_table(path: Path, manifest: Manifest) -> Iterator[TickTable]:
    """A table that is written to `path`, and its events beside it, once the context ends without an error.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        OSError: a file cannot be written; what was there is unchanged.
    """
    with (
        written_whole(path) as ticks,
        written_whole(events_path(path)) as events,
        _rows(ticks, columns_of(manifest)) as rows,
        _rows(events, EVENT_COLUMNS) as told,
    ):
        yield TickTable(rows, told, manifest)


def events_path(path: Path) -> Path:
    """The file of the events beside that of the ticks.

    >>> events_path(Path("out/drive.parquet")).name
    'drive.events.parquet'
    """
    return path.with_name(path.stem + EVENTS)


@dataclass
class _Rows:
    """Rows that are written once there are enough. State: those that are not written yet."""

    writer: Any
    schema: "pyarrow.Schema"
    waiting: list[list[object]] = field(default_factory=list)

    def add(self, row: list[object]) -> None:
        self.waiting.append(row)
        if len(self.waiting) >= ROWS:
            self.write()

    def write(self) -> None:
        import pyarrow

        if self.waiting:
            columns = zip(*self.waiting, strict=True)
            arrays = [pyarrow.array(column, each.type) for column, each in zip(columns, self.schema, strict=True)]
            self.writer.write_batch(pyarrow.RecordBatch.from_arrays(arrays, schema=self.schema))
            self.waiting.clear()


@contextmanager
def _rows(path: Path, columns: Sequence[Column]) -> Iterator[_Rows]:
    import pyarrow
    from pyarrow import parquet

    text = pyarrow.string()  # Parquet packs what repeats by itself
    texts = pyarrow.list_(pyarrow.string())
    one = pyarrow.struct([("faults", texts), ("rank", pyarrow.int32()), ("p", pyarrow.float64()), ("near", texts)])
    types = {
        "text": text,
        "string": pyarrow.string(),
        "number": pyarrow.int64(),
        "float": pyarrow.float64(),
        "flag": pyarrow.bool_(),
        "texts": texts,
        "diagnoses": pyarrow.list_(one),
    }
    fields = [
        pyarrow.field(name, types[kind], metadata={"unit": unit, "meaning": meaning})
        for name, kind, unit, meaning in columns
    ]
    schema = pyarrow.schema(fields, metadata={"schema": SCHEMA})
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        rows = _Rows(writer, schema)
        yield rows
        rows.write()
