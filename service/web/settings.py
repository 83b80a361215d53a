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


class _File(Part, frozen=True):
    """The whole file."""

    control: ControlSocket
    events: EventsSocket
    listen: Annotated[str, Meta(description=f"{LISTEN}, or unix:PATH")] = LISTEN
    token_file: Annotated[Path_, Meta(description="the file of tokens, one a line")] | None = None
    allow_remote: bool = False


class Tcp(msgspec.Struct, frozen=True):
    """An address of the machine and a port; port 0 is any that is free."""

    host: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        return ipaddress.ip_address(self.host).is_loopback


class Unix(msgspec.Struct, frozen=True):
    """A Unix socket."""

    path: Path


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """Where the daemon is, where to listen, and whose tokens are taken."""

    control: Path
    events: Path
    listen: Tcp | Unix
    token_file: Path | None = None
    allow_remote: bool = False

    @property
    def hosts(self) -> frozenset[str] | None:
        """The names under which this server may be asked; None for any, where no browser or a token comes first."""
        if isinstance(self.listen, Unix) or self.allow_remote:
            return None
        return hosts_of([self.listen.host])


def load_settings(path: Path) -> Settings:
    """The settings in the file at `path`.

    Raises:
        ConfigError: it cannot be read, is no TOML, or says what makes no sense; the message names the line.
    """
    given = read(path, _File)
    said = given.said
    try:
        return checked(said.control, said.events, said.listen, said.token_file, allow_remote=said.allow_remote)
    except InputError as error:
        raise given.wrong(["listen"], str(error).removeprefix("listen: ")) from error


def checked(
    control: str, events: str, listen: str, token_file: str | None = None, *, allow_remote: bool = False
) -> Settings:
    """The settings as they are given.

    Raises:
        InputError: `listen` is no address, or another machine could reach it and that is not allowed.
    """
    place = address(listen)
    if isinstance(place, Tcp) and not place.is_loopback and not allow_remote:
        raise InputError(
            f"listen: {listen} can be reached from other machines; take 127.0.0.1 or unix:PATH behind a proxy with "
            "TLS, or say allow_remote = true in the configuration"
        )
    return Settings(
        control=Path(control),
        events=Path(events),
        listen=place,
        token_file=None if token_file is None else Path(token_file),
        allow_remote=allow_remote,
    )


def address(text: str) -> Tcp | Unix:
    """Where to listen: `unix:PATH`, `HOST:PORT` or `[HOST]:PORT` with an IP address, or localhost."""
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
