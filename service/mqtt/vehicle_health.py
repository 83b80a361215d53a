"""Retained topic of the vehicle's health: whether it is online, and which conditions stand."""

import msgspec

from faultline.service.core.records.health import SCHEMA as HEALTH
from faultline.service.mqtt.outbox import Publication
from faultline.service.mqtt.states import Moment
from faultline.service.mqtt.topics import Topics
from faultline.service.protocol.records import Record, part_of

_UNKNOWN = msgspec.Raw(b"null")


class _Status(msgspec.Struct):
    status: str
    conditions: msgspec.Raw
    lost: int
    version: str


class VehicleHealth:
    """Health message of `version` of faultline, with `lost` records that were never delivered."""

    def __init__(self, version: str, lost: int) -> None:
        self._version = version
        self.lost = lost
        self.daemon_is_there = False
        self._conditions = _UNKNOWN
        self._moment = Moment()
        self._published: Publication | None = None

    def after(self, record: Record) -> None:
        """Take the conditions of a record on health, if they are new; raises RecordError if it has none."""
        if record.schema == HEALTH and not self._moment.contains(record):
            self._conditions = part_of(record.parts, "conditions", msgspec.Raw)

    def now(self, conditions: msgspec.Raw, epoch: int, seq: int) -> None:
        """Take the conditions that the daemon answers, known up to number `seq`."""
        self._moment.reached(epoch, seq)
        self._conditions = conditions

    def connected(self) -> None:
        """Handle a new connection to the broker, which may hold another message."""
        self._published = None

    def due(self, topics: Topics) -> Publication | None:
        """Return what is to be published now; None if it was."""
        wanted = self._publication("online" if self.daemon_is_there else "daemon-away", topics)
        if wanted == self._published:
            return None
        self._published = wanted
        return wanted

    def offline(self, topics: Topics) -> Publication:
        """Return the message that we are offline, to publish or as our will."""
        return self._publication("offline", topics)

    def _publication(self, status: str, topics: Topics) -> Publication:
        """Return the message; conditions of an absent daemon are unknown."""
        conditions = self._conditions if status == "online" else _UNKNOWN
        content = _Status(status=status, conditions=conditions, lost=self.lost, version=self._version)
        return Publication(topic=topics.health, payload=msgspec.json.encode(content), retain=True, of="health")
