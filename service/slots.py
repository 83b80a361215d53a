"""Two slots for a bundle, of which one is current: a new one is put into the other, tried there, and then swapped in.

    DIR/a  DIR/b        the slots, each a bundle's folder or absent
    DIR/current         a link to one of them; replaced in one step, so that it always leads to a whole bundle
    DIR/floor.json      the highest version that was ever current: nothing older is taken, whoever has signed it

Whatever happens in between, a power cut too, the current bundle stays as it is until the new one is whole on the disk.
"""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from service.bundle_files import Trust, Whole, whole
from service.core.errors import InputError

SLOTS = ("a", "b")
CURRENT, FLOOR = "current", "floor.json"


class SlotError(InputError):
    """A bundle that is not taken, or a folder that has no slots."""


class _Floor(msgspec.Struct, forbid_unknown_fields=True):
    version: Annotated[int, Meta(ge=0)]
    id: str


class Slots:
    """The slots of one bundle in a folder, which need not be there yet."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def current(self) -> str | None:
        """The slot in use; None where there is none yet.

        Raises:
            SlotError: the link leads elsewhere.
        """
        link = self._folder / CURRENT
        if not link.is_symlink():
            if link.exists():
                raise SlotError(f"{link}: is no link to a slot; remove it")
            return None
        name = str(link.readlink())
        if name not in SLOTS:
            raise SlotError(f"{link}: leads to {name!r}, not to a slot; remove it")
        return name

    def install(self, source: Path, trust: Trust | None, trial: Callable[[Path], None]) -> Whole:
        """Takes the bundle in `source` if it is whole, signed, not older than any before, and stands its `trial`.

        `trial` is called with the bundle's folder in its slot, and raises InputError where it fails.

        Raises:
            BundleError, SignatureError: it is not whole or not signed.
            SlotError: it is older than the floor, or cannot be written.
            InputError: it fails its trial. The current bundle is untouched in every case.
        """
        given = whole(source, trust)
        self._check_floor(given, source)
        slot = SLOTS[1] if self.current == SLOTS[0] else SLOTS[0]
        path = self._folder / slot
        try:
            self._put(given, path)
            trial(path)
            self._raise_floor(given)
            self._swap(slot)
        except OSError as error:
            raise SlotError(
                f"{error.filename or path}: cannot be written: {error.strerror}; is the disk full?"
            ) from error
        except InputError:
            shutil.rmtree(path, ignore_errors=True)
            raise
        return given

    def _check_floor(self, given: Whole, source: Path) -> None:
        floor = self._floor()
        if floor is None:
            return
        version = given.manifest.version
        if version < floor.version:
            raise SlotError(
                f"{source}: version {version} is older than {floor.version}, which was there before; "
                "give a newer one (export --version)"
            )
        if version == floor.version and given.id != floor.id:
            raise SlotError(
                f"{source}: is another bundle of version {version}, which was there before; count up (export --version)"
            )

    def _floor(self) -> _Floor | None:
        path = self._folder / FLOOR
        try:
            return msgspec.json.decode(path.read_bytes(), type=_Floor)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.MsgspecError) as error:
            raise SlotError(
                f"{path}: cannot be read ({error}); put it right by hand: it keeps old bundles out"
            ) from error

    def _raise_floor(self, given: Whole) -> None:
        _written(self._folder / FLOOR, msgspec.json.encode(_Floor(given.manifest.version, given.id)))

    def _put(self, given: Whole, path: Path) -> None:
        """The bundle's files and its signatures, whole on the disk."""
        new = path.with_name(f".{path.name}.new")
        for folder in (new, path):
            shutil.rmtree(folder, ignore_errors=True)
        new.mkdir(parents=True)
        for name, content in given.contents.items():
            _written(new / name, content)
        _synced(new)
        new.rename(path)
        _synced(self._folder)

    def _swap(self, slot: str) -> None:
        new = self._folder / f".{CURRENT}.new"
        new.unlink(missing_ok=True)
        new.symlink_to(slot)
        new.rename(self._folder / CURRENT)
        _synced(self._folder)


def _written(path: Path, content: bytes) -> None:
    """The file, on the disk, whole or not at all."""
    new = path.with_name(f".{path.name}.new")
    with new.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    new.rename(path)
    _synced(path.parent)


def _synced(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
