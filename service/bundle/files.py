"""The files of a bundle's folder, read strictly: signatures, seal, manifest, hashes; nothing is run.

A bundle is `manifest.json`, its seal `manifest.sha256`, signatures `manifest.KEY.minisig`, and the files that the
manifest lists: the graphs, the DBC and the golden vectors; nothing else. Errors name the path of the bad value
(`generators[2].inputs[0]`).

Seal and hashes protect against damage in copying and against mixing files of two bundles, not against an attacker: who
can change the manifest can seal it anew. Signatures (`service.bundle.signing`) do.
"""

import errno
import hashlib
import os
import re
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

import msgspec

from faultline.service.core.decision.consistency import inconsistencies
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import SCHEMA, File, Manifest

T = TypeVar("T")

MANIFEST = "manifest.json"
SEAL = "manifest.sha256"
OLDER = tuple(f"faultline.bundle/{number}" for number in range(1, 6))
"""Schemas of earlier versions."""
SIGNATURE = re.compile(r"manifest\.[0-9A-F]{16}\.minisig")
"""Names of signatures, by the key's id: there may be several."""
MAXIMUM_SIZE = 64 * 1024 * 1024  # bytes; a bundle is some hundred kilobytes
SIGNATURE_SIZE, MOST_SIGNATURES = 4096, 16


class BundleError(InputError):
    """A bundle that must not be run."""


class Trust(Protocol):
    """Signatures that a bundle must have (`service.bundle.signing.Signed`)."""

    def check(self, raw: bytes, folder: Path, signatures: Mapping[str, bytes]) -> None:
        """Raises InputError where the signatures, by file name in `folder`, are not enough for the manifest's bytes."""


def seal(raw: bytes) -> bytes:
    """Return the content of `manifest.sha256` for a manifest's bytes, which `sha256sum -c manifest.sha256` checks."""
    return f"{hashlib.sha256(raw).hexdigest()}  {MANIFEST}\n".encode()


class _Header(msgspec.Struct):
    schema: str
    detectors: object = None


class Whole(NamedTuple):
    """Files of a bundle: complete, unchanged, nothing else, and nothing of them run or parsed but JSON.

    `id` is the SHA-256 of the manifest's bytes; `contents` are those of all files by name, signatures too.
    """

    id: str
    manifest: Manifest
    contents: Mapping[str, bytes]


def whole(folder: Path, trust: Trust | None = None) -> Whole:
    """Return the files of the bundle in `folder`; the signatures that `trust` demands are checked first.

    Raises:
        BundleError: it is incomplete, of an unknown version, changed or inconsistent, or cannot be read.
        SignatureError: it is not signed as `trust` demands.
    """
    try:
        raw = _read(folder / MANIFEST, "is this a bundle folder made by `faultline export`?")
        signatures = _signatures(folder)
        if trust is not None:
            trust.check(raw, folder, signatures)
        _check_seal(raw, folder)
        manifest = decode_manifest(raw, str(folder / MANIFEST))
        _check_unlisted(folder, manifest)
        listed = {name: _checked(folder / name, file) for name, file in manifest.files.items()}
    except OSError as error:
        place = error.filename or folder
        raise BundleError(f"{place}: cannot be read: {error.strerror}; check the folder's permissions") from error
    contents = {MANIFEST: raw, SEAL: seal(raw), **signatures, **listed}
    return Whole(hashlib.sha256(raw).hexdigest(), manifest, contents)


def _signatures(folder: Path) -> dict[str, bytes]:
    names = sorted(path.name for path in folder.iterdir() if SIGNATURE.fullmatch(path.name))
    if len(names) > MOST_SIGNATURES:
        raise BundleError(f"{folder}: {len(names)} signatures, {MOST_SIGNATURES} are the most; remove some")
    return {name: _read(folder / name, "", SIGNATURE_SIZE) for name in names}


def _read(path: Path, remedy: str, limit: int = MAXIMUM_SIZE) -> bytes:
    """Return the bytes of a plain file only: nothing is known of the folder yet, not even who made it."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        if error.errno == errno.ENOENT:
            raise BundleError(f"{path}: not found; {remedy}") from error
        if error.errno == errno.ELOOP:
            raise BundleError(f"{path}: is a link; a bundle has plain files only: copy it from its source") from error
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise BundleError(f"{path}: is no plain file; {remedy}")
    with os.fdopen(descriptor, "rb") as file:
        raw = file.read(limit + 1)
    if len(raw) > limit:
        raise BundleError(f"{path}: larger than {limit} bytes; this is no faultline bundle")
    return raw


def _check_seal(raw: bytes, folder: Path) -> None:
    path = folder / SEAL
    given = _read(path, "it seals the manifest; copy the whole bundle folder, or export the bundle again")
    if re.fullmatch(rb"[0-9a-f]{64}  manifest\.json\n", given) is None:
        raise BundleError(f"{path}: not one line of `sha256sum {MANIFEST}`; copy the bundle again from its source")
    if given != seal(raw):
        raise BundleError(f"{path}: the bytes of {MANIFEST} differ from it; copy the bundle again from its source")


def _check_unlisted(folder: Path, manifest: Manifest) -> None:
    there = {path.name for path in folder.iterdir() if SIGNATURE.fullmatch(path.name) is None}
    unlisted = sorted(there - {MANIFEST, SEAL, *manifest.files})
    if unlisted:
        names = ", ".join(repr(name) for name in unlisted[:5]) + (", ..." if len(unlisted) > 5 else "")
        raise BundleError(f"{folder}: the manifest does not list {names}; remove what is not part of the bundle")


def _checked(path: Path, file: File) -> bytes:
    raw = _read(path, "the manifest lists it; copy the whole bundle folder")
    if len(raw) != file.size or hashlib.sha256(raw).hexdigest() != file.sha256:
        raise BundleError(
            f"{path}: its bytes differ from the manifest's SHA-256; copy the bundle again from its source"
        )
    return raw


def decode_manifest(raw: bytes, where: str) -> Manifest:
    """Decode the manifest in `raw`: first its version, then every field and their consistency."""
    header = decode_json(raw, _Header, where)
    if header.schema != SCHEMA:
        remedy = "export it again with `faultline export`" if header.schema in OLDER else "install the matching version"
        raise BundleError(f"{where}: schema: this is {header.schema[:80]!r}, this faultline runs {SCHEMA!r}; {remedy}")
    if not header.detectors:
        raise BundleError(
            f"{where}: detectors: there are none, so the bundle has no thresholds; run `faultline tune`, "
            "then `faultline export`"
        )
    manifest = decode_json(raw, Manifest, where)
    for problem in inconsistencies(manifest):
        raise BundleError(f"{where}: {problem}; export the bundle again")
    return manifest


def decode_json(raw: bytes, kind: type[T], where: str) -> T:
    """Decode the JSON in `raw` as a `kind`; raises `BundleError` with the path of the bad value."""
    try:
        return msgspec.json.decode(raw, type=kind)
    except msgspec.ValidationError as error:
        message, _, path = one_line(error).partition(" - at `")
        place = path.replace("`", "").replace("$.", "")  # from `$.a[0].b`, or `key` in `$.a`
        raise BundleError(f"{where}: {place or 'top level'}: {message[:200]}; export the bundle again") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BundleError(f"{where}: not JSON: {one_line(error)}; copy the bundle again from its source") from error


def one_line(error: Exception) -> str:
    """Return the error's message in one line."""
    return " ".join(str(error).split())
