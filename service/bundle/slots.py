"""Two slots for a bundle, of which one is current: a new one is put into the other, tried there, and then swapped in.

    DIR/a  DIR/b        the slots, each a bundle's folder or absent
    DIR/current         a link to one of them; replaced in one step, so that it always leads to a whole bundle
    DIR/floor.json      the name of the bundle and the highest version that was ever current: nothing older is taken,
                        and nothing of another name, whoever has signed it
    DIR/lock            held while one is installed: one at a time

Whatever happens in between, a power cut too, the current bundle stays as it is until the new one is whole on the disk.
Everybody may read what is written, whatever the umask: the service runs as a user of its own.
"""

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.bundle.files import Trust, Whole, whole
from faultline.service.core.errors import InputError
from faultline.writing import sync, write_file, write_folder

SLOTS = ("a", "b")
CURRENT, FLOOR, LOCK = "current", "floor.json", "lock"
READABLE = 0o644


class SlotError(InputError):
    """Bundle that is refused, or folder that has no slots."""


class _Floor(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    version: Annotated[int, Meta(ge=0)]
    id: str


class Slots:
    """The slots of one bundle in a folder, which need not be there yet."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def current(self) -> str | None:
        """Return the slot in use, None if there is none yet; raises SlotError if the link leads elsewhere."""
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
        """Install the bundle in `source` if it is complete, signed, not older than any before, and passes its `trial`.

        `trial` is called with the bundle's folder in its slot, and raises InputError where it fails.

        Raises:
            BundleError, SignatureError: it is not whole or not signed.
            SlotError: it is older than the floor or of another name, or another one is being installed.
            OSError: it cannot be written.
            InputError: it fails its trial. The current bundle is untouched in every case.
        """
        given = whole(source, trust)
        with self._alone():
            self._check_floor(given, source)
            self._install(given, trial)
        return given

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Hold the lock against other installations."""
        path = self._folder / LOCK
        try:
            _made(self._folder)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise SlotError(f"{path}: cannot be written: {error.strerror}; be root, or give another --into") from error
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise SlotError(f"{self._folder}: another bundle is being installed; wait for that") from error
            yield
        finally:
            os.close(descriptor)

    def _install(self, given: Whole, trial: Callable[[Path], None]) -> None:
        slot = SLOTS[1] if self.current == SLOTS[0] else SLOTS[0]
        path = self._folder / slot
        try:
            self._put(given, path)
            trial(path)
            self._raise_floor(given)
            self._swap(slot)
        except InputError:
            shutil.rmtree(path, ignore_errors=True)
            raise

    def _check_floor(self, given: Whole, source: Path) -> None:
        floor = self._floor()
        if floor is None:
            return
        name, version = given.manifest.name, given.manifest.version
        if name != floor.name:
            raise SlotError(f"{source}: is {name!r}, and {floor.name!r} is what is installed here; give another --into")
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
            return self._current_floor()
        except (OSError, msgspec.MsgspecError) as error:
            raise SlotError(
                f"{path}: cannot be read ({error}); put it right by hand: it keeps old bundles out"
            ) from error

    def _current_floor(self) -> _Floor | None:
        """Return the floor of the current bundle, where the file is lost."""
        current = self.current
        if current is None:
            return None
        here = whole(self._folder / current)
        return _Floor(here.manifest.name, here.manifest.version, here.id)

    def _raise_floor(self, given: Whole) -> None:
        floor = _Floor(given.manifest.name, given.manifest.version, given.id)
        write_file(self._folder / FLOOR, msgspec.json.encode(floor), READABLE)

    def _put(self, given: Whole, path: Path) -> None:
        """Write the bundle's files and its signatures."""
        shutil.rmtree(path, ignore_errors=True)  # the disk may have no room for three
        write_folder(path, given.contents, mode=READABLE)

    def _swap(self, slot: str) -> None:
        new = self._folder / f".{CURRENT}.new"
        new.unlink(missing_ok=True)
        new.symlink_to(slot)
        new.rename(self._folder / CURRENT)
        sync(self._folder)


def spare(link: Path) -> Path | None:
    """Return the slot beside the one that `DIR/current` leads to, if a bundle is in it that was current before.

    One of a later version than the floor was put there and never stood its trial.

    Raises:
        InputError: what is in it is not whole, or the floor cannot be read.
    """
    folder = link.parent
    if link.name != CURRENT or not link.is_symlink() or (current := Slots(folder).current) is None:
        return None
    path = folder / (SLOTS[1] if current == SLOTS[0] else SLOTS[0])
    if not path.is_dir():
        return None
    found = whole(path).manifest
    try:
        floor = msgspec.json.decode((folder / FLOOR).read_bytes(), type=_Floor)
    except (OSError, msgspec.MsgspecError) as error:
        raise SlotError(f"{folder / FLOOR}: cannot be read ({error}); what may stand in is not known") from error
    return path if (found.name, found.version <= floor.version) == (floor.name, True) else None


def _made(folder: Path) -> None:
    """The folder and those above it, which everybody may look into where they are made here."""
    for each in (*reversed(folder.parents), folder):
        if not each.exists():
            each.mkdir()
            each.chmod(0o755)
