"""Retained topics of the faults: the state of each remembered one.

Records come as late as the broker was away, so what they say may be old. What the daemon answers is of now, and says up
to which number: what that contains already changes no retained topic any more.
"""

from collections.abc import Collection, Mapping

import msgspec

from faultline.service.core.records.fault import CLEARED, ERASED
from faultline.service.core.records.fault import SCHEMA as FAULT
from faultline.service.mqtt.ask import number_of
from faultline.service.mqtt.outbox import Publication
from faultline.service.mqtt.topics import Topics
from faultline.service.protocol.records import Record, part_of

FOUND = 4096
"""Retained topics at the broker that are remembered until the daemon has said what is to be there."""


class Moment:
    """Extent of the daemon's answer: a connection to it, and a record's number."""

    def __init__(self) -> None:
        self._epoch, self._seq = 0, 0

    def reached(self, epoch: int, seq: int) -> None:
        """Set the extent: all records of that connection up to that number."""
        self._epoch, self._seq = epoch, seq

    def contains(self, record: Record) -> bool:
        """Return True if it covers the record; all of an earlier connection: the daemon may be another now."""
        return record.epoch < self._epoch or (record.epoch == self._epoch and record.seq <= self._seq)


class FaultStates:
    """Faults with a retained state at the broker, as far as known, and what corrects that.

    `there` are those that were published and not erased, by an earlier run too.
    """

    def __init__(self, there: Collection[int] = ()) -> None:
        self.there = set(there)
        self._found: set[int] = set()  # at the broker, which nobody has judged yet
        self._moment = Moment()
        self._is_known = False  # what is to be there, since the connection began

    def connected(self) -> None:
        """Handle a new connection to the broker, whose retained states are unknown."""
        self._found.clear()
        self._is_known = False

    def after(self, record: Record, topics: Topics) -> list[Publication]:
        """Return what the record changes; raises RecordError if it is not as its schema says."""
        if record.schema not in (FAULT, CLEARED) or self._moment.contains(record):
            return []
        if record.schema == CLEARED:
            cleared = part_of(record.parts, "numbers", list[int])
            return [self._erased(number, topics) for number in cleared if number in self.there]
        fault = part_of(record.parts, "fault", msgspec.Raw)
        number = number_of(fault)
        if part_of(record.parts, "change", str) in ERASED:
            return [self._erased(number, topics)]
        return [self._told(number, bytes(fault), topics)]

    def remembered(self, faults: Mapping[int, bytes], epoch: int, seq: int, topics: Topics) -> list[Publication]:
        """Return what is to be published for these remembered faults, known up to number `seq`."""
        self._moment.reached(epoch, seq)
        self._is_known = True
        gone = sorted((self.there | self._found) - set(faults))
        self._found.clear()
        return [
            *(self._erased(number, topics) for number in gone),
            *(self._told(number, content, topics) for number, content in sorted(faults.items())),
        ]

    def found(self, number: int, topics: Topics) -> list[Publication]:
        """Handle a state retained at the broker; return its erasure if there should be none."""
        if self._is_known:
            return [] if number in self.there else [self._erased(number, topics)]
        if len(self._found) < FOUND:
            self._found.add(number)
        return []

    def _told(self, number: int, content: bytes, topics: Topics) -> Publication:
        self.there.add(number)
        return Publication(topic=topics.fault(number), payload=content, retain=True, of=f"the state of fault {number}")

    def _erased(self, number: int, topics: Topics) -> Publication:
        self.there.discard(number)
        return Publication(topic=topics.fault(number), payload=b"", retain=True, of=f"the end of fault {number}")
