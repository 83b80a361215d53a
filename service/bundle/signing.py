"""Signatures of bundles: ed25519 (RFC 8032), in the file formats of minisign, so that its own tool can verify them too.

    minisign -V -p keys/fleet.pub -m bundle/manifest.json -x bundle/manifest.1A2B3C4D5E6F7081.minisig

A signature is made over the BLAKE2b-512 of the exact bytes (minisign's *prehashed* form); a key's id is that of the
public key's bytes, so that two keys with one id are not to be had by chance. The private key is a PEM file, as
`openssl genpkey -algorithm ed25519 -aes256` writes it: minisign's own, encrypted, is not read.
"""

import base64
import binascii
import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from faultline.service.core.errors import InputError

PURE, HASHED = b"Ed", b"ED"
SUFFIX = ".minisig"
LARGEST = 4096  # bytes of a key or a signature file: they have some 300

_UNTRUSTED, _TRUSTED = "untrusted comment: ", "trusted comment: "


class SignatureError(InputError):
    """Invalid or untrusted signature or key."""


class PublicKey(NamedTuple):
    """Trusted key: its id (8 bytes), the key itself (32), and the file's name."""

    id: bytes
    key: bytes
    name: str

    @property
    def label(self) -> str:
        """Return the id as minisign writes it."""
        return label(self.id)


class Signature(NamedTuple):
    """Content of a signature file; `comment` is signed too."""

    algorithm: bytes
    key_id: bytes
    signature: bytes
    comment: str
    of_comment: bytes


def label(key_id: bytes) -> str:
    """Return a key's id in hexadecimal, the last byte first, as minisign writes it."""
    return key_id[::-1].hex().upper()


def load_private(path: Path, password: bytes | None) -> Ed25519PrivateKey:
    """Load the private key in a PEM file.

    Raises:
        SignatureError: it cannot be read, is no ed25519 key, or the password is missing or wrong.
    """
    raw = _read(path, "openssl genpkey -algorithm ed25519 -out key.pem makes one")
    try:
        key = load_pem_private_key(raw, password)
    except TypeError as error:
        what = "is encrypted; give its password" if password is None else "is not encrypted; leave the password out"
        raise SignatureError(f"{path}: {what}") from error
    except (ValueError, UnsupportedAlgorithm) as error:
        raise SignatureError(f"{path}: no private key in PEM, or the password is wrong; give another") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise SignatureError(f"{path}: not an ed25519 key; openssl genpkey -algorithm ed25519 -out key.pem makes one")
    return key


def public_of(private: Ed25519PrivateKey, name: str = "") -> PublicKey:
    """Return the public key of a private one."""
    raw = private.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
    return PublicKey(hashlib.blake2b(raw, digest_size=8).digest(), raw, name)


def public_text(key: PublicKey) -> str:
    """Return the content of the public key's file."""
    return f"{_UNTRUSTED}minisign public key {key.label}\n{_base64(PURE + key.id + key.key)}\n"


def load_public(path: Path) -> PublicKey:
    """Load the public key in a file of minisign's; raises SignatureError if it is none."""
    what = "a public key of minisign's, or of `faultline bundle public`"
    lines = _lines(_read(path, f"give {what}"), str(path), 2, what)
    raw = _bytes(lines[1], str(path), 2)
    if len(raw) != 42 or raw[:2] != PURE:
        raise SignatureError(f"{path}: line 2: not an ed25519 public key; copy it again from its source")
    return PublicKey(raw[2:10], raw[10:], path.name)


def load_keys(folder: Path) -> dict[bytes, PublicKey]:
    """Load all keys `*.pub` of a folder, by id.

    Raises:
        SignatureError: there is none, one is no key, or two have the same id.
    """
    paths = sorted(path for path in folder.glob("*.pub") if path.is_file())  # a pipe would hold up the start
    if not paths:
        raise SignatureError(f"{folder}: no trusted key *.pub; put the public keys of those who may sign there")
    keys: dict[bytes, PublicKey] = {}
    for path in paths:
        key = load_public(path)
        if (other := keys.setdefault(key.id, key)).key != key.key:
            raise SignatureError(f"{path}: another key than {other.name} with the same id {key.label}; remove one")
    return keys


def sign(raw: bytes, private: Ed25519PrivateKey, comment: str) -> str:
    """Return the content of the signature's file for these bytes; `comment` is signed too."""
    if re.search(r"[\r\n]", comment):
        raise ValueError("a comment is one line")
    key = public_of(private)
    signature = private.sign(_digest(raw))
    told = f"{_UNTRUSTED}signature by key {key.label}\n{_base64(HASHED + key.id + signature)}\n"
    return f"{told}{_TRUSTED}{comment}\n{_base64(private.sign(signature + comment.encode()))}\n"


def verify(raw: bytes, signature: bytes, where: str, keys: Mapping[bytes, PublicKey]) -> PublicKey:
    """Return the key that signed these bytes, by a signature file's content; `where` names it in errors.

    Raises:
        SignatureError: it is no signature, of a key that is not trusted, or not of these bytes.
    """
    given = _signature(signature, where)
    key = keys.get(given.key_id)
    if key is None:
        raise SignatureError(
            f"{where}: signed by key {label(given.key_id)}, which is not trusted; "
            f"those are {', '.join(f'{each.label} ({each.name})' for each in keys.values())}"
        )
    public = Ed25519PublicKey.from_public_bytes(key.key)
    try:
        public.verify(given.signature, _digest(raw) if given.algorithm == HASHED else raw)
        public.verify(given.of_comment, given.signature + given.comment.encode())
    except InvalidSignature as error:
        raise SignatureError(
            f"{where}: is not of these bytes: the bundle was changed, or the signature is another's; do not use it"
        ) from error
    return key


def signers(raw: bytes, signatures: Mapping[str, bytes], keys: Mapping[bytes, PublicKey]) -> list[PublicKey]:
    """Return the different trusted keys that signed these bytes; signatures of others do not count.

    Raises:
        SignatureError: a file (its content by its path) is no signature, or one of a trusted key not of these bytes.
    """
    found: dict[bytes, PublicKey] = {}  # by the key itself: an id is only what a file says
    for where, signature in signatures.items():
        if _signature(signature, where).key_id in keys:
            key = verify(raw, signature, where, keys)
            found[key.key] = key
    return [*found.values()]


class Signed(NamedTuple):
    """Trust in a bundle that `required` different ones of these keys have signed (`service.bundle.load.Trust`)."""

    keys: Mapping[bytes, PublicKey]
    required: int = 1

    def check(self, raw: bytes, folder: Path, signatures: Mapping[str, bytes]) -> None:
        """Check all signatures, by file name in `folder`, which are over the manifest's bytes.

        Raises:
            SignatureError: they are too few, or one of a trusted key is not of these bytes.
        """
        by = signers(raw, {str(folder / name): content for name, content in signatures.items()}, self.keys)
        if len(by) < self.required:
            trusted = ", ".join(f"{key.label} ({key.name})" for key in self.keys.values())
            raise SignatureError(
                f"{folder}: signed by {len(by)} trusted keys of {self.required} that are needed ({len(signatures)} "
                f"signatures are there; trusted: {trusted}); take a bundle from who may make it"
            )


def _signature(content: bytes, where: str) -> Signature:
    lines = _lines(content, where, 4, "a signature of minisign's, or of `faultline bundle sign`")
    raw, of_comment = _bytes(lines[1], where, 2), _bytes(lines[3], where, 4)
    if len(raw) != 74 or raw[:2] not in (PURE, HASHED):
        raise SignatureError(f"{where}: line 2: not an ed25519 signature; copy it again from its source")
    if not lines[2].startswith(_TRUSTED) or len(of_comment) != 64:
        raise SignatureError(f"{where}: line 3: no trusted comment with its signature; copy it again from its source")
    return Signature(raw[:2], raw[2:10], raw[10:], lines[2].removeprefix(_TRUSTED), of_comment)


def _digest(raw: bytes) -> bytes:
    return hashlib.blake2b(raw).digest()


def _read(path: Path, remedy: str) -> bytes:
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
    except OSError as error:
        raise SignatureError(f"{path}: cannot be read: {error.strerror}; {remedy}") from error
    if len(raw) > LARGEST:
        raise SignatureError(f"{path}: more than {LARGEST} bytes; {remedy}")
    return raw


def _lines(content: bytes, where: str, count: int, what: str) -> list[str]:
    if len(content) > LARGEST:
        raise SignatureError(f"{where}: more than {LARGEST} bytes; give {what}")
    try:
        lines = content.decode().splitlines()
    except UnicodeDecodeError as error:
        raise SignatureError(f"{where}: no text; give {what}") from error
    if len(lines) != count or not lines[0].startswith(_UNTRUSTED):
        raise SignatureError(f"{where}: not {what}")
    return lines


def _bytes(line: str, where: str, number: int) -> bytes:
    try:
        return base64.b64decode(line, validate=True)
    except (binascii.Error, ValueError) as error:
        raise SignatureError(f"{where}: line {number}: not base64; copy it again from its source") from error


def _base64(raw: bytes) -> str:
    return base64.b64encode(raw).decode()
