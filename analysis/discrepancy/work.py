"""Attempts on all cores or on a Dask cluster, each kept on disk as soon as it is there.

What was interrupted goes on where it stopped: an attempt is kept under what it depends on, so the same call finds it,
and another recording, model or library entry does not.
"""

import hashlib
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from analysis.discrepancy.attempt import Attempt, Baseline, Judge, Study
from analysis.discrepancy.kept import keep, kept
from service.core.errors import InputError

_judges: dict[str, Judge] = {}
"""In a worker: the judge that it made last, by the key of what it was made from."""

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Order:
    """An attempt that is wanted: with `effects`, searched from `near` and from the `starts` that `Judge` knows."""

    effects: tuple[str, ...]
    near: Attempt | None = None
    starts: tuple[str, ...] = ("near", "prior")


class Crew:
    """Makes attempts of one study side by side."""

    def __init__(self, executor: Executor, study: Study, baseline: Baseline, folder: Path | None) -> None:
        self._executor, self._study, self._folder = executor, study, folder
        self._payload = pickle.dumps((study, baseline))

    def attempts(self, orders: Sequence[Order], say: Callable[[int, int], None]) -> list[Attempt]:
        """What came out, but for models that cannot be run; `say` hears how many of how many are there.

        Raises:
            InputError: a result cannot be kept.
        """
        found: list[Attempt | None] = [self._kept(order) for order in orders]
        waiting = {
            self._executor.submit(_attempt, self._study.key, self._payload, order): k
            for k, order in enumerate(orders)
            if found[k] is None
        }
        say(len(orders) - len(waiting), len(orders))
        for number, future in enumerate(as_completed(waiting), len(orders) - len(waiting) + 1):
            k = waiting[future]
            attempt = future.result()
            if attempt is not None:
                found[k] = attempt
                self._keep(orders[k], attempt)
            say(number, len(orders))
        return [attempt for attempt in found if attempt is not None]

    def _place(self, order: Order) -> Path | None:
        if self._folder is None:
            return None
        entries = [repr(self._study.library[name]) for name in order.effects]
        near = [] if order.near is None else [repr(order.near.effects), repr(order.near.x.tolist())]
        text = "\n".join([self._study.key, *order.effects, *entries, *near, *order.starts])
        return self._folder / f"{'+'.join(order.effects) or 'none'}-{hashlib.sha256(text.encode()).hexdigest()[:16]}.json"

    def _kept(self, order: Order) -> Attempt | None:
        place = self._place(order)
        return None if place is None else kept(place)

    def _keep(self, order: Order, attempt: Attempt) -> None:
        place = self._place(order)
        if place is not None:
            keep(place, attempt)


def _attempt(key: str, payload: bytes, order: Order) -> Attempt | None:
    """In a worker; None if the model cannot be run from any start."""
    if key not in _judges:
        _judges.clear()
        _judges[key] = Judge(*pickle.loads(payload))  # noqa: S301  (our own bytes, from the process that asks)
    try:
        return _judges[key].attempt(order.effects, order.near, order.starts)
    except InputError:
        return None


@contextmanager
def workers(scheduler: str | None, processes: int | None = None) -> Iterator[Executor]:
    """An executor on this machine's cores (or so many processes), or on the Dask scheduler at an address.

    Raises:
        InputError: dask is not installed, or nobody answers there.
    """
    if scheduler is None:
        cores = len(os.sched_getaffinity(0)) if processes is None else processes
        for name in THREADS:  # matrices are small: two processes are faster than two threads
            os.environ.setdefault(name, "1")
        with ProcessPoolExecutor(cores) as executor:
            yield executor
        return
    try:
        from distributed import Client  # noqa: PLC0415  (a cluster is the exception)
    except ImportError as error:
        raise InputError("--scheduler needs dask: pip install 'faultline[scale]'") from error
    try:
        with Client(scheduler, timeout="10s") as client:
            yield client.get_executor(pure=False)
    except OSError as error:
        raise InputError(f"{scheduler}: no Dask scheduler answers ({error}); check address and port") from error
