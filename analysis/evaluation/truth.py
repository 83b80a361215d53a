"""What really was in a recording: `truth.toml`, opened by evaluation and tests alone."""

import tomllib
from collections.abc import Sequence
from pathlib import Path

import msgspec

from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Name


class TrueFault(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A fault that was there: size in `unit` ("1": in parts), onset [s] after the log's first frame."""

    name: Name
    size: float
    onset_s: float
    profile: str
    unit: str = ""


class Truth(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The faults, the hidden effects with their sizes, how vehicle, day and second logger differ from their kind."""

    schema: int
    recording: str
    fault: list[TrueFault] = []
    effects: dict[str, float] = {}
    vehicle: dict[str, float] = {}
    day: dict[str, float] = {}
    logger: dict[str, float] = {}

    def until(self, end_s: float) -> "Truth":
        """The truth with the faults that began before `end_s` [s] alone: a log may end before one comes."""
        return msgspec.structs.replace(self, fault=[fault for fault in self.fault if fault.onset_s < end_s])


def load_truth(path: Path, recording: str) -> Truth:
    """The truth about `recording`.

    Raises:
        InputError: the file is absent, malformed, of another version or about another recording.
    """
    truth = read_truth(path)
    if truth.recording != recording:
        raise InputError(
            f"{path}: is about {truth.recording!r}, not about {recording!r}; give the truth of that recording"
        )
    return truth


def find_truth(places: Sequence[Path], recording: str) -> Truth:
    """The truth about `recording` among files and folders; a folder holds `<recording>.toml`.

    Raises:
        InputError: a file is no truth, or none is about this recording.
    """
    if len(places) == 1 and not places[0].is_dir():
        return load_truth(places[0], recording)
    for place in places:
        if place.is_dir():
            if (place / f"{recording}.toml").is_file():
                return load_truth(place / f"{recording}.toml", recording)
        elif (truth := read_truth(place)).recording == recording:
            return truth
    named = ", ".join(map(str, places))
    raise InputError(f"{named}: no truth about {recording!r}; give its file, or a folder with {recording}.toml")


def read_truth(path: Path) -> Truth:
    """The truth in a file.

    Raises:
        InputError: the file is absent, malformed or of another version.
    """
    if not path.is_file():
        raise InputError(f"{path}: not found; the rig writes the truth with --truth")
    try:
        truth = msgspec.convert(tomllib.loads(path.read_text()), Truth)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a truth file: {error}") from error
    if truth.schema != 1:
        raise InputError(f"{path}: schema: this is {truth.schema}, wanted is 1; record again with a matching rig")
    return truth
