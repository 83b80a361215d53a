"""The one family of errors that a user can cause and cure.

`InputError`
  +-- `service.bundle.BundleError`   a bundle that must not be run
  +-- `service.bus.BusError`         a bus that is not there or cannot be used
  +-- `service.logs.LogError`        a file that is not a log, or a recording that is not whole

`service.cli` prints the message in one line and exits with 2. Trouble with a residual is never an error: it is the
verdict *cannot tell*.
"""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(Exception):
    """What the user gave is wrong: the message names file, place and remedy in one line."""


@contextmanager
def writing(path: object) -> Iterator[None]:
    """Name the path in an error of writing to it or into it: a full disk is met in a write, which names no file."""
    try:
        yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
