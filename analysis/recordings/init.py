"""Write recording.toml for files of your own: a CAN log with its DBC, a table of values, or a log with a table beside.

What the files do not say is given by options, or marked FILL IN; such a recording is refused by the marks' names.
"""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from faultline.analysis.model import Model, load_model
from faultline.analysis.recordings.buses import channels_text
from faultline.analysis.recordings.name_match import Match, match_names
from faultline.analysis.recordings.offered import Came, Offer, came, of_columns, of_dbc, read_dbc, unit_in_name
from faultline.analysis.recordings.track import tracks_of
from faultline.fill_in import MARK, unfilled
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.service.logs import Log, open_log
from faultline.service.logs.opening import open_any
from faultline.service.logs.pieces import Source
from faultline.service.logs.recording import FILE, toml_of
from faultline.service.logs.tables.find import find_table_file
from faultline.service.logs.tables.table import ColumnMap, ValueTable, open_table
from faultline.writing import check_file, write_file

EXAMPLE = """examples:
  faultline ingest --init drive-7/can.blf --system uds --vehicle truck-3 --source "test track" --cycle motorway
  faultline ingest --init week.csv --system systems/house --out recordings/week-31
"""
WITHIN = 0.9
"""Of a column's values, from which on they are taken to be in the model's unit, where the file says none."""
GENERAL = frozenset(("can", "candump", "data", "export", "external", "log", "recording", "signals", "table", "trace"))
"""Names of files that tell nothing: the folder's name is the recording's."""
DATES_S = 1e9
"""From which on a time is one of a calendar, not of a logger's own clock [s]."""


@dataclass(frozen=True)
class _Bus:
    """A CAN log with its DBC: its text, the messages that came and its signals."""

    log: Log
    path: Path
    dbc: Path
    messages: Mapping[str, Came]
    offers: Sequence[Offer]


class _Files(NamedTuple):
    """What is to be described: a CAN log, a table, or both."""

    bus: _Bus | None
    table: ValueTable | None
    time: str | float | None

    @property
    def first(self) -> Path:
        """The file that gives the recording its name."""
        return self.bus.path if self.bus is not None else Path(self.table.where) if self.table is not None else Path()

    @property
    def start_s(self) -> float:
        """The time of the first frame or row [s]."""
        return self.bus.log.start_s if self.bus is not None else self.table.start_s if self.table is not None else 0.0


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: a file cannot be read or there is no DBC that fits, or recording.toml is there already.
    """
    options = _parser().parse_args(argv)
    out: Path = options.out or options.log.parent
    path = out / FILE
    if path.exists() and not options.force:
        raise InputError(f"{path}: is there already; give --force to write it anew, or another folder with --out")
    model = None if options.system is None else load_model(options.system)
    if options.period is not None and (options.time is not None or not 0.0 < options.period < float("inf")):
        raise InputError(f"--period {options.period:g}: a positive number of seconds, and no --time, is wanted")
    files = _files(options.log, options.table, options.dbc, model, options.period or options.time)
    said = {name: getattr(options, name) for name in ("id", "vehicle", "source", "cycle")}
    text = recording_text(files, model, out, said)
    check_file(path)
    write_file(path, text)
    print(f"wrote {path}")
    if marked := list(unfilled(toml_of(text.encode(), path))):
        print(f"to be filled in before it can be used: {', '.join(marked)}")
    else:
        print(f"{out}: {open_log(out).report.summary()}")
    return 0


def _parser() -> Parser:
    parser = Parser("faultline ingest --init", description=__doc__, epilog=EXAMPLE)
    parser.add_argument("log", type=Path, help="a CAN log in any format, or a table of values")
    parser.add_argument("table", type=Path, nargs="?", help="a table of values that belongs to the CAN log")
    parser.add_argument(
        "--system", "--model", help="the system whose signals these are: a folder, file or shipped name"
    )
    parser.add_argument("--dbc", type=Path, help="the log's DBC (the one beside it that fits best)")
    parser.add_argument(
        "--time", metavar="COLUMN", help="the column of the table's times, where its name tells nothing"
    )
    parser.add_argument("--period", type=float, metavar="S", help="seconds from row to row of a table without times")
    parser.add_argument("--out", type=Path, metavar="DIR", help="the recording's folder (that of the log)")
    parser.add_argument("--id", help="the recording's name, as no other one has it (that of the file or folder)")
    parser.add_argument("--vehicle", help="which vehicle, machine or house it is of")
    parser.add_argument("--source", help="where the data are from")
    parser.add_argument("--cycle", help="what was driven or run")
    parser.add_argument("--force", action="store_true", help=f"write over a {FILE} that is there")
    return parser


def _files(log: Path, table: Path | None, dbc: Path | None, model: Model | None, time: str | float | None) -> _Files:
    """Open the files.

    Raises:
        InputError: one cannot be read, the second is no table, or no DBC fits.
    """
    for path in filter(None, (log, table)):
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give the log in it, and the table")
    if table is None and time is not None:
        return _Files(None, _table(log, time), time)
    opened = open_any(log)
    if table is None and not opened.format.has_frames:
        if dbc is not None:
            raise InputError(f"{log}: is a table of values, which has no DBC; leave out --dbc")
        return _Files(None, opened.values, time)
    if not opened.format.has_frames:
        raise InputError(f"{log}: has no CAN frames; give the table alone, or the CAN log before the table")
    wanted = [] if model is None else list(model.known)
    beside = None if table is None else _table(table, time, opened.start_s)
    return _Files(_bus(log, opened, dbc, wanted), beside, time)


def _table(path: Path, time: str | float | None, start_s: float | None = None) -> ValueTable:
    """The table in a file."""
    file = find_table_file(Source(path), time)
    if file is None:
        raise InputError(
            f"{path}: no table of values with a column of times; name that column with --time, or give --period where "
            "rows have none"
        )
    return open_table(str(path), file, start_s=start_s)


def _bus(path: Path, log: Log, dbc: Path | None, wanted: Sequence[str]) -> _Bus:
    """The log with the DBC that fits it best: that has the most of the wanted signals, then of the identifiers."""
    beside = sorted(each for each in path.parent.iterdir() if each.suffix.lower() == ".dbc") if dbc is None else [dbc]
    if not beside:
        raise InputError(f"{path}: no DBC is beside it; give it with --dbc")
    identifiers = {each for found in log.report.channels.values() for each in found}
    found, refused = [], []
    for each in beside:
        try:
            text = read_dbc(each)
            there = came(text, str(each), identifiers)
            bus = _Bus(log, path, each, there, of_dbc(text, str(each), there))
        except InputError as error:
            refused.append(str(error))
            continue
        names = {offer.name for offer in bus.offers}
        seen = {one for message in there.values() for one in message.identifiers}
        found.append((len(names & {*wanted}), len(seen), bus))
    if not found:
        raise InputError("; ".join(refused))
    _, seen_of, best = max(found, key=lambda each: each[:2])
    if not seen_of:
        raise InputError(f"{path}: none of its messages is in {', '.join(map(str, beside))}; give its DBC with --dbc")
    if len(beside) > 1:
        print(f"{best.dbc}: fits best of {len(beside)}, with {seen_of} of {len(identifiers)} identifiers of the log")
    for text in refused:
        print(text)
    return best


def recording_text(files: _Files, model: Model | None, folder: Path, said: Mapping[str, str | None]) -> str:
    """Return the content of recording.toml in `folder`; `said` are fields that a person gave, or None."""
    bus, table = files.bus, files.table
    offers = [*(of_columns(table.file.units) if table is not None else []), *(bus.offers if bus is not None else [])]
    matches = {} if model is None else match_names(model.known, offers)
    added = [] if model is None else [name for name, known in model.known.items() if known.added]
    absent = [name for name in added if matches[name].offer is None and not matches[name].is_alike]
    matches = {name: match for name, match in matches.items() if name not in absent}
    start = datetime.fromtimestamp(files.start_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    head = [
        "schema = 1",
        f"id = {_quoted(said['id'] or _id(files.first, folder))}",
        'kind = "instrumented"',
        f"source = {_given(said['source'], 'where the data are from')}",
        f"vehicle = {_given(said['vehicle'], 'which vehicle, machine or house it is of')}",
        f"cycle = {_given(said['cycle'], 'what was driven or run')}",
        *([f"start = {start}"] if files.start_s > DATES_S else []),
        *_sensor_set(model, absent),
    ]
    parts = ["\n".join(head)]
    if bus is not None:
        own = {name: match for name, match in matches.items() if match.offer is None or match.offer.message}
        parts.append("\n".join(_can_lines(bus, folder, own if table is None else _certain(own), model is not None)))
    if table is not None:
        own = {name: match for name, match in matches.items() if match.offer is None or not match.offer.message}
        parts.append("\n".join(_table_lines(files, table, folder, own, model)))
    return "\n\n".join(parts) + "\n"


def _certain(matches: Mapping[str, Match]) -> dict[str, Match]:
    return {name: match for name, match in matches.items() if match.offer is not None}


def _sensor_set(model: Model | None, absent: Sequence[str]) -> Iterator[str]:
    """Instrumented, unless added sensors of the model are not there."""
    if absent:
        yield f"# Without the added sensors {', '.join(absent)}."
    if model is None:
        yield "# production, where sensors that a model needs were not there."
    yield f'sensor_set = "{"production" if absent else "instrumented"}"'


def _can_lines(bus: _Bus, folder: Path, matches: Mapping[str, Match], has_model: bool) -> Iterator[str]:
    digest = hashlib.sha256(bus.dbc.read_bytes()).hexdigest()
    yield from ("[can]", f"file = {_path(bus.path, folder)}", f"dbc = {_path(bus.dbc, folder)}")
    yield f'dbc_sha256 = "{digest}"'
    references = {offer.reference: offer for offer in bus.offers}
    used = {match.offer.message for match in matches.values() if match.offer is not None}
    yield from channels_text(
        {name: each for name, each in bus.messages.items() if name in used or not has_model}, bus.log
    )
    lines = []
    for name, match in matches.items():
        if match.offer is None:
            lines.append(f"{_key(name)} = {_quoted(f'{MARK}: {match.remark}')}")
        elif match.offer.reference != name:
            lines.append(f"{_key(name)} = {_quoted(references[match.offer.reference].reference)}")
    if lines:
        yield from ("", "[can.signals]", *lines)


def _table_lines(
    files: _Files, table: ValueTable, folder: Path, matches: Mapping[str, Match], model: Model | None
) -> Iterator[str]:
    yield f"# Columns: {', '.join(offer.shown for offer in of_columns(table.file.units))}"
    yield from ("[table]", f"file = {_path(Path(table.where), folder)}")
    if files.time is not None:
        yield f"period_s = {files.time!r}" if isinstance(files.time, float) else f"time = {_quoted(files.time)}"
    yield from _offset(files, table)
    lines = []
    for name, match in matches.items():
        if match.offer is None:
            lines.append(f"{_key(name)} = {_quoted(f'{MARK}: {match.remark}')}")
        elif model is not None:
            lines += _column(name, match, table, model)
    if model is None:
        ends = {name: unit_in_name(name) for name, unit in table.file.units.items() if not unit}
        lines += [f"{_key(name)} = {_map(name, unit)}" for name, unit in ends.items() if unit]
    if lines:
        yield from ("", "[table.signals]", *lines)


def _offset(files: _Files, table: ValueTable) -> Iterator[str]:
    """What has to be known of the table's clock beside a CAN log's: nothing, where the times overlap."""
    if files.bus is None:
        return
    begin, length = files.bus.log.start_s, files.bus.log.duration_s
    if not (table.span[0] < begin + length and table.span[1] > begin):
        remark = (
            f"{MARK}: log time from the first frame on, less the table's [s]; the table is from {table.span[0]:.3f} to "
            f"{table.span[1]:.3f} s, the log {length:.3f} s long"
        )
        yield f"offset_s = {_quoted(remark)}"


def _column(name: str, match: Match, table: ValueTable, model: Model) -> list[str]:
    """The entry of a column that is a signal; none where there is nothing to say."""
    assert match.offer is not None
    column, unit, known = match.offer.name, match.unit, model.known[name]
    if unit is None:
        return [f"{_key(name)} = {_map(column, f'{MARK}: {match.remark}')}"]
    if not unit and (outside := _outside(table, column, known.unit, known.min, known.max)):
        remark = f"{MARK}: the file says none, and {outside} [{known.min:g}, {known.max:g}] {known.unit}"
        return [f"{_key(name)} = {_map(column, remark)}"]
    if not unit and not known.unit:
        return [] if column == name else [f"{_key(name)} = {_quoted(column)}"]
    if not unit:
        remark = f"  # the file names no unit: taken as {known.unit}"
        return [f"{_key(name)} = {_map(column, known.unit)}{remark}"]
    if unit != match.offer.unit:
        return [f"{_key(name)} = {_map(column, unit)}"]
    return [] if column == name else [f"{_key(name)} = {_quoted(column)}"]


def _outside(table: ValueTable, column: str, unit: str, low: float, high: float) -> str:
    """How many of a column's values are outside a range; empty where hardly any is."""
    picked = ValueTable(
        table.where, table.file, {column: ColumnMap(column, unit)}, table.start_s, table.report, table.span
    )
    value = tracks_of(picked.signals({column: unit}), [column])[column].value
    inside = (value >= low) & (value <= high)
    if not len(value) or inside.mean() >= WITHIN:
        return ""
    return f"values from {value.min():g} to {value.max():g} are not within"


def _map(column: str, unit: str) -> str:
    return f"{{ column = {_quoted(column)}, unit = {_quoted(unit)} }}"


def _id(file: Path, folder: Path) -> str:
    """The name of the recording: its folder's, as files of many have one name; the file's where that tells nothing."""
    name = folder.resolve().name
    if name.lower() in GENERAL and folder.resolve() == file.parent.resolve():
        name = file.name.partition(".")[0]
    return re.sub(r"[^A-Za-z0-9._+-]+", "-", name).strip("-._+") or f"{MARK}: a name that no other recording has"


def _given(value: str | None, what: str) -> str:
    return _quoted(f"{MARK}: {what}" if value is None else value)


def _path(path: Path, folder: Path) -> str:
    return _quoted(Path(os.path.relpath(path, folder)).as_posix())


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # a JSON string is a TOML string


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)
