"""A listening Unix socket at a path, in the place of one that a dead process left there."""

import os
import socket
import stat
from pathlib import Path

from faultline.service.core.errors import InputError

MODE = 0o660  # the process's user and group


def listen(path: Path, option: str, backlog: int = 128) -> socket.socket:
    """Return a socket that listens at `path` and does not block; errors name the `option` that gives another path.

    Raises:
        InputError: the path cannot be used, or another process listens there.
    """
    _clear(path, option)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    mask = os.umask(~MODE & 0o777)
    try:
        listener.bind(str(path))
        listener.listen(backlog)
    except OSError as error:
        listener.close()
        raise InputError(f"{path}: cannot listen there: {error.strerror or error}; give another {option}") from error
    finally:
        os.umask(mask)
    listener.setblocking(False)
    return listener


def _clear(path: Path, option: str) -> None:
    """Remove the socket of a dead process; raise InputError if anything else is there."""
    try:
        if not stat.S_ISSOCK(path.stat().st_mode):
            raise InputError(f"{path}: is there already and is no socket; give another {option}")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.connect(str(path))
    except FileNotFoundError:
        return
    except ConnectionRefusedError:
        path.unlink()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give another {option}") from error
    else:
        raise InputError(f"{path}: another process listens there; stop it or give another {option}")
