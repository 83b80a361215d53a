"""The service's configuration: a TOML file, strict; `service/vehicle/faultline.toml` has all its keys."""

import socket
from collections import Counter
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.memory.rules import Rules
from faultline.service.strict import ConfigError, ControlSocket, EventsSocket, Name, Part, Path_, Read, read


class BusConfig(Part, frozen=True):
    """A bus; its interface need not be there yet."""

    name: Name
    interface: Annotated[
        str, Meta(description="socketcan:NAME, can:INTERFACE:CHANNEL[:BITRATE] or udp_multicast:GROUP:PORT")
    ]
    believe_local: bool = False
    trouble_codes: bool = False


class BundleConfig(Part, frozen=True):
    """A bundle's folder, or a link to it, and the bus that its frames are on."""

    path: Path_
    bus: Annotated[Name, Meta(description="the name of a [[bus]]")]


class TrustConfig(Part, frozen=True):
    """Whose bundles are taken."""

    keys: Annotated[Path_, Meta(description="the folder of the trusted public keys")] | None = None
    signatures: Annotated[int, Meta(ge=1, le=16)] = 1
    allow_unsigned: bool = False


class EventsConfig(Part, frozen=True):
    """Where subscribers connect."""

    socket: EventsSocket


class StoreConfig(Part, frozen=True):
    """Where events are kept."""

    path: Annotated[Path_, Meta(description="a file that we may write, as /var/lib/faultline/events.sqlite")]


class ControlConfig(Part, frozen=True):
    """Where other processes ask, and the users that may erase faults besides root and our own."""

    socket: ControlSocket
    clear: tuple[Name, ...] = ()


class MemoryConfig(Rules, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How faults are remembered; a freeze frame reaches `frame_s` [s] before and after what was told."""

    frame_s: Annotated[float, Meta(ge=1, le=60)] = 10.0


class Config(Part, frozen=True):
    """The whole file."""

    bus: Annotated[list[BusConfig], Meta(min_length=1, max_length=16)]
    bundle: Annotated[list[BundleConfig], Meta(min_length=1, max_length=64)]
    trust: TrustConfig
    events: EventsConfig
    store: StoreConfig | None = None
    control: ControlConfig | None = None
    memory: MemoryConfig = MemoryConfig()
    source: Name = msgspec.field(default_factory=socket.gethostname)


def load_config(path: Path) -> Config:
    """The configuration in the file at `path`.

    Raises:
        ConfigError: it cannot be read, is no TOML, or says what makes no sense; the message names the line.
    """
    file = read(path, Config)
    _check(file)
    return file.said


def named(name: str, where: str) -> str:
    """The vehicle's name, that may stand in ids and topics; raises ConfigError where it may not."""
    try:
        return msgspec.convert(name, Name)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{where}: {name!r} cannot be the vehicle's name: letters, digits, _ . and - only") from error


def _check(file: Read[Config]) -> None:
    """What the parts must say of each other, and the host's name where it is the vehicle's."""
    config = file.said
    named(config.source, f"{file.path}: source")
    if (config.trust.keys is None) != config.trust.allow_unsigned:
        raise file.wrong(
            ["trust"],
            "give the folder of the trusted public keys, `keys`, or for trials `allow_unsigned = true`; one of them",
        )
    names = [bus.name for bus in config.bus]
    for k, bus in enumerate(config.bus):
        if Counter(names)[bus.name] > 1 and names.index(bus.name) != k:
            raise file.wrong(["bus", k, "name"], f"bus {bus.name!r} is there twice; rename one")
    paths = [bundle.path for bundle in config.bundle]
    for k, bundle in enumerate(config.bundle):
        if bundle.bus not in names:
            raise file.wrong(["bundle", k, "bus"], f"there is no bus {bundle.bus!r}; those are {', '.join(names)}")
        if paths.index(bundle.path) != k:
            raise file.wrong(["bundle", k, "path"], "this bundle is there twice; remove one")
