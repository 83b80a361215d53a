"""A bundle folder as an exporter could have written it, with anything changed."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from faultline.service.bundle.files import SEAL, BundleError, seal
from faultline.service.bundle.load import load_bundle, verify_golden

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "bundle"

Change = Callable[[dict[str, Any]], object]


def copied(folder: Path) -> Path:
    """A golden bundle that a test may change."""
    return Path(shutil.copytree(GOLDEN, folder / "bundle"))


def check_line(bundle: Path, error: BundleError) -> None:
    """A refusal is one line that names the folder, short enough to be read."""
    assert str(bundle) in str(error)
    assert len(str(error).splitlines()) == 1
    assert len(str(error)) < 1000


def refused(bundle: Path, message: str) -> None:
    """Loading the folder fails with this message (a pattern)."""
    with pytest.raises(BundleError, match=message) as caught:
        load_bundle(bundle)
    check_line(bundle, caught.value)


def runs(bundle: Path) -> bool:
    """Whether the folder loads and its golden vectors agree; any error but a refusal gets out."""
    try:
        verify_golden(load_bundle(bundle))
    except BundleError as error:
        check_line(bundle, error)
        return False
    return True


def write(bundle: Path, raw: bytes) -> None:
    """A manifest of these bytes, and its seal."""
    (bundle / "manifest.json").write_bytes(raw)
    (bundle / SEAL).write_bytes(seal(raw))


def edit(bundle: Path, change: Change) -> None:
    """Changes the manifest and seals it anew."""
    manifest = json.loads((bundle / "manifest.json").read_bytes())
    change(manifest)
    write(bundle, json.dumps(manifest).encode())


def put(bundle: Path, name: str, content: bytes) -> None:
    """Gives a listed file another content, with the hash that belongs to it."""
    (bundle / name).write_bytes(content)
    file = {"sha256": hashlib.sha256(content).hexdigest(), "size": len(content)}
    edit(bundle, lambda manifest: manifest["files"].update({name: file}))
