"""The configuration of `faultline mqtt`: a TOML file of its own, strict, whose errors name the line.

[mqtt]
host = "broker.example"
port = 8883                                  # default: 8883 with [mqtt.tls], else 1883
prefix = "faultline"                         # topics are PREFIX/VEHICLE/...; may have several levels
# vehicle = "truck-17"                       # default: what the daemon calls itself
user = "truck-17"
password_file = "mqtt-password"              # a file (/...), or the name of a systemd credential; never the password
# client_id = "faultline-truck-17"           # default: faultline-VEHICLE
# keepalive = 30                             # seconds
# acknowledged_within = 30                   # seconds; else the connection is given up
# plain = true                               # without TLS to another machine
events = "/run/faultline/events.sock"        # the daemon's two sockets
control = "/run/faultline/control.sock"
cursor = "/var/lib/faultline-mqtt/cursor"    # how far the broker has acknowledged

[mqtt.tls]                                   # may be empty
ca = "/etc/faultline/broker-ca.pem"          # whose certificates are believed; default: the system's
certificate = "/etc/faultline/mqtt.pem"      # our own, where the broker asks for one
key = "mqtt-key"                             # a file, or the name of a systemd credential
"""

import ipaddress
import re
import tomllib
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.errors import InputError
from faultline.service.mqtt.topics import TopicError, level, levels

LARGEST = 256 * 1024
"""Bytes of the file at most."""

Path_ = Annotated[str, Meta(pattern=r"\A/[^\x00]*\Z", max_length=1000)]
Place = Annotated[str, Meta(pattern=r"\A(/[^\x00]*|[A-Za-z0-9][A-Za-z0-9_.-]*)\Z", max_length=1000)]
"""A file, or the name of a systemd credential."""

KEYS = {
    "mqtt": "the table [mqtt]",
    "host": "the broker's name or address",
    "port": "its port, 1 to 65535",
    "prefix": 'the first levels of all topics, as "faultline" or "fleet/north"',
    "vehicle": "the vehicle's name in topics",
    "user": "the user's name at the broker",
    "password_file": "a file that holds the password (/...), or the name of a systemd credential",
    "client_id": "our name at the broker: letters, digits, _ . and -, 80 at most",
    "keepalive": "seconds between signs of life, 5 to 3600",
    "acknowledged_within": "seconds until an answer is overdue, 1 to 600",
    "plain": "true to send without TLS to another machine",
    "events": "the daemon's events socket, as /run/faultline/events.sock",
    "control": "the daemon's control socket, as /run/faultline/control.sock",
    "cursor": "a file that we may write, as /var/lib/faultline-mqtt/cursor",
    "tls": "the table [mqtt.tls]",
    "ca": "a file with the certificates that are believed, or the name of a systemd credential",
    "certificate": "a file with our own certificate, or the name of a systemd credential",
    "key": "a file with its key, or the name of a systemd credential",
}
"""What each key asks for, as errors say it."""


class ConfigError(InputError):
    """A configuration that must not be used. Not the daemon's: that module brings in numerical libraries."""


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common strictness."""


class TlsConfig(_Part, frozen=True):
    """Whom we believe, and who we are; that a certificate is not looked at cannot be asked for."""

    ca: Place | None = None
    certificate: Place | None = None
    key: Place | None = None


class MqttConfig(_Part, frozen=True):
    """The table [mqtt]."""

    host: Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_.:%-]+\Z", max_length=255)]
    events: Path_
    control: Path_
    cursor: Path_
    port: Annotated[int, Meta(ge=1, le=65535)] | None = None
    prefix: str = "faultline"
    vehicle: str | None = None
    user: Annotated[str, Meta(pattern=r"\A[^\x00-\x1f\x7f]+\Z", max_length=1000)] | None = None
    password_file: Place | None = None
    client_id: Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.-]*\Z", max_length=80)] | None = None
    keepalive: Annotated[int, Meta(ge=5, le=3600)] = 30
    acknowledged_within: Annotated[int, Meta(ge=1, le=600)] = 30
    plain: bool = False
    tls: TlsConfig | None = None

    @property
    def to(self) -> tuple[str, int]:
        """The broker's name and port."""
        return self.host, self.port if self.port is not None else 1883 if self.tls is None else 8883


class _Config(_Part, frozen=True):
    mqtt: MqttConfig


def load_config(path: Path) -> MqttConfig:
    """The configuration in the file at `path`.

    Raises:
        ConfigError: it cannot be read, is no TOML, or says what makes no sense; the message names the line.
    """
    text, tree = _read(path)
    try:
        config = msgspec.convert(tree, _Config).mqtt
    except msgspec.ValidationError as error:
        message, steps = _explained(error)
        raise ConfigError(f"{path}:{line_of(text, steps)}: {'.'.join(steps)}: {message}") from error
    _check(config, text, path)
    return config


def _read(path: Path) -> tuple[str, dict[str, object]]:
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
        if len(raw) > LARGEST:
            raise ConfigError(f"{path}: more than {LARGEST // 1024} KiB; this is no configuration")
        text = raw.decode()
        return text, tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give another --config") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error


def _explained(error: msgspec.ValidationError) -> tuple[str, list[str]]:
    """What is wrong and what to do, and the keys that lead there."""
    message, _, where = str(error).partition(" - at `")
    steps = re.findall(r"\.([\w-]+)", where)
    if (unknown := re.fullmatch(r"Object contains unknown field `(.*)`", message)) is not None:
        return f"there is no such key; those are {', '.join(_keys(steps))}", [*steps, unknown[1]]
    if (missing := re.fullmatch(r"Object missing required field `(.*)`", message)) is not None:
        return f"`{missing[1]}` is missing; give {KEYS[missing[1]]}", steps or [missing[1]]
    return f"{message}; give {KEYS.get(steps[-1], 'what --help shows')}" if steps else message, steps


def _keys(steps: list[str]) -> list[str]:
    """The keys of a table."""
    tables: dict[tuple[str, ...], type[_Part]] = {(): _Config, ("mqtt",): MqttConfig, ("mqtt", "tls"): TlsConfig}
    table = tables[tuple(steps)]
    return [field.name for field in msgspec.structs.fields(table)]


def _check(config: MqttConfig, text: str, path: Path) -> None:
    """What types do not say."""

    def wrong(key: str, message: str) -> ConfigError:
        return ConfigError(f"{path}:{line_of(text, ['mqtt', *key.split('.')])}: mqtt.{key}: {message}")

    try:
        levels(config.prefix)
    except TopicError as error:
        raise wrong("prefix", str(error)) from error
    try:
        if config.vehicle is not None:
            level(config.vehicle, "vehicle")
    except TopicError as error:
        raise wrong("vehicle", str(error)) from error
    if config.password_file is not None and config.user is None:
        raise wrong("password_file", "a password without a user; give `user` too")
    if config.tls is not None and config.plain:
        raise wrong("plain", "there is [mqtt.tls] too; remove one of them")
    if config.tls is None and not config.plain and not _is_loopback(config.host):
        raise wrong(
            "host", "is another machine, and all would go there in the clear; give [mqtt.tls], or say `plain = true`"
        )
    if config.tls is not None and (config.tls.certificate is None) != (config.tls.key is None):
        raise wrong("tls", "`certificate` and `key` belong together; give both or none")


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def line_of(text: str, steps: list[str]) -> int:
    """The line of the file (from 1) that keys lead to, or of the nearest part around it that has one."""
    found, table = 1, list[str]()
    for number, line in enumerate(text.splitlines(), start=1):
        if (header := re.match(r"\s*\[\s*([\w.\s-]+?)\s*\]", line)) is not None:
            table = [part.strip() for part in header[1].split(".")]
            here = table
        elif (key := re.match(r"""\s*["']?([\w-]+)["']?\s*=""", line)) is not None:
            here = [*table, key[1]]
        else:
            continue
        if here == steps:
            return number
        if here == steps[: len(here)]:
            found = number
    return found
