"""Listening socket, made before anything else, so that an unusable address is reported at once."""

import socket

from faultline.service.core.errors import InputError
from faultline.service.outputs import listening
from faultline.service.web.settings import Tcp, Unix

WAITING = 1024  # connections that the kernel holds until they are taken
UNSENT = 256 * 1024  # bytes that the kernel takes for a client that reads slowly; else megabytes, of our memory
UNANSWERED_MS = 30_000  # after which a peer that acknowledges nothing is gone


def listen(place: Tcp | Unix) -> socket.socket:
    """Return a listening socket; raises InputError if the address is taken, or cannot be used."""
    return _tcp(place) if isinstance(place, Tcp) else listening.listen(place.path, "--listen", WAITING)


def url(sock: socket.socket) -> str:
    """Return the URL for a person."""
    name = sock.getsockname()
    if sock.family == socket.AF_UNIX:
        return f"unix:{name}"
    host, port = name[:2]
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def remove(place: Tcp | Unix) -> None:
    """Remove the file of a Unix socket."""
    if isinstance(place, Unix):
        place.path.unlink(missing_ok=True)


def _tcp(place: Tcp) -> socket.socket:
    family = socket.AF_INET6 if ":" in place.host else socket.AF_INET
    sock = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)  # asyncio looks for it: no delays (Nagle's)
    try:  # accepted ones inherit the options
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MS)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, UNSENT)
        sock.bind((place.host, place.port))
        sock.listen(WAITING)
    except OSError as error:
        sock.close()
        raise InputError(
            f"listen: {place.host}:{place.port}: {error.strerror or error}; give another --listen"
        ) from error
    return sock
