"""What a calibrated model says of the recordings that it was calibrated on, or that its effects were discovered in."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from faultline.analysis.model import Model
from faultline.service.core.errors import InputError
from faultline.service.logs import Log

COMMAND, DISCOVER = "calibrate", "discover"

USED = {COMMAND: ("recordings",), DISCOVER: ("recordings", "held_out")}
"""Where entries of a command name recordings that the model has seen. Those held out have chosen the effect."""


def entry(logs: Sequence[Log], sections: int) -> dict[str, object]:
    """What a calibration adds to a model's provenance."""
    recording = logs[0].recording
    vehicle = {"vehicle": recording.vehicle} if recording else {}
    return {"command": COMMAND, "recordings": [log.drive for log in logs], "sections": sections, **vehicle}


def recordings_of(model: Model) -> list[str]:
    """The SHA-256 of the drives that the model has seen (`Log.drive`): of calibration and discovery, once each.

    A discovery's held-out recordings count: the effects were chosen for describing them.
    """
    lists = [entry.get(key, []) for entry in model.provenance for key in USED.get(str(entry.get("command")), ())]
    return list(dict.fromkeys(str(sha) for found in lists if isinstance(found, (list, tuple)) for sha in found))


def is_fitted(model: Model) -> bool:
    """Whether the model was ever calibrated, or had an effect added, on recordings."""
    return any(entry.get("command") in USED for entry in model.provenance)


def vehicle_of(model: Model) -> str | None:
    """The vehicle that the model was last calibrated for, or its effects were last discovered on, if it says so."""
    named = [entry["vehicle"] for entry in model.provenance if entry.get("command") in USED and "vehicle" in entry]
    return str(named[-1]) if named else None


def check_id(log: Log, path: Path, others: Iterable[str]) -> None:
    """Raises InputError if the log's id is among the others': what is found is kept and told by it."""
    if log.id in set(others):
        raise InputError(
            f"{path}: id {log.id!r} is another recording's too; give each one of its own in recording.toml"
        )


def check_vehicle(log: Log, path: Path, expected: str | None, what: str) -> None:
    """Raises InputError if the log is of another vehicle than `expected`, that of `what`; a bare log names none."""
    if log.recording is not None and expected is not None and log.recording.vehicle != expected:
        raise InputError(
            f"{path}: recorded on vehicle {log.recording.vehicle!r}, {what} is of {expected!r}; every vehicle has "
            "parameters of its own, give a recording of this one"
        )
