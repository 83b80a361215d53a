"""Order of publications, and handling of refusals.

States come before records, and records in order.
"""

from collections import deque
from collections.abc import Callable, Sequence

from faultline.service.mqtt.cloudevent import CONTENT_TYPE, structured
from faultline.service.mqtt.link import Answered, Link, Up
from faultline.service.mqtt.outbox import IN_FLIGHT, Outbox, Passed, Publication
from faultline.service.mqtt.puback_policy import HANGS_UP, PATIENCE_S, PubackPolicy, name_of
from faultline.service.mqtt.retained import Retained
from faultline.service.mqtt.throttled import Say
from faultline.service.mqtt.topics import Topics
from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.records import Record

RETRY_S = 1.0, 60.0
"""Until what was refused is sent again: at first, and at most."""


class Sender:
    """Sends records and what is `retained`; `passed` hears which records are done."""

    def __init__(self, retained: Retained, passed: Callable[[Sequence[Passed]], None], say: Say) -> None:
        self._retained, self._passed, self._say = retained, passed, say
        self.outbox = Outbox()
        self._states: deque[Publication] = deque()
        self._policy = PubackPolicy()
        self._hold = Backoff(*RETRY_S)
        self._limit, self._largest = IN_FLIGHT, float("inf")
        self._alone = 0  # so many records go one by one, to find out which one makes the broker hang up
        self._left_out: dict[str, float] = {}  # topics of states at which it does: until when [s]

    @property
    def hold_until(self) -> float:
        """Return the time until which no record is sent [s]."""
        return self._hold.at

    def begin(self, up: Up) -> None:
        """Handle a new connection, with its limits."""
        self._states.clear()
        self._limit = up.in_flight
        self._largest = up.largest if up.largest is not None else float("inf")

    def ended(self, code: int | None, now: float) -> None:
        """Handle the end of the connection, with the broker's reason code if it gave one.

        States are found out anew with the next one, records are sent again. What was sent last may be why it ended:
        where several things were in flight, the next time each goes alone, and a reason is of the one that did.
        """
        only = self.outbox.only
        if self.outbox.in_flight > 1:
            self._alone = IN_FLIGHT
        elif only is not None and code is not None and code in HANGS_UP:
            publication, is_of_a_record = self.outbox.find(only)
            if publication is not None and not is_of_a_record:
                self._left_out[publication.topic] = now + PATIENCE_S
            self.answered(Answered(only, code), now)
        self.outbox.disconnected()
        self._states.clear()

    def publish(self, states: Sequence[Publication]) -> None:
        """Queue states, which are sent before any record that waits."""
        self._states.extend(states)

    def send(self, link: Link, topics: Topics, now: float) -> None:
        """Send what there is, up to the number that may be unacknowledged."""
        while link.is_up and self.outbox.in_flight < (1 if self._alone or self._policy.refusing else self._limit):
            if not self._send_state(link, topics, now) and not self._send_record(link, topics, now):
                return

    def send_besides(self, link: Link, publication: Publication, now: float) -> int | None:
        """Send it now; return its identifier, None if there is no room or no connection."""
        if not link.is_up or self.outbox.in_flight >= self._limit:
            return None
        identifier = link.publish(publication)
        if identifier is not None:
            self.outbox.sent_besides(identifier, publication, now)
        return identifier

    def answered(self, answer: Answered, now: float) -> None:
        """Handle an acknowledgement or a refusal."""
        publication, is_of_a_record = self.outbox.find(answer.identifier)
        if publication is None:
            return
        refused = f"the broker refuses {publication.of}: {name_of(answer.code)}"
        about = f"refused {answer.code} {publication.retain}"
        if not is_of_a_record:
            self.outbox.answered(answer.identifier)
            if answer.code >= 0x80:
                self._say(f"{refused}; check what it allows at {publication.topic}", about)
            return
        verdict = self._policy.judge(answer.code, now)
        if verdict == "again":
            self._say(f"{refused}; it is tried again, check what is allowed at {publication.topic}", about)
            self.outbox.refused(answer.identifier)
            self._hold.failed(now)
            return
        if verdict == "taken":
            self._hold.well()
            self._alone = max(self._alone - 1, 0)
        else:
            self._say(f"{refused}; it is lost", f"lost {about}")
        self._passed(self.outbox.answered(answer.identifier, given_up=verdict == "given up"))

    def _send_state(self, link: Link, topics: Topics, now: float) -> bool:
        """Send a state; return False if there was none or it could not be sent."""
        if not self._states and (health := self._retained.health.due(topics)) is not None:
            self._states.append(health)
        if not self._states:
            return False
        publication = self._states.popleft()
        if now < self._left_out.get(publication.topic, now):
            return True
        if publication.size > self._largest:
            self._say(f"{publication.of} is larger than the broker takes: it is left out")
            return True
        return self.send_besides(link, publication, now) is not None

    def _send_record(self, link: Link, topics: Topics, now: float) -> bool:
        """Send a part of a record, or give it up; return False if there was none or it could not be sent."""
        if now < self._hold.at:
            return False
        publication = self.outbox.next_part(lambda record: self._parts(record, topics))
        if publication is None:
            return False
        if publication.size > self._largest:
            self._say(f"{publication.of} is larger than the broker takes: it is lost", "too large")
            self._passed(self.outbox.give_up_next())
            return True
        identifier = link.publish(publication)
        if identifier is not None:
            self.outbox.sent(identifier, now)
        return identifier is not None

    def _parts(self, record: Record, topics: Topics) -> list[Publication]:
        """Return the event, and the states that it changes."""
        payload = structured(record, topics.vehicle)
        event = Publication(topic=topics.events, payload=payload, content_type=CONTENT_TYPE, of=f"record {record.id}")
        return [event, *self._retained.after(record, topics)]
