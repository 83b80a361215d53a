"""Diagnosis of one drive, in a worker: its rows are on the disk when it returns."""

import hashlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from faultline.analysis.compiled.apart import kernels_apart
from faultline.analysis.compiled.decision import NATIVE
from faultline.analysis.compiled.elements import NotCompiledError
from faultline.analysis.compiled.evaluator import CompiledEvaluator
from faultline.analysis.compiled.kernels import Kernels
from faultline.analysis.fleet import tables
from faultline.analysis.fleet.drives import VEHICLE, Drive, at_hand, date_of, digest, safe, start_of
from faultline.analysis.fleet.identity import identity_of
from faultline.service.bundle.files import whole
from faultline.service.bundle.load import Bundle, check_fits, load_bundle, verify_golden
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Diagnosis, Event
from faultline.service.core.records.line import encode
from faultline.service.core.verdict import Verdict
from faultline.service.distribution import installed_version
from faultline.service.logs import Log, open_log
from faultline.service.logs.recording import is_simulated, load_recording

FAILED = "failed"
FORM = "1"
"""Of the rows: those of another form are made again."""


@dataclass(frozen=True)
class Wish:
    """Every drive is diagnosed with the bundle at this path, and its rows are written under `out`.

    They have VIN and position where these are `asked` for (`analysis.fleet.identity`).
    """

    bundle: str
    out: Path
    asked: tuple[str, ...] = ()


class Outcome(NamedTuple):
    """Of a drive: whether it was done before, what its verdict is, and how many hours it has."""

    drive: Drive
    is_old: bool
    verdict: str
    hours: float


def diagnosed(drives: Sequence[Drive], wish: Wish) -> list[Outcome]:
    """Diagnose these drives, but for those that were with the same bundle and version.

    Raises:
        OSError: rows cannot be written.
    """
    return [_diagnosed(drive, wish) for drive in drives]


def lost(drives: Sequence[Drive], wish: Wish) -> list[Outcome]:
    """Write the rows of drives at which workers died.

    Raises:
        OSError: one cannot be written.
    """
    reason = "the workers that were at it died: too little memory?"
    return [_write(wish, drive, drive.folder_name, _unread(drive, wish), _failed(reason)) for drive in drives]


def _diagnosed(drive: Drive, wish: Wish) -> Outcome:
    began = time.process_time()
    key, vehicle = "", drive.folder_name
    try:
        with at_hand(drive) as path:
            vehicle = load_recording(path).vehicle if drive.is_folder else vehicle
            folder = Path(wish.bundle.replace(VEHICLE, safe(vehicle)))
            key = _key(digest(path), _bundle_id(folder), vehicle)
            if there := tables.files_of(wish.out, vehicle, key):
                verdict, hours, asked = tables.verdict_in(there[0])
                # what failed may have had another cause than the log
                if verdict != FAILED and {*asked} == {*wish.asked}:
                    return Outcome(drive, True, verdict, hours)
            made = _made(path, folder, wish.asked)
    except Exception as error:  # noqa: BLE001  of thousands of logs one must not end the others: the row says it
        known = isinstance(error, InputError | OSError)
        made = _failed(str(error) if known else f"a defect of faultline, please report it: {error!r}")
        key = key or _unread(drive, wish)
    made.row["cpu_s"] = time.process_time() - began
    return _write(wish, drive, vehicle, key, made)


class _Made(NamedTuple):
    """The row of a drive, those of its events, and when it began."""

    row: dict[str, Any]
    events: list[dict[str, Any]]
    start: datetime | None


def _failed(reason: str) -> _Made:
    return _Made({"verdict": FAILED, "reason": reason}, [], None)


def _write(wish: Wish, drive: Drive, vehicle: str, key: str, made: _Made) -> Outcome:
    """Write the rows of a drive in place of those that may be there."""
    places = [(vehicle, key), (vehicle, _unread(drive, wish)), (drive.folder_name, _unread(drive, wish))]
    for old in [path for place in places for path in tables.files_of(wish.out, *place)]:
        old.unlink(missing_ok=True)
    where = vehicle, date_of(made.start), key
    if made.events:
        tables.write(tables.place_of(wish.out, tables.EVENTS, *where), tables.EVENT, made.events)
    row = {**made.row, "url": drive.url, "start": made.start, "version": installed_version()}
    tables.write(tables.place_of(wish.out, tables.DRIVES, *where), tables.DRIVE, [row])
    return Outcome(drive, False, row["verdict"], row.get("span_s", 0.0) / 3600.0)


def _made(path: Path, folder: Path, asked: Sequence[str]) -> _Made:
    """Diagnose the log at `path` with the bundle in a folder; `asked` is what its row says besides.

    Raises:
        InputError: one of them cannot be read, or they do not fit together.
    """
    log = open_log(path, None)
    bundle = load_bundle(folder, senders=log.senders, signals=log.signals_of_dbc)
    _check_golden(bundle)
    check_fits(bundle, log, folder, path)
    row, events = _rows(log, bundle, _kernels(bundle, folder, path))
    return _Made({**row, "asked": [*asked], **identity_of(log, asked)._asdict()}, events, start_of(log))


def _rows(log: Log, bundle: Bundle, kernels: Kernels | None) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The row of a drive, without where and when it is from, and those of its events."""
    evaluator = bundle.bank() if kernels is None else CompiledEvaluator(bundle.manifest, kernels)
    monitor = Monitor(bundle.manifest, evaluator, bundle.table, log.id, bundle.id, parts=NATIVE)
    verdict = Verdict(bundle.manifest)
    components = {fault.name: fault.component for fault in bundle.manifest.faults}
    events, first, ticks = [], None, 0
    for event in monitor.signals(log.signals(bundle.table)):
        verdict.add(event)
        first = first or (event if event.diagnoses else None)
        events.append(_event(event, log.id, components))
    found = verdict.found(monitor.decision)
    reason = "" if found else _why_open(log, monitor, verdict, bundle)
    period_s = bundle.manifest.period_s
    if monitor.next_tick_s is not None and monitor.origin_s is not None:
        ticks = round((monitor.next_tick_s - monitor.origin_s) / period_s)
    since = None if first is None or first.since_tick is None else first.since_tick * period_s
    return {
        "recording": log.id,
        "bundle": bundle.id,
        "verdict": "fault" if found else "open" if reason else "no fault",
        "reason": reason,
        "span_s": log.report.length_s,
        "frames": log.report.frames,
        "ticks": ticks,
        "occurred_s": None if first is None else first.t_s,
        "since_s": since,
        "diagnoses": _diagnoses(verdict.diagnoses, components) if found else [],
        "simulated": log.recording is not None and is_simulated(log.recording.source),
        "native": kernels is not None,
    }, events


def _why_open(log: Log, monitor: Monitor, verdict: Verdict, bundle: Bundle) -> str:
    """Why a drive without a fault is no all-clear; "" where it is one."""
    if log.report.damaged:
        return f"damaged, so no alarm is no all-clear: {log.report.summary()}"
    return verdict.why_open(monitor.decision, bundle.table)


def _event(event: Event, recording: str, components: Mapping[str, str]) -> dict[str, Any]:
    same = ("seq", "t_s", "transition", "suspected", "settled", "alarm", "cannot_tell")
    diagnoses = _diagnoses(event.diagnoses, components)
    whole = {"recording": recording, "diagnoses": diagnoses, "event": encode(event).decode().strip()}
    return {**{name: getattr(event, name) for name in same}, **whole}


def _diagnoses(diagnoses: Sequence[Diagnosis], components: Mapping[str, str]) -> list[dict[str, Any]]:
    rows = [msgspec.structs.asdict(each) for each in diagnoses]
    return [
        {
            **row,
            "components": [components[name] for name in row["faults"]],
            "sizes": [msgspec.structs.asdict(size) for size in row["sizes"]],
        }
        for row in rows
    ]


def _unread(drive: Drive, wish: Wish) -> str:
    """The key of a drive that could not be read, or has no bundle: of its address, in place of its content."""
    return _key(drive.url, wish.bundle)


def _key(*parts: str) -> str:
    text = "\n".join([*parts, FORM, installed_version()])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@cache
def _bundle_id(folder: Path) -> str:
    """The identity of the bundle in a folder; it does not change while a fleet is diagnosed."""
    return whole(folder)[0]


_golden: set[str] = set()
"""The bundles whose golden vectors this worker has verified."""


def _check_golden(bundle: Bundle) -> None:
    if bundle.id not in _golden:
        verify_golden(bundle)
        _golden.add(bundle.id)


_known: dict[str, Kernels | None] = {}
"""In a worker: the native code of the bundle used last; None where it has none."""


def _kernels(bundle: Bundle, folder: Path, path: Path) -> Kernels | None:
    if bundle.id not in _known:
        _known.clear()
        try:
            _known[bundle.id] = kernels_apart(bundle, folder, path)
        except NotCompiledError:
            _known[bundle.id] = None
    return _known[bundle.id]
