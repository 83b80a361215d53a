"""Messages for a person: why there is no connection to the broker."""

import re
import socket
import ssl

from paho.mqtt.reasoncodes import ReasonCode

from faultline.service.core.errors import InputError

TIMEOUT_S = 10.0
"""So long may each step of connecting take."""

_NO_MQTT = "it closed the connection before it took us; check `port` and [mqtt.tls]"

_REMEDIES = {
    0x84: "it takes no MQTT 5",
    0x85: "give another `client_id`",
    0x86: "check `user` and `password_file`",
    0x87: "check `user`, `password_file` and what the broker allows them",
    0x8C: "check `user` and `password_file`",
    0x8E: "another client has the same name; give another `client_id`",
    0x90: "check what it allows under `prefix`",
    0x95: "a message is larger than it takes",
    0x9A: "it keeps no retained messages; faultline needs them",
    0x9B: "it takes no QoS 1; faultline needs it",
}


def failed(error: Exception) -> str:
    """Return why connecting failed."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not believed: {error.verify_message.rstrip('.')}; check `ca` and `host`"
    if isinstance(error, ssl.SSLError):
        reason = _plain(getattr(error, "reason", None) or str(error))
        return f"TLS failed: {reason}; check `port` and [mqtt.tls]"
    if isinstance(error, socket.gaierror):
        return f"its name cannot be found: {error.strerror}; check `host` and the network"
    if isinstance(error, TimeoutError):
        return f"no answer within {TIMEOUT_S:.0f} s"
    if isinstance(error, ConnectionResetError):
        return _NO_MQTT
    if isinstance(error, ConnectionRefusedError):
        return "nobody listens there; is the broker running?"
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


def lost(words: str, *, is_up: bool) -> str:
    """Return why a connection broke, from paho's `words`: before or after the broker accepted it."""
    if is_up:
        return f"the connection is lost: {_plain(words)}"
    if "SSL" in words or "ssl" in words:
        return f"TLS failed: {_plain(words)}; check [mqtt.tls]"
    return _NO_MQTT


def refused(code: ReasonCode) -> str:
    """Return why the broker refuses the connection."""
    return _with_remedy("it refuses us", code)


def ended(code: ReasonCode) -> str:
    """Return why the broker ended the connection."""
    return _with_remedy("it has ended the connection", code)


def _plain(words: str) -> str:
    """Return the words without what only programmers read: `[SSL: NAME] name (_ssl.c:2580)`, `[Errno 104] ...`."""
    return re.sub(r"\[[^]]*\] *| *\(_ssl\.c:\d+\)", "", words).replace("_", " ").lower()


def _with_remedy(what: str, code: ReasonCode) -> str:
    remedy = _REMEDIES.get(code.value)
    return f"{what}: {code.getName().lower()}" + (f"; {remedy}" if remedy else "")
