"""A single connection to the broker, through paho, driven by our own loop.

A connection lives once: it is made, is up, is down, and the next is another object, so that nothing of paho's own
queues outlives it. Looking up the name, connecting and the TLS handshake may take long, and have a thread; all else is
the loop's. The callbacks of paho only note what happened.
"""

import selectors
import socket
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

from paho.mqtt.client import Client, DisconnectFlags, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, LogLevel, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from faultline.service.mqtt.access import context, password
from faultline.service.mqtt.broker_words import TIMEOUT_S, ended, failed, lost, refused
from faultline.service.mqtt.config import MqttConfig
from faultline.service.mqtt.outbox import IN_FLIGHT, Publication
from faultline.service.mqtt.puback_codes import allow_all

allow_all()

LARGEST_IN = 1 << 20
"""Bytes of a packet that the broker may send us; it keeps larger ones."""
WITH_WILL = 0x04
"""Reason code of a DISCONNECT after which the will is published."""


class Up(NamedTuple):
    """Connected: how much may be in flight, and the largest packet in bytes (None: any)."""

    in_flight: int
    largest: int | None
    may_look: bool


class Answered(NamedTuple):
    """Acknowledgement of a publication, with MQTT's reason code."""

    identifier: int
    code: int


class Looked(NamedTuple):
    """Answer to our subscription, with MQTT's reason code."""

    code: int


class Held(NamedTuple):
    """Retained message at the broker."""

    topic: str


class Down(NamedTuple):
    """End of the connection: why, and MQTT's reason code where the broker sent one."""

    why: str
    code: int | None = None


Happened = Up | Answered | Looked | Held | Down


class Link:
    """A connection that is begun at `now` [s]; `wake` is called from another thread when the first steps are done.

    `vehicle` names us where the configuration does not, `will` is what the broker publishes when we are gone.
    """

    def __init__(
        self, config: MqttConfig, vehicle: str, will: Publication, now: float, wake: Callable[[], None]
    ) -> None:
        self._config, self._will, self._wake = config, will, wake
        self._client_id = config.client_id or f"faultline-{vehicle}"
        self._happened: list[Happened] = []
        self._failed: str | None = None  # why the thread could not connect
        self._client: Client | None = None  # once it is connected, and ours
        self._since, self._is_up, self._is_down, self._words = now, False, False, ""
        threading.Thread(target=self._connect, name="broker", daemon=True).start()

    @property
    def is_up(self) -> bool:
        """Return True if something can be published."""
        return self._is_up and not self._is_down

    def register(self, selector: selectors.BaseSelector) -> None:
        """Puts the socket, if there is one, into the loop's selector for one turn."""
        sock = self._client.socket() if self._client is not None else None
        if self._client is not None and sock is not None and sock.fileno() >= 0:
            writes = selectors.EVENT_WRITE if self._client.want_write() else 0
            selector.register(sock.fileno(), selectors.EVENT_READ | writes)

    def turn(self, now: float) -> list[Happened]:
        """Reads and writes what can be; what has happened since the last turn."""
        if self._client is not None and not self._is_down:
            try:
                self._exchange(self._client)
            except Exception as error:  # noqa: BLE001 whatever the broker sends must not end us
                self._note_down(f"it sent what is no MQTT: {str(error) or type(error).__name__}")
        if self._failed is not None:
            self._note_down(self._failed)
        if not self._is_up and not self._is_down and now - self._since > 3 * TIMEOUT_S:
            self._note_down("it does not answer")
        happened, self._happened = self._happened, []
        return happened

    def publish(self, publication: Publication) -> int | None:
        """Publish it with QoS 1; return its identifier, or None if the connection has just gone."""
        assert self._client is not None
        properties = None
        if publication.payload:
            kind = publication.content_type
            properties = _properties(PacketTypes.PUBLISH, ContentType=kind, PayloadFormatIndicator=1)  # 1: UTF-8
        info = self._client.publish(publication.topic, publication.payload, 1, publication.retain, properties)
        return None if self._is_down or info.rc == MQTTErrorCode.MQTT_ERR_NO_CONN else info.mid

    def look(self, topics: str) -> None:
        """Subscribe to retained messages there; each comes as `Held`.

        What we publish there later comes back, too, without the retain flag. Not to have that (no local) might keep
        back what an earlier connection of ours left there, under the same name (MQTT 5.0, 3.8.3.1).
        """
        assert self._client is not None
        self._client.subscribe(topics, options=SubscribeOptions(qos=0, retainAsPublished=False))

    def end(self, *, with_will: bool) -> None:
        """Disconnect and close."""
        if self._client is not None and self.is_up:
            self._client.disconnect(ReasonCode(PacketTypes.DISCONNECT, identifier=WITH_WILL) if with_will else None)
        self.close()

    def close(self) -> None:
        """Close without a DISCONNECT: the broker publishes the will."""
        self._is_down = True
        sock = self._client.socket() if self._client is not None else None
        if sock is not None:
            sock.close()

    def _connect(self) -> None:
        """Connect; runs in a thread, as it may take long."""
        try:
            client = self._made()
            host, port = self._config.to
            properties = _properties(PacketTypes.CONNECT, MaximumPacketSize=LARGEST_IN)
            client.connect(host, port, self._config.keepalive, clean_start=True, properties=properties)
            _hurry(client.socket())
        except Exception as error:  # noqa: BLE001 why it failed is told, and tried again
            self._failed = failed(error)
        else:
            self._client = client
        self._wake()

    def _made(self) -> Client:
        config, will = self._config, self._will
        client = Client(CallbackAPIVersion.VERSION2, self._client_id, protocol=MQTTProtocolVersion.MQTTv5)
        client.connect_timeout = TIMEOUT_S
        client.max_inflight_messages = IN_FLIGHT  # we never hand it more, so its own queue stays empty
        if config.user is not None:
            client.username_pw_set(config.user, password(config))
        if config.tls is not None:
            client.tls_set_context(context(config.tls))
        properties = _properties(PacketTypes.WILLMESSAGE, WillDelayInterval=0, ContentType=will.content_type)
        client.will_set(will.topic, will.payload, 1, will.retain, properties)
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_publish, client.on_subscribe = self._on_publish, self._on_subscribe
        client.on_message, client.on_log = self._on_message, self._on_log
        return client

    def _exchange(self, client: Client) -> None:
        while not self._is_down:
            client.loop_read()
            sock = client.socket()
            if sock is None or not getattr(sock, "pending", int)():  # what TLS has read already, no selector shows
                break
        if client.want_write():
            client.loop_write()
        client.loop_misc()

    def _note_down(self, why: str, code: int | None = None) -> None:
        if not self._is_down:
            self._is_down = True
            self._happened.append(Down(why, code))

    def _on_connect(self, _client: Client, _data: object, _flags: object, code: ReasonCode, given: Any) -> None:
        if code.is_failure:
            self._note_down(refused(code))
            return
        limits = {name: getattr(given, name, None) for name in ("ReceiveMaximum", "MaximumPacketSize", "MaximumQoS")}
        if limits["MaximumQoS"] == 0:
            self._note_down(refused(ReasonCode(PacketTypes.CONNACK, identifier=0x9B)))
        elif getattr(given, "RetainAvailable", 1) == 0:
            self._note_down(refused(ReasonCode(PacketTypes.CONNACK, identifier=0x9A)))
        else:
            self._is_up = True
            may_look = getattr(given, "WildcardSubscriptionAvailable", 1) != 0
            in_flight = min(IN_FLIGHT, limits["ReceiveMaximum"] or IN_FLIGHT)
            self._happened.append(Up(in_flight, limits["MaximumPacketSize"], may_look))

    def _on_disconnect(
        self, _client: Client, _data: object, flags: DisconnectFlags, code: ReasonCode, _given: object
    ) -> None:
        if flags.is_disconnect_packet_from_server:
            self._note_down(ended(code), code.value)
        else:
            self._note_down(lost(self._words or code.getName(), is_up=self._is_up))

    def _on_publish(self, _client: Client, _data: object, mid: int, code: ReasonCode, _given: object) -> None:
        self._happened.append(Answered(mid, code.value))

    def _on_subscribe(self, _client: Client, _data: object, _mid: int, codes: list[ReasonCode], _given: object) -> None:
        self._happened.append(Looked(max(code.value for code in codes)))

    def _on_message(self, _client: Client, _data: object, message: MQTTMessage) -> None:
        if message.retain and message.payload:
            self._happened.append(Held(message.topic))

    def _on_log(self, _client: Client, _data: object, level: int, text: str) -> None:
        """Keep the message of paho's log, the only place where it says why a socket failed."""
        if level == LogLevel.MQTT_LOG_ERR:
            self._words = text.rpartition("socket: ")[2]


def _hurry(sock: object) -> None:
    """Disable Nagle's algorithm: with twenty in flight, filling a packet first costs 40 ms each time."""
    if isinstance(sock, socket.socket):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _properties(kind: int, **values: object) -> Properties:
    made: Properties = Properties(kind)  # type: ignore[no-untyped-call]
    for name, value in values.items():
        setattr(made, name, value)
    return made
