"""Terminal that is drawn upon in place, and is left as it was found."""

import os
import select
import shutil
import signal
import sys
import termios
import tty
from collections.abc import Sequence
from types import FrameType
from typing import Any

ENTER = b"\x1b[?1049h\x1b[?25l\x1b[?7l\x1b[2J"  # another screen, no cursor, no wrapping
LEAVE = b"\x1b[?7h\x1b[?25h\x1b[?1049l"
TERMINATED = 128 + signal.SIGTERM


class Terminal:
    """Standard output as a screen, standard input as keys where both are there.

    SIGTERM ends the process with `TERMINATED` and SIGTSTP stops it, both after the terminal is as it was.
    """

    def __init__(self) -> None:
        self._out = sys.stdout.fileno()
        self._keys: int | None = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else None
        self._modes: list[Any] | None = None
        self._handlers: dict[signal.Signals, Any] = {}

    def __enter__(self) -> "Terminal":
        for number, handler in ((signal.SIGTERM, _end), (signal.SIGTSTP, self._pause)):
            self._handlers[number] = signal.signal(number, handler)
        self._take()
        return self

    def __exit__(self, *_: object) -> None:
        self._give_back()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def size(self) -> tuple[int, int]:
        """Return columns and rows, as they are now."""
        try:
            return os.get_terminal_size(self._out)
        except OSError:  # no terminal: as the environment says
            return shutil.get_terminal_size()

    def draw(self, lines: Sequence[str]) -> None:
        """Replace the content."""
        content = "\r\n".join(f"\x1b[K{each}" for each in lines)
        if len(lines) < self.size()[1]:
            content += "\r\n\x1b[J"
        self._write(b"\x1b[?2026h\x1b[H" + content.encode(sys.stdout.encoding, "replace") + b"\x1b[?2026l")

    def keys(self, wake: int, longest_s: float) -> str:
        """Return what is typed, "" if nothing is until `wake` becomes readable or `longest_s` [s] are over."""
        watched = [wake] if self._keys is None else [wake, self._keys]
        ready, _, _ = select.select(watched, [], [], longest_s)
        if self._keys is None or self._keys not in ready:
            return ""
        typed = os.read(self._keys, 100)
        if not typed:  # the terminal is gone
            self._keys = None
        return typed.decode("ascii", "replace")

    def _take(self) -> None:
        if self._keys is not None:
            self._modes = termios.tcgetattr(self._keys)
            tty.setcbreak(self._keys)
        self._write(ENTER)

    def _give_back(self) -> None:
        try:
            self._write(LEAVE)
        finally:
            if self._keys is not None and self._modes is not None:
                termios.tcsetattr(self._keys, termios.TCSADRAIN, self._modes)

    def _pause(self, _number: int, _frame: FrameType | None) -> None:
        self._give_back()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._take()  # goes on

    def _write(self, content: bytes) -> None:
        while content:
            content = content[os.write(self._out, content) :]


def _end(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(TERMINATED)
