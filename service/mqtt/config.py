"""The configuration of `faultline mqtt`: a TOML file, strict; `service/vehicle/mqtt.toml` has all its keys."""

import ipaddress
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from faultline.service.mqtt.topics import TopicError, level, levels
from faultline.service.strict import LETTERS, ControlSocket, EventsSocket, Name, Part, Path_, Read, read

Place = Annotated[str, Meta(pattern=r"\A(/[^\x00]*|[A-Za-z0-9][A-Za-z0-9_.-]*)\Z", max_length=1000)]
"""A file, or the name of a systemd credential."""
Host = Annotated[
    str, Meta(pattern=r"\A[A-Za-z0-9_.:%-]+\Z", max_length=255, description="the broker's name or address")
]
User = Annotated[
    str, Meta(pattern=r"\A[^\x00-\x1f\x7f]+\Z", max_length=1000, description="the user's name at the broker")
]
Prefix = Annotated[str, Meta(description='the first levels of all topics, as "faultline" or "fleet/north"')]
Overdue = Annotated[int, Meta(ge=1, le=600, description="seconds until an answer is overdue, 1 to 600")]


class TlsConfig(Part, frozen=True):
    """TLS: trusted certificates and our own; that the broker's is not checked cannot be configured."""

    ca: Annotated[Place, Meta(description="a file with the certificates to trust, or a credential")] | None = None
    certificate: Annotated[Place, Meta(description="a file with our own certificate, or a credential")] | None = None
    key: Annotated[Place, Meta(description="a file with its key, or a credential")] | None = None


class MqttConfig(Part, frozen=True):
    """The table [mqtt]."""

    host: Host
    events: EventsSocket
    control: ControlSocket
    cursor: Annotated[Path_, Meta(description="a file that we may write, as /var/lib/faultline-mqtt/cursor")]
    port: Annotated[int, Meta(ge=1, le=65535, description="its port, 1 to 65535")] | None = None
    prefix: Prefix = "faultline"
    vehicle: Annotated[str, Meta(description="the vehicle's name in topics")] | None = None
    user: User | None = None
    password_file: Annotated[Place, Meta(description="a file that holds the password, or a credential")] | None = None
    client_id: Annotated[Name, Meta(description=f"our name at the broker: {LETTERS}")] | None = None
    keepalive: Annotated[int, Meta(ge=5, le=3600, description="seconds between signs of life, 5 to 3600")] = 30
    acknowledged_within: Overdue = 30
    plain: Annotated[bool, Meta(description="true to send without TLS to another machine")] = False
    tls: TlsConfig | None = None

    @property
    def to(self) -> tuple[str, int]:
        """Return the broker's name and port."""
        return self.host, self.port if self.port is not None else 1883 if self.tls is None else 8883


class _File(Part, frozen=True):
    mqtt: MqttConfig


def load_config(path: Path) -> MqttConfig:
    """Return the configuration in the file at `path`; raises ConfigError, which names the line."""
    file = read(path, _File)
    _check(file)
    return file.said.mqtt


def _check(file: Read[_File]) -> None:
    """Check what types do not express."""
    config = file.said.mqtt
    for key, text in (("prefix", config.prefix), ("vehicle", config.vehicle)):
        try:
            if text is not None:
                levels(text) if key == "prefix" else level(text, key)
        except TopicError as error:
            raise file.wrong(["mqtt", key], str(error)) from error
    if config.password_file is not None and config.user is None:
        raise file.wrong(["mqtt", "password_file"], "a password without a user; give `user` too")
    if config.tls is not None and config.plain:
        raise file.wrong(["mqtt", "plain"], "there is [mqtt.tls] too; remove one of them")
    if config.tls is None and not config.plain and not _is_loopback(config.host):
        message = "is another machine, and all would go there in the clear; give [mqtt.tls], or say `plain = true`"
        raise file.wrong(["mqtt", "host"], message)
    if config.tls is not None and (config.tls.certificate is None) != (config.tls.key is None):
        raise file.wrong(["mqtt", "tls"], "`certificate` and `key` belong together; give both or none")


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
