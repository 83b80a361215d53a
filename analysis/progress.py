"""Progress on the terminal for whatever takes longer than a moment; a plain line a step where nobody watches."""

from types import TracebackType

from rich.console import Console


class Progress:
    """`with Progress("calibrating") as progress: progress.say("cost 12.3")`; everything goes to standard error."""

    def __init__(self, title: str) -> None:
        self._console = Console(stderr=True)
        self._title = title
        self._status = self._console.status(title)

    def __enter__(self) -> "Progress":
        self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._status.stop()

    def note(self, text: str) -> None:
        """What the user must not miss: stays on the terminal."""
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)

    def say(self, text: str) -> None:
        """What is going on now."""
        self._status.update(f"{self._title}: {text}")
