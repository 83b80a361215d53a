"""A training on the terminal: a bar with loss, free-run error and the time left; lines where nobody watches."""

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from faultline.training.loop import Report

LINE_S = 10.0
"""Between two lines of a training that writes into a file."""


class Progress:
    """`with Progress("uds") as progress: training.run(progress.tell, ...)`; everything goes to standard error."""

    def __init__(self, title: str) -> None:
        self._console = Console(stderr=True)
        numbers = TextColumn("loss {task.fields[loss]:.4g}, free run {task.fields[error]:.3g} of the spread")
        self._bar = Bar(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.0f} of {task.total:.0f}"),
            numbers, TimeRemainingColumn(), console=self._console,
        )  # fmt: skip
        self._task = self._bar.add_task(title, total=1, loss=float("nan"), error=float("nan"))
        self._line = time.monotonic()

    def __enter__(self) -> "Progress":
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def note(self, text: str) -> None:
        """What stays on the terminal."""
        self._console.print(text, highlight=False, soft_wrap=True)

    def tell(self, report: Report) -> None:
        """A look at the free run."""
        self._bar.update(self._task, completed=report.done, total=report.of, loss=report.loss, error=report.error)
        now = time.monotonic()
        if not self._console.is_terminal and (now - self._line > LINE_S or report.done == report.of):
            self._line = now
            self.note(
                f"{report.done} of {report.of}: loss {report.loss:.4g}, free run {report.error:.3g} of the spread"
            )
