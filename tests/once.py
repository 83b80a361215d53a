"""Made things that several tests want: each is made once in a run of tests, not once in each of its processes."""

import fcntl
import hashlib
import os
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from tempfile import mkdtemp
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
FOLDER = "FAULTLINE_TESTS_MADE"
"""The environment variable that names the run's folder: the processes of pytest-xdist inherit it."""


def open_folder() -> Path | None:
    """Make the run's folder, unless the process that started this one has made it; return it where it is ours."""
    if FOLDER in os.environ:
        return None
    os.environ[FOLDER] = mkdtemp(prefix="faultline-tests-")
    return Path(os.environ[FOLDER])


def once(make: Callable[P, T]) -> Callable[P, T]:
    """Let a function of plain arguments return, in all processes of a run, what its first call with them returned.

    The first process to call it works, the others wait for it. What it returns is kept by cloudpickle, as models hold
    functions that sympy has compiled. An exception is not kept: each process that calls meets its own.
    """

    kept: dict[str, T] = {}

    @wraps(make)
    def made(*args: P.args, **kwargs: P.kwargs) -> T:
        asked = f"{make.__module__}.{make.__qualname__} {args!r} {sorted(kwargs.items())!r}"
        if asked not in kept:
            kept[asked] = _kept(Path(os.environ[FOLDER]), asked, lambda: make(*args, **kwargs))
        return kept[asked]

    return made


def _kept(folder: Path, asked: str, make: Callable[[], T]) -> T:
    import cloudpickle  # the vehicle's environment has none, and makes nothing of this kind

    file = folder / hashlib.sha256(asked.encode()).hexdigest()
    with file.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if file.exists():
            read: T = cloudpickle.loads(file.read_bytes())
            return read
        value = make()
        part = file.with_suffix(".part")
        part.write_bytes(cloudpickle.dumps(value))
        part.rename(file)
        return value
