"""Attempts on all cores or on a Dask cluster, each kept on disk as soon as it is there.

What was interrupted goes on where it stopped: an attempt is kept under what it depends on, so the same call finds it,
and another recording, model, library entry or version of this program does not.
"""

import hashlib
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from faultline.analysis.discrepancy.name.attempt import Attempt, Baseline, Begin, Glance, Judge, Scan, Study
from faultline.analysis.discrepancy.name.kept import keep, kept
from faultline.analysis.discrepancy.name.sensitivity import Direction
from faultline.analysis.processes import cores, scheduler_at
from faultline.service.core.errors import InputError

Result = Attempt | Glance | Scan

Made = TypeVar("Made")

_judges: dict[str, Judge] = {}
"""In a worker: the judge that it made last, by the key of what it was made from."""


@dataclass(frozen=True)
class Order:
    """An attempt that is wanted, or a glance of so many `steps`: with `effects`, searched from `begin`.

    With `globally` it is a scan: a global search over the last effect's own parameters, and so many steps from its
    best.
    """

    effects: tuple[str, ...]
    begin: Begin
    steps: int | None = None
    globally: bool = False

    @property
    def result(self) -> type[Attempt] | type[Glance] | type[Scan]:
        """What comes out."""
        return Attempt if self.steps is None else Scan if self.globally else Glance


class Crew:
    """Makes attempts and glances of one study side by side."""

    def __init__(self, executor: Executor, study: Study, baseline: Baseline, folder: Path | None) -> None:
        self._executor, self._study, self._folder = executor, study, folder
        self._weights = repr((baseline.x.tolist(), baseline.levels.tolist()))  # evidences hold for one baseline only
        self._payload = pickle.dumps((study, baseline))
        self._key = hashlib.sha256(self._payload).hexdigest()  # a study's own says nothing of its library
        self._code = _code()
        self.failures: dict[tuple[str, ...], str] = {}
        """Why models with these effects could not be run, from one beginning at least."""

    def attempts(self, orders: Sequence[Order], say: Callable[[int, int], None]) -> list[Attempt]:
        """What came out, but for models that cannot be run; `say` hears how many of how many are there.

        Raises:
            InputError: a result cannot be kept.
        """
        return [found for found in self._all(orders, say) if isinstance(found, Attempt)]

    def glances(self, orders: Sequence[Order], say: Callable[[int, int], None]) -> list[Glance]:
        """The same of orders that have `steps`."""
        return [found for found in self._all(orders, say) if isinstance(found, Glance)]

    def scans(self, orders: Sequence[Order], say: Callable[[int, int], None]) -> list[Scan]:
        """The same of orders that search `globally`."""
        return [found for found in self._all(orders, say) if isinstance(found, Scan)]

    def directions(self, effects: Sequence[str], places: Mapping[str, Begin]) -> list[Direction]:
        """What each effect would do to the data, at its place if it has one, but for those that cannot be run.

        Raises:
            InputError: a worker died.
        """
        waiting = {e: self._executor.submit(_direction, self._key, self._payload, e, places.get(e)) for e in effects}
        found = []
        for effect, future in waiting.items():
            result = _of(future)
            if isinstance(result, str):
                self.failures[(effect,)] = result
            else:
                found.append(result)
        return found

    def _all(self, orders: Sequence[Order], say: Callable[[int, int], None]) -> list[Result | None]:
        found = [self._kept(order) for order in orders]
        waiting = {
            self._executor.submit(_worked, self._key, self._payload, order): k
            for k, order in enumerate(orders)
            if found[k] is None
        }
        say(len(orders) - len(waiting), len(orders))
        for number, future in enumerate(as_completed(waiting), len(orders) - len(waiting) + 1):
            k = waiting[future]
            result = _of(future)
            if isinstance(result, str):
                self.failures[orders[k].effects] = result
            else:
                found[k] = result
                place = self._place(orders[k])
                if place is not None:
                    keep(place, result)
            say(number, len(orders))
        return found

    def _kept(self, order: Order) -> Result | None:
        place = self._place(order)
        if place is None:
            return None
        return kept(place, order.result)

    def _place(self, order: Order) -> Path | None:
        if self._folder is None:
            return None
        entries = [repr(self._study.library[name]) for name in order.effects]
        begin = order.begin
        place = begin.x.tolist(), sorted(begin.places.items())
        given = [self._study.key, self._weights, repr(begin.unknowns.parameters), repr(place)]
        text = "\n".join([self._code, *given, *entries])
        digest = hashlib.sha256(f"{text}\n{begin.typical}\n{order.steps}\n{order.globally}".encode()).hexdigest()[:16]
        return self._folder / f"{'+'.join(order.effects) or 'none'}-{digest}.json"


def _worked(key: str, payload: bytes, order: Order) -> Result | str:
    """In a worker; the reason if the model cannot be run from there."""
    judge = _judge(key, payload)
    try:
        if order.steps is None:
            return judge.attempt(order.effects, order.begin)
        return (judge.scan if order.globally else judge.glance)(order.effects, order.begin, order.steps)
    except InputError as error:
        return str(error)


def _direction(key: str, payload: bytes, effect: str, place: Begin | None) -> Direction | str:
    judge = _judge(key, payload)
    try:
        return judge.direction(effect, place)
    except InputError as error:
        return str(error)


def _of(future: Future[Made]) -> Made:
    """What a worker has made."""
    try:
        return future.result()
    except BrokenExecutor as error:
        raise InputError("a worker died, of too little memory perhaps; call again, what is done is kept") from error


@cache
def _code() -> str:
    """A hash of the code: what another version has kept is not what this one would come to."""
    root = Path(__file__).parents[3]
    files = sorted([*(root / "analysis").rglob("*.py"), *(root / "service").rglob("*.py")])
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def _judge(key: str, payload: bytes) -> Judge:
    if key not in _judges:
        _judges.clear()
        _judges[key] = Judge(*pickle.loads(payload))  # noqa: S301  (our own bytes, from the process that asks)
    return _judges[key]


@contextmanager
def workers(scheduler: str | None, processes: int | None = None) -> Iterator[Executor]:
    """An executor on this machine's cores (or so many processes), or on the Dask scheduler at an address.

    Raises:
        InputError: there are no processes; dask is not installed, or nobody answers there.
    """
    if scheduler is None:
        afresh = get_context("spawn")  # numpy has taken its threads when it was imported: a fork would keep them
        with ProcessPoolExecutor(cores(processes), mp_context=afresh) as executor:
            yield executor
        return
    with scheduler_at(scheduler) as client:
        from distributed import KilledWorker

        try:
            yield client.get_executor(pure=False)  # type: ignore[no-untyped-call]
        except KilledWorker as error:
            raise InputError(f"{scheduler}: a worker died ({error}); call again, what is done is kept") from error
