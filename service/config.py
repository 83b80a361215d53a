"""The service's configuration: a TOML file, strict, whose errors name the line.

source = "truck-17"                                  # the vehicle's name in events; default: the host's

[[bus]]
name = "powertrain"
interface = "socketcan:can0"                         # or udp_multicast:GROUP:PORT
# believe_local = true                               # take what processes of this machine send, for trials

[[bundle]]                                           # as often as there are bundles
path = "/var/lib/faultline/bundles/uds"
bus = "powertrain"

[trust]
keys = "/etc/faultline/keys"                         # public keys *.pub of those who may sign bundles
# signatures = 2                                     # by so many different ones of them; default: 1
# allow_unsigned = true                              # instead, for trials

[events]
socket = "/run/faultline/events.sock"
"""

import re
import socket
import tomllib
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from service.core.errors import InputError

Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.-]*\Z", max_length=80)]
"""It stands in ids and topics: nothing that means something there."""
Path_ = Annotated[str, Meta(pattern=r"\A/[^\x00]*\Z", max_length=1000)]

LARGEST = 256 * 1024  # bytes of a file that somebody wrote


class ConfigError(InputError):
    """A configuration that must not be used."""


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Common strictness."""


class BusConfig(_Part, frozen=True):
    """A bus; its interface need not be there yet."""

    name: Name
    interface: str
    believe_local: bool = False


class BundleConfig(_Part, frozen=True):
    """A bundle's folder, or a link to it, and the bus that its frames are on."""

    path: Path_
    bus: Name


class TrustConfig(_Part, frozen=True):
    """Whose bundles are taken."""

    keys: Path_ | None = None
    signatures: Annotated[int, Meta(ge=1, le=16)] = 1
    allow_unsigned: bool = False


class EventsConfig(_Part, frozen=True):
    """Where subscribers connect."""

    socket: Path_


class Config(_Part, frozen=True):
    """The whole file."""

    bus: Annotated[list[BusConfig], Meta(min_length=1, max_length=16)]
    bundle: Annotated[list[BundleConfig], Meta(min_length=1, max_length=64)]
    trust: TrustConfig
    events: EventsConfig
    source: Name = msgspec.field(default_factory=socket.gethostname)


def load_config(path: Path) -> Config:
    """The configuration in the file at `path`.

    Raises:
        ConfigError: it cannot be read, is no TOML, or says what makes no sense; the message names the line.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
        if len(raw) > LARGEST:
            raise ConfigError(f"{path}: more than {LARGEST // 1024} KiB; this is no configuration")
        text = raw.decode()
        tree = tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give another --config") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from error
    try:
        config = msgspec.convert(tree, Config)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at `")
        steps = _steps(where.removesuffix("`").removeprefix("$"))
        if (unknown := re.search(r"unknown field `(.*)`", message)) is not None:
            steps.append(unknown.group(1))
        place = f"{path}:{_line(text, steps)}"
        name = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).removeprefix(".")
        raise ConfigError(f"{place}: {name + ': ' if name else ''}{message}") from error
    _check(config, text, path)
    return config


def _check(config: Config, text: str, path: Path) -> None:
    """What the parts must say of each other."""
    if (config.trust.keys is None) != config.trust.allow_unsigned:
        raise ConfigError(
            f"{path}:{_line(text, ['trust'])}: trust: give the folder of the trusted public keys, `keys`, or for "
            "trials `allow_unsigned = true`; one of them"
        )
    names = [bus.name for bus in config.bus]
    for k, bus in enumerate(config.bus):
        if Counter(names)[bus.name] > 1 and names.index(bus.name) != k:
            raise ConfigError(f"{path}:{_line(text, ['bus', k, 'name'])}: bus {bus.name!r} is there twice; rename one")
    paths = [bundle.path for bundle in config.bundle]
    for k, bundle in enumerate(config.bundle):
        if bundle.bus not in names:
            raise ConfigError(
                f"{path}:{_line(text, ['bundle', k, 'bus'])}: there is no bus {bundle.bus!r}; "
                f"those are {', '.join(names)}"
            )
        if paths.index(bundle.path) != k:
            raise ConfigError(f"{path}:{_line(text, ['bundle', k, 'path'])}: this bundle is there twice; remove one")


def _steps(where: str) -> list[str | int]:
    """`.bus[1].name` as steps."""
    return [int(number) if number else key for key, number in re.findall(r"\.([\w-]+)|\[(\d+)\]", where)]


def _line(text: str, steps: list[Any]) -> int:
    """The line of the file (from 1) that `steps` lead to, or of the nearest part around it that has one."""
    found, table, counts = 1, [], Counter[str]()
    for number, line in enumerate(text.splitlines(), start=1):
        if (many := re.match(r"\s*\[\[\s*([\w.-]+)\s*\]\]", line)) is not None:
            table = [many.group(1), counts[many.group(1)]]
            counts[many.group(1)] += 1
            here = table
        elif (one := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line)) is not None:
            table = here = [one.group(1)]
        elif (key := re.match(r"""\s*["']?([\w-]+)["']?\s*=""", line)) is not None:
            here = [*table, key.group(1)]
        else:
            continue
        if here == steps:
            return number
        if here == steps[: len(here)]:
            found = number
    return found
