"""Service of a recording for as long as the context lasts."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from faultline.service.bundle.load import load_with_log
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import NO_BUSES, NOBODY
from faultline.service.recorded.service import Recording, Serving

EVERY = 0.1  # of the log between two words of progress


@contextmanager
def served(
    path: Path,
    folder: Path,
    say: Callable[[str], None],
    channel: str | None = None,
    senders: Mapping[str, int] = NOBODY,
    buses: Mapping[str, str] = NO_BUSES,
) -> Iterator[tuple[Path, Path]]:
    """Serve a finished recording, diagnosed with the bundle in the folder; yield the paths of its two sockets.

    `channel` is the one to take of a log of several, `senders` are the source addresses of messages that several send,
    `buses` the channels of buses by their names.

    Raises:
        InputError: the log or the bundle cannot be read, do not fit together, or the log has not all signals.
    """
    bundle, log = load_with_log(folder, path, channel, senders, buses)
    if log.report.lost:
        say(f"{path}: {log.report.summary()}")
    recording = Recording(log, path, bundle, say, _Progress(log.duration_s, say))
    strangers = bundle.table.strangers()
    if recording.history.latest is None or not (log.values or any(bundle.table.taken.values())):
        signals = ", ".join(channel.signal for channel in bundle.manifest.inputs)
        remedy = "; ".join(["give a log of this bundle's vehicle", *strangers])
        raise InputError(f"{path}: never has all of {signals}; {remedy}")
    for text in strangers:
        say(text)
    with TemporaryDirectory(prefix="faultline-") as place, Serving(Path(place), recording) as serving:
        yield serving.control, serving.events


class _Progress:
    """Reports progress through the log, where it takes a while."""

    def __init__(self, duration_s: float, say: Callable[[str], None]) -> None:
        self._duration_s, self._say, self._told = duration_s, say, EVERY

    def __call__(self, done_s: float) -> None:
        """Report that so much log time [s] is done."""
        if done_s >= self._told * self._duration_s:
            self._told = min(1.0, (done_s // (EVERY * self._duration_s) + 1) * EVERY)
            self._say(f"{done_s:.0f} s of {self._duration_s:.0f} s")
