"""Events of a live run, to be judged in place of the log's own."""

from pathlib import Path

import msgspec

from faultline.service.bundle.load import Bundle
from faultline.service.core.errors import InputError
from faultline.service.core.records.event import Event, decode, is_about, is_other
from faultline.service.logs import Log


def live_events(path: Path, bundle: Bundle, log: Log) -> list[Event]:
    """The events in a file, which must be about this log and from this bundle.

    Raises:
        InputError: there are none, or they are others.
    """
    if not path.is_file():
        raise InputError(f"{path}: not found; `faultline watch --json` writes events")
    events = []
    for number, line in enumerate(path.read_bytes().splitlines(), start=1):
        try:
            if is_other(line):
                continue  # of buses and signals, or of what is remembered
            events.append(decode(line))
        except (msgspec.DecodeError, msgspec.ValidationError) as error:
            raise InputError(f"{path}: line {number}: not an event: {error}") from error
        if events[-1].bundle != bundle.id:
            raise InputError(
                f"{path}: line {number}: told by bundle {events[-1].bundle[:12]}, not by {bundle.id[:12]}; "
                "give the bundle that the service ran"
            )
        if not is_about(events[-1], log.id):
            raise InputError(
                f"{path}: line {number}: is about {events[-1].id.rpartition('-')[0]!r}, not about {log.id!r}; "
                f"give the events of this recording (faultline run --source {log.id})"
            )
    if not events:
        raise InputError(f"{path}: holds no event, not even that the service started; was it running?")
    return events
