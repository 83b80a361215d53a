"""Shared access to the daemon's control socket (docs/control.md), so that no number of callers can keep it busy.

The same question at the same time is asked once, and its answer is good for `FRESH_S` or until something was told.
Beyond that, questions that name something are spaced, as there are many of them, and few are open at once.
"""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from faultline.service.core.records.line import encode
from faultline.service.protocol.aio import answer
from faultline.service.protocol.client import decode
from faultline.service.protocol.errors import AwayError, RefusedError
from faultline.service.protocol.questions import Question

FRESH_S = 0.2
OPEN = 4  # questions open at once, of the daemon's few connections
RATE = 100.0  # questions a second, on average
BURST = 100  # and as many more at once
WAIT_S = 2.0  # who would have to wait longer is sent away

T = TypeVar("T")


class Pace:
    """Rate limit of questions: `rate` a second [1/s], and a burst of `burst`."""

    def __init__(self, rate: float = RATE, burst: int = BURST, clock: Callable[[], float] = time.monotonic) -> None:
        self._step, self._ahead, self._clock = 1.0 / rate, burst / rate, clock
        self._next = clock() - self._ahead

    def wait(self) -> float:
        """Return how long [s] the next question waits; raises RefusedError if that is too long."""
        now = self._clock()
        due = max(self._next, now - self._ahead)
        if due - now > WAIT_S:
            raise RefusedError("busy", "too many questions at once")
        self._next = due + self._step
        return max(0.0, due - now)


class SharedControl:
    """Asks questions. State: fresh answers, and those under way, by question.

    An answer may take `answer_s` [s], and `clear_s` where the daemon waits for the disk.
    """

    def __init__(
        self, path: Path, answer_s: float, clear_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.path, self._answer_s, self._clear_s, self._clock = path, answer_s, clear_s, clock
        self._pace = Pace(clock=clock)
        self._open = asyncio.Semaphore(OPEN)
        self._recent: dict[bytes, tuple[float, asyncio.Task[bytes]]] = {}

    async def ask(self, question: Question, kind: type[T]) -> T:
        """Return the answer, shared with others who ask the same at this time.

        Raises:
            AwayError, RefusedError, GarbledError: there is none.
        """
        spaced = question != Question(ask=question.ask)
        return decode(await self._shared(encode(question), spaced=spaced), kind)

    async def ask_alone(self, question: Question, kind: type[T]) -> T:
        """Return the answer to a long question that is hardly asked twice: it is not shared."""
        return decode(await self._answer(encode(question), self._answer_s), kind)

    async def clear(self, question: Question, kind: type[T]) -> T:
        """Ask what changes something: always sent, and no earlier answer is fresh after it."""
        try:
            return decode(await self._answer(encode(question), self._clear_s), kind)
        finally:
            self.forget()

    def forget(self) -> None:
        """Discard all answers, also those under way: something has changed."""
        self._recent.clear()

    async def _shared(self, line: bytes, *, spaced: bool) -> bytes:
        now = self._clock()
        for key in [key for key, (at, task) in self._recent.items() if task.done() and now - at >= FRESH_S]:
            del self._recent[key]
        if line not in self._recent:
            task = asyncio.create_task(self._answer(line, self._answer_s, spaced=spaced))
            task.add_done_callback(_looked_at)
            self._recent[line] = now, task
        return await asyncio.shield(self._recent[line][1])

    async def _answer(self, line: bytes, within_s: float, *, spaced: bool = True) -> bytes:
        if spaced:
            await asyncio.sleep(self._pace.wait())
        try:
            async with asyncio.timeout(within_s), self._open:
                return await answer(self.path, line)
        except TimeoutError as error:
            raise AwayError(f"no answer within {within_s:g} s", self.path) from error


def _looked_at(task: asyncio.Task[bytes]) -> None:
    """Retrieve the error of an answer that nobody waits for, which asyncio would report otherwise."""
    if not task.cancelled():
        task.exception()
