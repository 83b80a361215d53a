"""Makes a recording answer for as long as somebody serves it."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from faultline.service.bundle.load import load_bundle, verify_golden
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import NOBODY
from faultline.service.logs import open_log
from faultline.service.recorded.service import Recording, Serving

EVERY = 0.1  # of the log between two words of progress


@contextmanager
def served(
    path: Path,
    folder: Path,
    say: Callable[[str], None],
    channel: str | None = None,
    senders: Mapping[str, int] = NOBODY,
) -> Iterator[tuple[Path, Path]]:
    """The control socket and the events socket of a finished recording, diagnosed with the bundle in the folder.

    `channel` is the bus to take of a log of several, `senders` are the source addresses of messages that several send.

    Raises:
        InputError: the log or the bundle cannot be read, do not fit together, or the log has not all signals.
    """
    log = open_log(path, channel)
    bundle = load_bundle(folder, senders={**log.senders, **senders})
    verify_golden(bundle)
    log.check_channels(bundle.table.carries)
    log.check_senders(bundle.table)
    log.check_dbc(bundle.manifest.files[bundle.manifest.dbc].sha256)
    if log.recording is not None:
        log.recording.check_sensors(path, bundle.manifest.sensor_set, f"the bundle {folder}")
    if log.report.lost:
        say(f"{path}: {log.report.summary()}")
    recording = Recording(log, path, bundle, say, _Progress(log.duration_s, say))
    strangers = bundle.table.strangers()
    if recording.history.latest is None or not any(bundle.table.taken.values()):
        signals = ", ".join(channel.signal for channel in bundle.manifest.inputs)
        remedy = "; ".join(["give a log of this bundle's vehicle", *strangers])
        raise InputError(f"{path}: never has all of {signals}; {remedy}")
    for text in strangers:
        say(text)
    with TemporaryDirectory(prefix="faultline-") as place, Serving(Path(place), recording) as serving:
        yield serving.control, serving.events


class _Progress:
    """Tells how much of the log is done, where it takes a while."""

    def __init__(self, duration_s: float, say: Callable[[str], None]) -> None:
        self._duration_s, self._say, self._told = duration_s, say, EVERY

    def __call__(self, done_s: float) -> None:
        """So much log time [s] is done."""
        if done_s >= self._told * self._duration_s:
            self._told = min(1.0, (done_s // (EVERY * self._duration_s) + 1) * EVERY)
            self._say(f"{done_s:.0f} s of {self._duration_s:.0f} s")
