"""The retained topics of the faults: what is remembered of each now.

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
    """Up to where the daemon's answer reaches: a connection to it, and a number."""

    def __init__(self) -> None:
        self._epoch, self._seq = 0, 0

    def reached(self, epoch: int, seq: int) -> None:
        """It has all that came over that connection up to that number."""
        self._epoch, self._seq = epoch, seq

    def contains(self, record: Record) -> bool:
        """Whether it has what the record says. Of an earlier connection it has all: the daemon may be another now."""
        return record.epoch < self._epoch or (record.epoch == self._epoch and record.seq <= self._seq)


class FaultStates:
    """Which faults have a retained state at the broker, as far as we know, and what makes that right again.

    `there` are those that were published and not erased, by an earlier run too.
    """

    def __init__(self, there: Collection[int] = ()) -> None:
        self.there = set(there)
        self._found: set[int] = set()  # at the broker, which nobody has judged yet
        self._moment = Moment()
        self._is_known = False  # what is to be there, since the connection began

    def connected(self) -> None:
        """A connection to the broker has begun: nobody knows what it holds."""
        self._found.clear()
        self._is_known = False

    def after(self, record: Record, topics: Topics) -> list[Publication]:
        """What the record changes; raises RecordError where it is not what its schema says."""
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
        """What is to be published when the daemon says that these are remembered, up to number `seq`."""
        self._moment.reached(epoch, seq)
        self._is_known = True
        gone = sorted((self.there | self._found) - set(faults))
        self._found.clear()
        return [
            *(self._erased(number, topics) for number in gone),
            *(self._told(number, content, topics) for number, content in sorted(faults.items())),
        ]

    def found(self, number: int, topics: Topics) -> list[Publication]:
        """The broker holds a state of that fault; erases it where there should be none."""
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
