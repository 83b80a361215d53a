"""What `evaluate` was given, checked before the first of hours of recordings is run: ids, hashes, sensors, truths."""

import hashlib
from collections.abc import Callable, Collection, Sequence
from math import inf
from pathlib import Path
from typing import NamedTuple

import numpy as np

from faultline.analysis.evaluation.blocks import BLOCK
from faultline.analysis.evaluation.story import Array
from faultline.analysis.evaluation.truth import Truth, find_truth
from faultline.analysis.recordings.observe import open_known, samples_of
from faultline.service.bundle.load import Bundle
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Origin
from faultline.service.core.signals.modes import EDGE
from faultline.service.logs import Log, Recording, load_recording


class Given(NamedTuple):
    """A recording to be judged: its folder, what its `recording.toml` says, and the truth about it."""

    path: Path
    recording: Recording
    truth: Truth

    def open(self, bundle: Bundle, say: Callable[[str], None]) -> Log:
        """Its log, made with the bundle's DBC; loss in it is said, and whether the bundle is another vehicle's.

        Raises:
            LogError: it cannot be read, or names another DBC.
        """
        log = open_known(self.path, say)
        log.check_senders(bundle.table)
        log.check_dbc(bundle.dbc_sha256)
        made_for = bundle.manifest.origin.vehicle
        if made_for not in (None, self.recording.vehicle):
            say(f"{self.path}: of vehicle {self.recording.vehicle!r}, the bundle was made for {made_for!r}")
        return log


def given(bundle: Bundle, paths: Sequence[Path], truths: Sequence[Path], faults: Collection[str] = ()) -> list[Given]:
    """The recordings at `paths` with their truths; with `faults`, only those with one of them and fault-free ones.

    Raises:
        InputError: a recording is none, a bench's, given twice, of too few sensors, one the bundle was made from, or
            without a truth; or a name in `faults` is no fault of the bundle or of any truth.
    """
    found: list[Given] = []
    drives: dict[str, Path] = {}
    for path in paths:
        recording = _described(path)
        recording.check_sensors(path, bundle.manifest.sensor_set, f"the bundle {bundle.where}")
        log, own = _hashes(path, recording)
        if own in drives:
            raise InputError(f"{path}: the same recording as {drives[own]}; give each once")
        if any(other.recording.id == recording.id for other in found):
            raise InputError(f"{path}: id {recording.id!r} is another recording's too; each needs one of its own")
        _check_unseen(path, {own, log}, bundle.manifest.origin)
        drives[own] = path
        found.append(Given(path, recording, find_truth(truths, recording.id)))
    return _chosen(found, bundle, faults)


def learnt_from(bundle: Bundle, paths: Sequence[Path]) -> list[tuple[str, Array]]:
    """Ids and samples (K, signals) of recordings that the bundle was calibrated, trained or tuned with.

    Raises:
        InputError: one of them is not such a recording.
    """
    origin, found = bundle.manifest.origin, []
    for path in paths:
        recording = _described(path)
        if {*_hashes(path, recording)}.isdisjoint({*origin.calibrate, *origin.train, *origin.tune}):
            raise InputError(f"{path}: the bundle {bundle.where} was not made from this recording; leave it out")
        log = Given(path, recording, Truth(schema=1, recording=recording.id)).open(bundle, lambda _: None)
        ticks = samples_of(bundle.manifest, log.signals(bundle.table))
        found.append((recording.id, np.array([tick.z for tick in ticks]).reshape(-1, len(bundle.manifest.inputs))))
    return found


def check_reportable(chosen: Sequence[Given], bundle: Bundle) -> None:
    """Whether recordings make a report, seen from their samples alone: they are read until it is known.

    Raises:
        InputError: none has a fault-free part that a block fits in, or some operating mode never occurs.
    """
    manifest, free = bundle.manifest, False
    block_s, modes = BLOCK * manifest.settling_s, {*range(EDGE + 1, len(manifest.modes.names))}
    for one in chosen:
        ticks = samples_of(manifest, one.open(bundle, lambda _: None).signals(bundle.table))
        onset = min((fault.onset_s for fault in one.truth.fault), default=inf)
        free |= round(sum(tick.t_s < onset for tick in ticks) * manifest.period_s / block_s) > 0
        modes -= {tick.mode for tick in ticks}
        if free and not modes:
            return
    like = f"{chosen[0].path}: " + ("like the others, " if len(chosen) > 1 else "")
    if not free:
        raise InputError(
            f"{like}without a fault-free part of {block_s / 2:g} s; a report needs one, add a recording without a fault"
        )
    raise InputError(
        f"{like}never in mode {', '.join(manifest.modes.names[mode] for mode in sorted(modes))}; a report needs every "
        "mode, add a recording that has it"
    )


def _hashes(path: Path, recording: Recording) -> tuple[str, str]:
    """Return the hash of the recording's log, and of the drive: that of the log which it was ingested from."""
    log = hashlib.sha256((path / recording.file).read_bytes()).hexdigest()
    return log, (recording.can and recording.can.bench_sha256) or log


def _described(path: Path) -> Recording:
    """What `recording.toml` says; `open_known` says what is wrong with a bare log or a bench recording."""
    if path.is_dir():
        recording = load_recording(path)
        if recording.kind == "instrumented":
            return recording
    opened = open_known(path, lambda _: None).recording
    assert opened is not None, "a log without a recording is refused"
    return opened


def _check_unseen(path: Path, known_by: Collection[str], origin: Origin) -> None:
    if not {*origin.calibrate, *origin.train, *origin.tune}.isdisjoint(known_by):
        raise InputError(f"{path}: the bundle was made from this recording; evaluate on one it has not seen")


def _chosen(found: list[Given], bundle: Bundle, faults: Collection[str]) -> list[Given]:
    known = [fault.name for fault in bundle.manifest.faults]
    known += [fault.name for one in found for fault in one.truth.fault]
    for name in faults:
        if name not in known:
            raise InputError(
                f"--fault {name}: no fault of the bundle or of these recordings; "
                f"those are {', '.join(dict.fromkeys(known))}"
            )
    if not faults:
        return found
    chosen = [one for one in found if not one.truth.fault or any(f.name in faults for f in one.truth.fault)]
    if not chosen:
        raise InputError(f"--fault {' '.join(faults)}: no recording has it or is fault-free; give one that has it")
    return chosen
