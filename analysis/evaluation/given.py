"""What `evaluate` was given, checked before the first of hours of recordings is run: ids, hashes, sensors, truths."""

import hashlib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from analysis.evaluation.truth import Truth, find_truth
from analysis.recordings.observe import open_known
from service.bundle import Bundle
from service.core.errors import InputError
from service.core.manifest import Origin
from service.logs import Log, Recording, load_recording


class Given(NamedTuple):
    """A recording to be judged: its folder, what its `recording.toml` says, and the truth about it."""

    path: Path
    recording: Recording
    truth: Truth

    def open(self, bundle: Bundle, say: Callable[[str], None]) -> Log:
        """Its log, made with the bundle's DBC; loss in it is said.

        Raises:
            LogError: it cannot be read, or names another DBC.
        """
        log = open_known(self.path, say)
        log.check_dbc(bundle.manifest.files[bundle.manifest.dbc].sha256)
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
        own = recording.can.bench_sha256 or hashlib.sha256((path / recording.can.file).read_bytes()).hexdigest()
        if own in drives:
            raise InputError(f"{path}: the same recording as {drives[own]}; give each once")
        if any(other.recording.id == recording.id for other in found):
            raise InputError(f"{path}: id {recording.id!r} is another recording's too; each needs one of its own")
        _check_unseen(path, own, bundle.manifest.origin)
        drives[own] = path
        found.append(Given(path, recording, find_truth(truths, recording.id)))
    return _chosen(found, bundle, faults)


def _described(path: Path) -> Recording:
    """What `recording.toml` says; `open_known` says what is wrong with a bare log or a bench recording."""
    if path.is_dir():
        recording = load_recording(path)
        if recording.kind == "instrumented":
            return recording
    opened = open_known(path, lambda _: None).recording
    assert opened is not None, "a log without a recording is refused"
    return opened


def _check_unseen(path: Path, drive: str, origin: Origin) -> None:
    if drive in [*origin.calibrate, *origin.train, *origin.tune]:
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
