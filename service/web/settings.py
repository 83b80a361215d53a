"""The settings of `faultline serve`: a TOML file, strict (`service/vehicle/serve.toml`), or the same as options."""

import ipaddress
import re
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.errors import InputError
from faultline.service.strict import ControlSocket, EventsSocket, Part, Path_, read
from faultline.service.web.limits import hosts_of

LISTEN = "127.0.0.1:8080"


class Tcp(msgspec.Struct, frozen=True):
    """An address of the machine and a port; port 0 is any that is free."""

    host: str
    port: int


class Unix(msgspec.Struct, frozen=True):
    """A Unix socket."""

    path: Path


class Settings(Part, frozen=True):
    """The whole file: where the daemon is, where to listen, and whose tokens are taken."""

    control: ControlSocket
    events: EventsSocket
    listen: Annotated[str, Meta(description=f"{LISTEN}, or unix:PATH")] = LISTEN
    token_file: Annotated[Path_, Meta(description="the file of tokens, one a line")] | None = None
    allow_remote: bool = False

    @property
    def place(self) -> Tcp | Unix:
        """Return where to listen; raises InputError where that is no address, or is not allowed."""
        place = address(self.listen)
        if isinstance(place, Tcp) and not ipaddress.ip_address(place.host).is_loopback and not self.allow_remote:
            raise InputError(
                f"listen: {self.listen} can be reached from other machines; take 127.0.0.1 or unix:PATH behind a proxy "
                "with TLS, or say allow_remote = true in the configuration"
            )
        return place

    @property
    def hosts(self) -> frozenset[str] | None:
        """Return the names that this server may be asked as; None for any, where no browser or a token comes first."""
        place = self.place
        return None if isinstance(place, Unix) or self.allow_remote else hosts_of([place.host])


def load_settings(path: Path) -> Settings:
    """Return the settings in the file at `path`; raises ConfigError, which names the line."""
    given = read(path, Settings)
    try:
        given.said.place  # noqa: B018 (it looks)
    except InputError as error:
        raise given.wrong(["listen"], str(error).removeprefix("listen: ")) from error
    return given.said


def address(text: str) -> Tcp | Unix:
    """Return where to listen: `unix:PATH`, `HOST:PORT` or `[HOST]:PORT` with an IP address, or localhost."""
    if text.startswith("unix:"):
        if not text.removeprefix("unix:").startswith("/"):
            raise InputError(f"listen: {text}: give the whole path, as unix:/run/faultline-web/http.sock")
        return Unix(Path(text.removeprefix("unix:")))
    match = re.fullmatch(r"(?:\[([0-9A-Fa-f:]+)\]|([^:\[\]]+)):([0-9]{1,5})", text)
    host = (match[1] or match[2]) if match else ""
    host = "127.0.0.1" if host == "localhost" else host
    try:
        ipaddress.ip_address(host)
    except ValueError as error:
        raise InputError(f"listen: {text!r} is no address; give one like {LISTEN} or unix:/PATH") from error
    assert match is not None
    if int(match[3]) > 65535:
        raise InputError(f"listen: {text}: there is no port above 65535")
    return Tcp(host, int(match[3]))
