"""Small things to wait for: a change, the end."""

import asyncio


class News:
    """Wakes all who wait for a change. Who looks and then waits, without an await between, misses none."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    def tell(self) -> None:
        """Something has changed."""
        event, self._event = self._event, asyncio.Event()
        event.set()

    async def wait(self, within_s: float) -> bool:
        """Whether something changes within that time [s]."""
        try:
            async with asyncio.timeout(within_s):
                return await self._event.wait()
        except TimeoutError:
            return False


class Ending:
    """That this server ends: `failure` is why, where nobody has asked for it."""

    def __init__(self) -> None:
        self._event = asyncio.Event()
        self.failure: BaseException | None = None

    @property
    def begun(self) -> bool:
        """Whether it does."""
        return self._event.is_set()

    def begin(self, failure: BaseException | None = None) -> None:
        """It does from now on."""
        self.failure = self.failure or failure
        self._event.set()

    def watch(self, task: asyncio.Task[None]) -> None:
        """It does if that fails: who serves on without it would be taken for well."""

        def look(done: asyncio.Task[None]) -> None:
            if not done.cancelled() and (error := done.exception()) is not None:
                self.begin(error)

        task.add_done_callback(look)

    async def wait(self) -> None:
        """Until it does."""
        await self._event.wait()
