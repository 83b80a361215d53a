"""Retained messages of a vehicle: the states of its faults, and its health."""

from faultline.service.mqtt.ask import Remembered, State
from faultline.service.mqtt.cursor import Cursor
from faultline.service.mqtt.outbox import Publication
from faultline.service.mqtt.states import FaultStates
from faultline.service.mqtt.throttled import Say
from faultline.service.mqtt.topics import Topics
from faultline.service.mqtt.vehicle_health import VehicleHealth
from faultline.service.protocol.records import Record, RecordError


class Retained:
    """Derives the retained messages from records and from the daemon's answers."""

    def __init__(self, kept: Cursor, version: str, say: Say) -> None:
        self.faults = FaultStates(kept.faults)
        self.health = VehicleHealth(version, kept.lost)
        self._say = say

    def connected(self) -> None:
        """Handle a new connection to the broker."""
        self.faults.connected()
        self.health.connected()

    def after(self, record: Record, topics: Topics) -> list[Publication]:
        """Return the fault states that the record changes; health is `due` by itself."""
        try:
            self.health.after(record)
            return self.faults.after(record, topics)
        except RecordError as error:
            self._say(f"record {record.id} changes no state, it is not as its schema says: {error}", "schema")
            return []

    def now(self, state: State, remembered: Remembered, epoch: int, topics: Topics) -> list[Publication]:
        """Return the publications that correct the retained messages, from the daemon's state and fault memory."""
        self.health.now(state.conditions, epoch, state.seq)
        return self.faults.remembered(remembered.faults, epoch, remembered.seq, topics)
