"""Entries of the system's journal for faults, with fields that `journalctl` finds: `journalctl SPN=3362`.

Source: systemd's native journal protocol: a datagram of lines FIELD=value. Every kind of change has a message id
(`journalctl MESSAGE_ID=...`, docs/service.md). What only refines what was told is left to the events.
"""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import msgspec

from faultline.service.core.records.event import schema_of
from faultline.service.core.records.fault import CLEARED, SCHEMA, Change, Cleared, FaultRecord
from faultline.service.store.file import Record

SOCKET = Path("/run/systemd/journal/socket")
MESSAGES: dict[Change | None, tuple[str, int, str]] = {
    "pending": ("5b8c1d1f0a8d4b0e9f7f6c1e2a4d9a01", 5, "may be faulty"),
    "confirmed": ("5b8c1d1f0a8d4b0e9f7f6c1e2a4d9a02", 4, "is faulty"),
    "failed": ("5b8c1d1f0a8d4b0e9f7f6c1e2a4d9a03", 4, "is faulty again"),
    "passed": ("5b8c1d1f0a8d4b0e9f7f6c1e2a4d9a04", 5, "is not faulty any more"),
    "aged": ("5b8c1d1f0a8d4b0e9f7f6c1e2a4d9a05", 6, "is forgotten"),
    "displaced": ("5b8c1d1f0a8d4b0e9f7f6c1e2a4d9a06", 5, "is forgotten for want of room"),
    "revoked": ("5b8c1d1f0a8d4b0e9f7f6c1e2a4d9a08", 4, "was another one, or rested on doubted samples: taken back"),
    None: ("5b8c1d1f0a8d4b0e9f7f6c1e2a4d9a07", 5, "erased"),
}
"""Message id, priority (syslog(3)) and words of a change; None is faults that a person has erased."""

MOST, WITHIN_S = 20, 60.0
"""So many entries in so long [s]; what is more is counted and said once."""


class Journald:
    """Sends fault records to the journal without waiting. `clock` is the monotonic time [s]."""

    def __init__(self, clock: Callable[[], float], path: Path = SOCKET) -> None:
        self._clock, self._path = clock, str(path)
        self._since, self._sent, self._left_out = clock(), 0, 0

    @staticmethod
    def is_wanted() -> bool:
        """Return True if our messages go to a journal: systemd.exec(5), `$JOURNAL_STREAM`."""
        return "JOURNAL_STREAM" in os.environ and SOCKET.exists()

    def told(self, record: Record) -> None:
        """Send a record that subscribers get."""
        if record.about != "fault" or (fields := _fields(record)) is None:
            return
        if self._clock() - self._since >= WITHIN_S:
            self._since, self._sent = self._clock(), 0
        if self._sent >= MOST:
            self._left_out += 1
            return
        self._sent += 1
        if self._left_out:
            fields["FAULTLINE_LEFT_OUT"] = str(self._left_out)
        if self._send(fields):
            self._left_out = 0

    def _send(self, fields: dict[str, str]) -> bool:
        text = "".join(f"{name}={value}\n" for name, value in fields.items())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sock:
                sock.sendto(text.encode(), self._path)
        except OSError:  # no journal, or one that is behind: the events and the store have it all
            self._left_out += 1
            return False
        return True


def _fields(record: Record) -> dict[str, str] | None:
    """Return the fields of an entry; None if the record is not worth one."""
    if schema_of(record.line) == CLEARED:
        cleared = msgspec.json.decode(record.line, type=Cleared)
        return _entry(
            None, cleared, f"{', '.join(map(str, cleared.numbers)) or 'nothing'}", {"FAULTLINE_BY": cleared.by}
        )
    if schema_of(record.line) != SCHEMA:
        return None
    told = msgspec.json.decode(record.line, type=FaultRecord)
    if told.change not in MESSAGES:
        return None
    fault = told.fault
    fields = {
        "FAULTLINE_NUMBER": str(fault.number),
        "FAULTLINE_SYSTEM": fault.system,
        "FAULTLINE_COMPONENTS": ", ".join(fault.components),
        "FAULTLINE_STATUS": f"0x{fault.mask:02X}",
    }
    if len(fault.dtcs) == 1:
        fields |= {"SPN": str(fault.dtcs[0].spn), "FMI": str(fault.dtcs[0].fmi)}
    what = " or ".join(fault.components) or "something unknown"
    return _entry(told.change, told, f"{fault.system}: {what}", fields)


def _entry(change: Change | None, told: FaultRecord | Cleared, what: str, fields: dict[str, str]) -> dict[str, str]:
    message, priority, words = MESSAGES[change]
    return {
        "MESSAGE": f"{what} {words}",
        "MESSAGE_ID": message,
        "PRIORITY": str(priority),
        "SYSLOG_IDENTIFIER": "faultline",
        "FAULTLINE_ID": told.id,
        "FAULTLINE_SEQ": str(told.seq),
        "FAULTLINE_CHANGE": change or "cleared",
        **fields,
    }
