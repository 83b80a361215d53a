"""Work is done side by side by processes of this machine, or by the workers of a Dask scheduler."""

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from faultline.service.core.errors import InputError

if TYPE_CHECKING:
    from distributed import Client

ANSWERS_S = 10.0
"""A scheduler, within so much time."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def cores(processes: int | None) -> int:
    """Return how many processes to start, one a core if None; each of them with one thread.

    Raises:
        InputError: there are none.
    """
    wanted = len(os.sched_getaffinity(0)) if processes is None else processes
    if wanted < 1:
        raise InputError(f"--processes {wanted}: nobody would work; give at least 1")
    for name in THREADS:  # matrices are small: two processes are faster than two threads
        os.environ.setdefault(name, "1")
    return wanted


@contextmanager
def scheduler_at(address: str) -> Iterator["Client"]:
    """A client of the Dask scheduler at an address.

    Raises:
        InputError: dask is not installed, or nobody answers there.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--scheduler needs dask: pip install 'faultline-diagnosis[scale]'") from error
    refused = None
    try:
        client = Client(address, timeout=ANSWERS_S)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        refused = str(error)
    if refused is not None:
        gc.collect()  # ends the client that failed; ended while another one starts, the two wait for each other
        raise InputError(f"{address}: no Dask scheduler answers ({refused}); check address and port")
    with client:
        yield client
