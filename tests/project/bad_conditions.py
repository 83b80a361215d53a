"""A command, or a function, in a process of its own, under a condition that is made in that process.

The processes are forked from one that has imported all commands once: importing them anew takes seconds for each.
"""

import codecs
import os
import resource
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from threading import Timer
from types import FrameType
from typing import NamedTuple

from faultline import writing
from faultline.service.cli import GROUP, dispatch

COMMANDS = {entry.name: entry for entry in entry_points(group=GROUP)}
NOBODY = 65534
PATIENCE_S = 120.0

Condition = Callable[[], None]

_context = get_context("forkserver")
_context.set_forkserver_preload(
    [*sorted({entry.module for entry in COMMANDS.values()}), "matplotlib.font_manager", "onnxruntime", __name__]
)


class Done(NamedTuple):
    """The exit code, minus the number of a signal; and standard error."""

    code: int | None
    said: str


def run(words: list[str], condition: Condition) -> Done:
    """`faultline WORDS` under the condition, its standard output dropped unless that is the condition."""
    mine, theirs = _context.Pipe(duplex=False)
    process = started(_run, words, condition, theirs)
    theirs.close()
    late = Timer(PATIENCE_S, process.kill)
    late.start()
    with open(os.dup(mine.fileno()), "rb") as errors:  # noqa: PTH123 a descriptor
        said = errors.read()
    process.join()
    late.cancel()
    return Done(process.exitcode, said.decode())


def started(function: Callable[..., None], *arguments: object) -> ForkServerProcess:
    """A process that calls the function."""
    process = _context.Process(target=function, args=arguments)
    process.start()
    return process


def _run(words: list[str], condition: Condition, errors: Connection) -> None:
    os.setpgid(0, 0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    os.dup2(errors.fileno(), sys.stderr.fileno())
    errors.close()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    condition()
    sys.exit(dispatch(words, COMMANDS))


def full_output() -> None:
    """Standard output is on a full disk."""
    os.dup2(os.open("/dev/full", os.O_WRONLY), sys.stdout.fileno())


def closed_pipe() -> None:
    """Standard output is a pipe that nobody reads any more, as `| head -1` leaves it."""
    ours, theirs = os.pipe()
    os.close(ours)
    os.dup2(theirs, sys.stdout.fileno())


def full_disk() -> None:
    """No file takes a byte: write(2) fails and names no file, as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))


def no_permission() -> None:
    """The process is nobody's: root may do everything."""
    if os.geteuid() == 0:
        for encoding in ("cp1252", "idna"):  # loaded when they are used, from where nobody may not read, it may be
            codecs.lookup(encoding)
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)


@dataclass(frozen=True)
class Interrupted:
    """Ctrl-C after so many seconds, and each two seconds more, while a pager takes nothing more from the pipe.

    `once_handled`: not before the command handles it, which it does not while it starts.
    """

    after_s: float
    once_handled: bool = False

    def __call__(self) -> None:
        """Begin."""
        _, pipe = os.pipe()
        os.set_blocking(pipe, False)
        try:
            while True:
                os.write(pipe, bytes(4096))
        except BlockingIOError:
            os.set_blocking(pipe, True)
        os.dup2(pipe, sys.stdout.fileno())
        signal.signal(signal.SIGALRM, self._interrupt)
        signal.setitimer(signal.ITIMER_REAL, self.after_s, 0.1)

    def _interrupt(self, _number: int, _frame: FrameType | None) -> None:
        if not self.once_handled or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            signal.setitimer(signal.ITIMER_REAL, 2.0, 2.0)
            os.kill(0, signal.SIGINT)  # as a terminal: to the command and to what it started


@dataclass(frozen=True)
class Killed:
    """`kill -9` once content is written and before it is on the disk, for the time that `number` says."""

    number: int

    def __call__(self) -> None:
        """Begin."""
        left = iter(range(self.number))

        def sync(_descriptor: int) -> None:
            if next(left, None) is None:
                os.kill(os.getpid(), signal.SIGKILL)

        writing.os.fsync = sync  # type: ignore[attr-defined]


def nothing() -> None:
    """All is well."""
