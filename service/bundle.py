"""Reads a bundle folder, strictly: header, then hashes, then the manifest; nothing is parsed that was not checked.

A bundle is `manifest.json` and the files it lists: the graph, the DBC and the golden vectors. Errors name the path of
the bad value (`generators[2].inputs[0]`).
"""

import hashlib
import re
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np

from service.core.decode import DecodeTable, compile_dbc
from service.core.errors import InputError
from service.core.generators import GeneratorBank
from service.core.manifest import SCHEMA, Manifest

T = TypeVar("T")

MANIFEST = "manifest.json"
MAXIMUM_SIZE = 64 * 1024 * 1024  # bytes; a bundle is some hundred kilobytes

TOLERANCE_PA = 1e-3
"""How far a replayed golden residual may be from the exported one: another processor rounds differently, no more."""


class BundleError(InputError):
    """A bundle that must not be run."""


class Golden(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Golden vectors: samples `z` (K, nz) of a recording's beginning and the residuals `r` (K, T) they must give."""

    z: list[list[float]]
    r: list[list[float]]


class Bundle(NamedTuple):
    """A verified bundle. `id` is the SHA-256 of the manifest's bytes."""

    id: str
    manifest: Manifest
    graph: bytes
    table: DecodeTable
    golden: Golden

    def bank(self) -> GeneratorBank:
        """Fresh generators."""
        return GeneratorBank(self.graph, self.manifest.generators, self.manifest.inputs)


def load_bundle(folder: Path) -> Bundle:
    """The bundle in `folder`.

    Raises:
        BundleError: it is incomplete, of an unknown version, changed, or inconsistent.
    """
    raw = _read(folder / MANIFEST, "is this a bundle folder made by `faultline export`?")
    manifest = decode_manifest(raw, str(folder / MANIFEST))
    contents = {name: _checked(folder / name, file.sha256, file.size) for name, file in manifest.files.items()}
    dbc = _listed(manifest.dbc, contents, "dbc", folder)
    graph = _listed(manifest.graph, contents, "graph", folder)
    golden = _listed(manifest.golden, contents, "golden", folder)
    units = {channel.signal: channel.unit for channel in manifest.inputs}
    try:
        table = compile_dbc(dbc.decode(), units, str(folder / manifest.dbc))
    except UnicodeDecodeError as error:
        raise BundleError(f"{folder / manifest.dbc}: not text: {error}; export the bundle again") from error
    vectors = _decode(golden, Golden, str(folder / manifest.golden))
    return Bundle(hashlib.sha256(raw).hexdigest(), manifest, graph, table, vectors)


def decode_manifest(raw: bytes, where: str) -> Manifest:
    """The manifest in `raw`; the version is looked at first, then every field and what they say of each other."""
    schema = _decode(raw, _Header, where).schema
    if schema != SCHEMA:
        raise BundleError(
            f"{where}: schema: this is {schema!r}, this faultline runs {SCHEMA!r}; install the matching version"
        )
    manifest = _decode(raw, Manifest, where)
    for problem in _inconsistencies(manifest):
        raise BundleError(f"{where}: {problem}; export the bundle again")
    return manifest


def verify_golden(bundle: Bundle) -> None:
    """Runs the golden vectors through fresh generators.

    Raises:
        BundleError: a residual differs by more than `TOLERANCE_PA`: this machine does not compute what was exported.
    """
    bank = bundle.bank()
    usable = np.ones(len(bundle.manifest.inputs), dtype=np.bool_)
    for tick, (z, expected) in enumerate(zip(bundle.golden.z, bundle.golden.r, strict=True)):
        difference = np.abs(bank.step(np.array(z), usable).r - np.array(expected))
        if not (difference <= TOLERANCE_PA).all():
            name = bundle.manifest.generators[int(np.argmax(difference))].name
            raise BundleError(
                f"bundle {bundle.manifest.name}: golden vector {tick}: {name} is off by {difference.max():g} Pa; "
                "this machine's onnxruntime computes something else than the exporter's: install the same version"
            )


class _Header(msgspec.Struct):
    schema: str


def _read(path: Path, hint: str) -> bytes:
    if not path.is_file():
        raise BundleError(f"{path}: not found; {hint}")
    if path.stat().st_size > MAXIMUM_SIZE:
        raise BundleError(f"{path}: larger than {MAXIMUM_SIZE} bytes; this is no faultline bundle")
    return path.read_bytes()


def _checked(path: Path, sha256: str, size: int) -> bytes:
    raw = _read(path, "the manifest lists it; copy the whole bundle folder")
    if len(raw) != size or hashlib.sha256(raw).hexdigest() != sha256:
        raise BundleError(
            f"{path}: its bytes differ from the manifest's SHA-256; copy the bundle again from its source"
        )
    return raw


def _listed(name: str, contents: dict[str, bytes], field: str, folder: Path) -> bytes:
    if name not in contents:
        raise BundleError(f"{folder / MANIFEST}: {field}: {name!r} is not in files; export the bundle again")
    return contents[name]


def _decode(raw: bytes, kind: type[T], where: str) -> T:
    try:
        return msgspec.json.decode(raw, type=kind)
    except msgspec.ValidationError as error:
        message, _, path = str(error).partition(" - at `$")
        raise BundleError(f"{where}: {path.rstrip('`').lstrip('.') or 'top level'}: {message}") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BundleError(f"{where}: not JSON: {error}; copy the bundle again from its source") from error


def _inconsistencies(manifest: Manifest) -> list[str]:
    """What the fields say of each other that cannot be, each with its path."""
    signals = {channel.signal for channel in manifest.inputs}
    faults = {fault.name for fault in manifest.faults}
    names = [generator.name for generator in manifest.generators]
    found = []
    for row, generator in enumerate(manifest.generators):
        found += [f"generators[{row}].inputs: unknown signal {s!r}" for s in generator.inputs if s not in signals]
        found += [f"generators[{row}].faults: unknown fault {f!r}" for f in generator.faults if f not in faults]
        for column, state in enumerate(generator.states):
            unknown = [signal for signal in state.gain if signal not in signals]
            found += [f"generators[{row}].states[{column}].gain: unknown signal {signal!r}" for signal in unknown]
    if [detector.generator for detector in manifest.detectors] != names:
        found.append("detectors: not one for each generator, in the same order")
    found += [
        f"evidence.generators: unknown generator {name!r}" for name in manifest.evidence.generators if name not in names
    ]
    if manifest.modes.signal not in signals:
        found.append(f"modes.signal: unknown signal {manifest.modes.signal!r}")
    overlap = set(manifest.origin.calibrate) & set(manifest.origin.tune)
    if overlap:
        found.append(f"origin: data set {min(overlap)[:12]} was used to calibrate and to tune")
    for name in manifest.files:
        if re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", name) is None:
            found.append(f"files: {name!r} is not a plain file name")
    return found
