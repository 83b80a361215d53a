"""Where results go: looked at before the work that they take, not after it."""

import os
from pathlib import Path

from faultline.service.core.errors import InputError


def check_folder(folder: Path, option: str) -> None:
    """Whether files can be written into `folder`, which may not be there yet; nothing is made.

    Raises:
        InputError: they cannot; `option` says where another place is given.
    """
    place = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not place.is_dir():
        raise InputError(f"{place}: is no folder; give {option} another place")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(f"{place}: may not be written; give {option} another place")


def check_file(path: Path, option: str) -> None:
    """The same of a file.

    Raises:
        InputError: it cannot be written.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give {option} the name of a file")
    check_folder(path.parent, option)
