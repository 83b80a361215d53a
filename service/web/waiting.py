"""Synchronisation of tasks: a change that several wait for, and the shutdown of the server."""

import asyncio


class ChangeNotifier:
    """Wakes all who wait for a change. Who looks and then waits, without an await between, misses none."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    def notify(self) -> None:
        """Wake all who wait."""
        event, self._event = self._event, asyncio.Event()
        event.set()

    async def wait(self, within_s: float) -> bool:
        """Return True once something changes, False after `within_s` [s] without a change."""
        try:
            async with asyncio.timeout(within_s):
                return await self._event.wait()
        except TimeoutError:
            return False


class Shutdown:
    """The end of this server, which a signal or a failed task requests; `failure` is the error of that task."""

    def __init__(self) -> None:
        self._event = asyncio.Event()
        self.failure: BaseException | None = None

    @property
    def requested(self) -> bool:
        """True if the server is to end."""
        return self._event.is_set()

    def request(self, failure: BaseException | None = None) -> None:
        """End the server, because of `failure` if one is given."""
        self.failure = self.failure or failure
        self._event.set()

    def watch(self, task: asyncio.Task[None]) -> None:
        """Request the end if the task fails: a server that goes on without it would be taken for well."""

        def look(done: asyncio.Task[None]) -> None:
            if not done.cancelled() and (error := done.exception()) is not None:
                self.request(error)

        task.add_done_callback(look)

    async def wait(self) -> None:
        """Wait until the end is requested."""
        await self._event.wait()
