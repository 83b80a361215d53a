"""Native code compiled in a process of its own: what compiling takes of memory ends with it.

A worker only loads what was compiled. Where several need it at once, one has it compiled and the others wait. The
process diagnoses the beginning of a log, as Numba compiles a function where it is called first.
"""

import fcntl
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from faultline.analysis.compiled.decision import NATIVE
from faultline.analysis.compiled.evaluator import CompiledEvaluator, kernels_of_bundle
from faultline.analysis.compiled.kernels import Kernels, ToCompileError, folder_of_cache
from faultline.service.bundle.load import Bundle, load_bundle
from faultline.service.core.monitor import Monitor
from faultline.service.logs import open_log

ENOUGH_S = 600.0
"""Time of the log [s] within which nearly all functions are called; a worker compiles those of a later fault."""

_log = logging.getLogger(__name__)


def kernels_apart(bundle: Bundle, folder: Path, log: Path) -> Kernels:
    """Return the functions of the graphs of the bundle in a folder; another process compiles them if they never were.

    `log` is one that fits the bundle.

    Raises:
        NotCompiledError: the bundle has networks, or a graph with an operation that is not made into native code.
        OSError: the user's cache cannot be written.
    """
    try:
        with _locked(fcntl.LOCK_SH):
            return kernels_of_bundle(bundle, compiling=False)
    except ToCompileError:
        with _locked(fcntl.LOCK_EX):
            return _kernels_alone(bundle, folder, log)


def _kernels_alone(bundle: Bundle, folder: Path, log: Path) -> Kernels:
    """Return the functions while no other process loads or compiles any: it may have, in the meantime."""
    try:
        return kernels_of_bundle(bundle, compiling=False)
    except ToCompileError:
        command = [sys.executable, "-m", "faultline.analysis.compiled.apart", str(folder), str(log)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  our own module
    if done.returncode:  # this process compiles what is missing then
        _log.warning("compiling apart exited with %d: %s", done.returncode, done.stderr[-1000:])
    return kernels_of_bundle(bundle)


@contextmanager
def _locked(how: int) -> Iterator[None]:
    """Hold a lock on the cache of this user: for those that load a shared one, for who compiles the only one."""
    folder = folder_of_cache()
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, how)
        yield
    finally:
        os.close(descriptor)


def _compile(folder: Path, path: Path) -> None:
    """Diagnose the beginning of a log by native code of the bundle in a folder."""
    log = open_log(path, None)
    bundle = load_bundle(folder, senders=log.senders, signals=log.signals_of_dbc)
    evaluator = CompiledEvaluator(bundle.manifest, kernels_of_bundle(bundle))
    monitor = Monitor(bundle.manifest, evaluator, bundle.table, log.id, bundle.id, parts=NATIVE)
    for piece in log.signals(bundle.table).pieces():
        for _ in monitor.piece(piece):
            pass
        if piece.last_s > ENOUGH_S:
            break


if __name__ == "__main__":
    _compile(Path(sys.argv[1]), Path(sys.argv[2]))
