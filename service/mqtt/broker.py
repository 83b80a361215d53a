"""Connection to the broker, made again after a failure; nothing is published meanwhile."""

import selectors
from collections.abc import Callable

from faultline.service.mqtt.config import MqttConfig
from faultline.service.mqtt.link import Answered, Down, Happened, Held, Link, Up
from faultline.service.mqtt.outbox import Publication
from faultline.service.mqtt.puback_policy import name_of
from faultline.service.mqtt.retained import Retained
from faultline.service.mqtt.sender import Sender
from faultline.service.mqtt.throttled import Say
from faultline.service.mqtt.topics import Topics
from faultline.service.protocol.backoff import Backoff

RETRY_S = 1.0, 60.0
"""Between two tries to connect: at first, and at most."""
LASTED_S = 30.0
"""A connection that lasted so long was a good one: the next try comes soon."""


class Broker:
    """Keeps a connection to the broker in `config`, for `sender` to use; `wake` wakes the loop from another thread."""

    def __init__(
        self, config: MqttConfig, retained: Retained, sender: Sender, say: Say, wake: Callable[[], None]
    ) -> None:
        self._config, self._retained, self._sender, self._say, self._wake = config, retained, sender, say, wake
        self._where = f"{config.to[0]}:{config.to[1]}"
        self._retry = Backoff(*RETRY_S)
        self._link: Link | None = None
        self._topics: Topics | None = None  # of the link
        self._up_since: float | None = None
        self._looking, self._may_look = False, True
        self.connections = 0
        """How often it took us."""

    @property
    def topics(self) -> Topics | None:
        """Return the topics; None while nothing can be published."""
        return self._topics if self._link is not None and self._link.is_up else None

    @property
    def due(self) -> list[float]:
        """Return the times at which something is due though nothing happens [s]."""
        oldest = self._sender.outbox.oldest
        overdue = [oldest + self._config.acknowledged_within] if oldest is not None else []
        return [self._retry.at, self._sender.hold_until, *overdue]

    def register(self, selector: selectors.BaseSelector) -> None:
        """Puts the connection, if there is one, into the loop's selector for one turn."""
        if self._link is not None:
            self._link.register(selector)

    def connect(self, vehicle: str | None, now: float) -> None:
        """Keep a connection for the vehicle of that name, or begin one if that is due; without a name none."""
        if self._link is not None and self._topics is not None and self._topics.vehicle != vehicle:
            self.end(now, with_will=True)
        if self._link is None and vehicle is not None and now >= self._retry.at:
            self._topics = Topics(self._config.prefix, vehicle)
            will = self._retained.health.offline(self._topics)
            self._link = Link(self._config, vehicle, will, now, self._wake)

    def hear(self, now: float) -> None:
        """Takes what the broker says, and notices where it says nothing."""
        if self._link is None or self._topics is None:
            return
        for happened in self._link.turn(now):
            self._take(happened, self._topics, now)
        oldest, patience = self._sender.outbox.oldest, self._config.acknowledged_within
        if oldest is not None and now - oldest >= patience:
            self._down(f"what was sent {patience} s ago is not acknowledged", now)

    def send(self, now: float) -> None:
        """Sends what there is to send."""
        if self._link is not None and self.topics is not None:
            self._sender.send(self._link, self.topics, now)

    def send_besides(self, publication: Publication, now: float) -> int | None:
        """Publish it now; return its identifier, None if that is not possible."""
        return None if self._link is None else self._sender.send_besides(self._link, publication, now)

    def end(self, now: float, *, with_will: bool) -> None:
        """Disconnect; with the will the broker publishes that we are offline."""
        if self._link is not None:
            self._link.end(with_will=with_will)
        self._drop(now)

    def _take(self, happened: Happened, topics: Topics, now: float) -> None:
        if isinstance(happened, Answered):
            self._sender.answered(happened, now)
        elif isinstance(happened, Up):
            self._up(happened, topics, now)
        elif isinstance(happened, Down):
            self._down(happened.why, now, happened.code)
        elif isinstance(happened, Held):
            number = topics.number(happened.topic)
            if number is not None:
                self._sender.publish(self._retained.faults.found(number, topics))
        else:
            self._looking = False
            if happened.code >= 0x80:
                self._say(
                    f"{self._where}: it does not let us see what it holds at {topics.any_fault}: "
                    f"{name_of(happened.code)}; without that the cursor alone knows what to erase"
                )

    def _up(self, up: Up, topics: Topics, now: float) -> None:
        assert self._link is not None
        self._say(f"{self._where}: connected, as {topics.vehicle}")
        self.connections += 1
        self._up_since = now
        self._sender.begin(up)
        self._retained.connected()
        self._looking, self._may_look = up.may_look and self._may_look, True
        if self._looking:
            self._link.look(topics.any_fault)

    def _down(self, why: str, now: float, code: int | None = None) -> None:
        self._say(f"{self._where}: {why}; it is tried again, records wait")
        if self._up_since is not None and now - self._up_since >= LASTED_S:
            self._retry.well()
        self._retry.failed(now)
        self._may_look = not self._looking  # there are brokers that hang up on who may not look: next time without
        self._drop(now, code)

    def _drop(self, now: float, code: int | None = None) -> None:
        if self._link is not None:
            self._link.close()
        self._link, self._up_since, self._looking = None, None, False
        self._sender.ended(code, now)
