"""Bearer tokens: who may clear faults, and with `allow_remote` who may ask at all.

Source: RFC 6750 for the characters of a token.
"""

import hashlib
import hmac
import os
import re
import stat
from collections.abc import Iterable, Mapping
from pathlib import Path

from faultline.service.core.errors import InputError

LEAST = 32  # characters of a token
LARGEST = 64 * 1024  # bytes of the file
CREDENTIAL = "http-tokens"  # its name where systemd hands it over: LoadCredential=http-tokens:FILE

_TOKEN = re.compile(r"[A-Za-z0-9._~+/-]+=*")


class Tokens:
    """The tokens that are taken, as digests; none where clearing is not configured."""

    def __init__(self, tokens: Iterable[str] = ()) -> None:
        self._digests = [_digest(token) for token in tokens]

    def __bool__(self) -> bool:
        return bool(self._digests)

    def known(self, token: str) -> bool:
        """Return True if it is one of them, in a time that does not depend on how near it is, nor to which."""
        digest = _digest(token)
        return sum(hmac.compare_digest(digest, each) for each in self._digests) > 0


def bearer(header: str) -> str | None:
    """Return the token in an Authorization header; None if there is none."""
    scheme, _, token = header.partition(" ")
    token = token.strip()
    return token if scheme.lower() == "bearer" and _TOKEN.fullmatch(token) else None


def find_tokens(path: str | None, environment: Mapping[str, str] = os.environ) -> Tokens:
    """Return the tokens in the file at `path`, else in the credential that systemd hands over, else none.

    Raises:
        InputError: the file cannot be read, others may read it, or a token is too short or has other characters.
    """
    if path is not None:
        return load_tokens(Path(path))
    folder = environment.get("CREDENTIALS_DIRECTORY")
    if folder and (Path(folder) / CREDENTIAL).exists():
        return load_tokens(Path(folder) / CREDENTIAL)
    return Tokens()


def load_tokens(path: Path) -> Tokens:
    """Return the tokens of a file: one a line; empty lines and those that begin with # are left out."""
    try:
        with path.open("rb") as file:
            _check(path, os.fstat(file.fileno()))
            content = file.read(LARGEST + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; give another token file") from error
    if len(content) > LARGEST:
        raise InputError(f"{path}: more than {LARGEST // 1024} KiB; this is no file of tokens")
    tokens = []
    for number, line in enumerate(content.decode("latin-1").splitlines(), start=1):
        token = line.strip()
        if token and not token.startswith("#"):
            if not _TOKEN.fullmatch(token):
                raise InputError(f"{path}:{number}: a token has letters, digits and -._~+/ only, with = at its end")
            if len(token) < LEAST:
                raise InputError(
                    f"{path}:{number}: a token needs {LEAST} characters at least; `openssl rand -hex 32` makes one"
                )
            tokens.append(token)
    if not tokens:
        raise InputError(f"{path}: no token in it; `openssl rand -hex 32` makes one")
    return Tokens(tokens)


def _check(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path}: is no regular file; give another token file")
    if status.st_mode & (stat.S_IROTH | stat.S_IWOTH):
        raise InputError(f"{path}: others may read or write it; `chmod o= {path}`, and make new tokens")


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode()).digest()
