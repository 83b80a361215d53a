"""Credentials: password and certificates, read anew for each connection.

A certificate or a password that was renewed on the disk is used without a restart. systemd's credentials are files in
$CREDENTIALS_DIRECTORY (systemd.exec(5)).
"""

import os
import ssl
from collections.abc import Mapping
from pathlib import Path

from faultline.service.core.errors import InputError
from faultline.service.mqtt.config import MqttConfig, TlsConfig

LONGEST = 65535
"""Bytes of a password at most (MQTT 5.0, 3.1.3.6)."""


def password(config: MqttConfig, environment: Mapping[str, str] = os.environ) -> str | None:
    """Return the password in the file, without the end of its last line.

    Raises:
        InputError: it cannot be read, is empty, too long or no text.
    """
    if config.password_file is None:
        return None
    path = _file(config.password_file, environment)
    try:
        with path.open("rb") as file:
            content = file.read(LONGEST + 3)
        text = content.decode().removesuffix("\n").removesuffix("\r")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror}; give the password's file in `password_file`"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no text; give the password's file in `password_file`") from error
    if not text or len(text.encode()) > LONGEST:
        raise InputError(f"{path}: {'is empty' if not text else 'is too long'}; put the password in it")
    return text


def context(config: TlsConfig, environment: Mapping[str, str] = os.environ) -> ssl.SSLContext:
    """Return the TLS context: TLS 1.2 or newer, a trusted certificate for the broker's name.

    Raises:
        InputError: a file cannot be read or is none of its kind.
    """
    ca = _file(config.ca, environment) if config.ca is not None else None
    try:
        made = ssl.create_default_context(cafile=ca)  # the system's where there is none
    except (OSError, ValueError) as error:
        raise InputError(f"{ca}: no certificates there: {_why(error)}; give `ca` in [mqtt.tls]") from error
    made.minimum_version = ssl.TLSVersion.TLSv1_2
    if config.certificate is not None and config.key is not None:
        certificate, key = _file(config.certificate, environment), _file(config.key, environment)
        try:
            made.load_cert_chain(certificate, key, password=_nobody_to_ask)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{certificate}, {key}: not our certificate and its key: {_why(error)}; "
                "give `certificate` and `key` (not encrypted) in [mqtt.tls]"
            ) from error
    return made


def _nobody_to_ask() -> str:
    """Refuse an encrypted key, for whose password OpenSSL would ask a terminal."""
    raise ValueError("the key is encrypted")


def _file(place: str, environment: Mapping[str, str]) -> Path:
    """Return the path itself, or that of the credential."""
    if place.startswith("/"):
        return Path(place)
    folder = environment.get("CREDENTIALS_DIRECTORY", "")
    if not folder:
        raise InputError(
            f"{place}: is the name of a systemd credential, and there are none; "
            f"give a path (/...), or LoadCredential={place}:... in the unit"
        )
    return Path(folder) / place


def _why(error: Exception) -> str:
    if isinstance(error, ssl.SSLError):
        return (getattr(error, "reason", None) or "no PEM").replace("_", " ").lower()
    return error.strerror or str(error) if isinstance(error, OSError) else str(error)
