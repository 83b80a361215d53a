"""Work on a Dask cluster: processes of this machine by default, those of a scheduler at its address.

A worker that dies takes nothing with it that was done, as each piece of work is on the disk when it ends; another one
does again what it was at.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from distributed import Client, KilledWorker, LocalCluster, as_completed
from tornado.ioloop import PeriodicCallback

from faultline.analysis.processes import cores, scheduler_at

Piece = TypeVar("Piece")
Result = TypeVar("Result")

LOOK_S = 20.0
"""Period at which processes are started in place of those that are gone for good [s]."""


@contextmanager
def cluster(scheduler: str | None, processes: int | None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of so many processes of this machine: one a core, if None.

    Raises:
        InputError: there are no processes, or no scheduler answers.
    """
    if scheduler is not None:
        with scheduler_at(scheduler) as client:
            yield client
        return
    size = {"n_workers": cores(processes), "threads_per_worker": 1}
    where = {"dashboard_address": "127.0.0.1:0", "host": "127.0.0.1"}
    with LocalCluster(**size, **where, memory_limit=0, silence_logs=logging.ERROR) as local, Client(local) as client:  # type: ignore[no-untyped-call]
        # Dask starts no worker again that dies while it starts, and gives one up that starts slowly after another
        keeping = PeriodicCallback(partial(local.scale, size["n_workers"]), 1000.0 * LOOK_S)
        local.loop.add_callback(keeping.start)
        try:
            yield client
        finally:
            local.loop.add_callback(keeping.stop)


def worked(
    client: Client, work: Callable[..., Sequence[Result]], pieces: Sequence[Sequence[Piece]], *given: Any
) -> Iterator[tuple[Sequence[Piece], Sequence[Result] | None]]:
    """Yield each piece with what `work(piece, *given)` returns, as they come; None where workers died of it.

    A piece of several parts at which workers die is divided into its parts, so that only one of them is lost. Dask
    blames a worker's death on what waited there too: whatever is blamed is tried again at the end, one by one.
    """
    waiting = {client.submit(work, piece, *given, pure=False): piece for piece in pieces}
    blamed: list[Sequence[Piece]] = []
    coming = as_completed(list(waiting))  # type: ignore[no-untyped-call]
    for future in coming:
        piece = waiting.pop(future)
        try:
            yield piece, future.result()
        except KilledWorker:
            if len(piece) == 1:
                blamed.append(piece)
                continue
            for part in piece:
                again = client.submit(work, [part], *given, pure=False)
                waiting[again] = [part]
                coming.add(again)  # type: ignore[no-untyped-call]
    for piece in blamed:
        try:
            yield piece, client.submit(work, piece, *given, pure=False).result()
        except KilledWorker:
            yield piece, None


def pieces_of(parts: Sequence[Piece], sizes: Sequence[int], size: int) -> list[list[Piece]]:
    """Join neighbours until a piece has this size: a piece of work is to take a second or more.

    >>> pieces_of("abcde", [1, 1, 5, 1, 1], 3)
    [['a', 'b', 'c'], ['d', 'e']]
    """
    found: list[list[Piece]] = []
    room = 0
    for part, own in zip(parts, sizes, strict=True):
        if room <= 0:
            found.append([])
            room = size
        found[-1].append(part)
        room -= own
    return found
