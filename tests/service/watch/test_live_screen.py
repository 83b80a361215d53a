"""`faultline watch` on a terminal: draws, says when the service is away, comes back, and leaves the terminal clean."""

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from watched_service import FAULTY, WatchedService

import faultline

ROOT = Path(str(faultline.__file__)).parents[1]
RUN = """import faulthandler, signal, sys
faulthandler.register(signal.SIGUSR1)  # what is it doing?
from faultline.service.watch import main
sys.exit(main(sys.argv[1:]))"""
ENTER, LEAVE = b"\x1b[?1049h", b"\x1b[?7h\x1b[?25h\x1b[?1049l"
BEGIN, END = b"\x1b[?2026h\x1b[H", b"\x1b[?2026l"
PATIENCE_S = 30.0
CLEARED = {"schema": "faultline.cleared/1", "id": "truck-1", "seq": 1, "wall": None, "numbers": [3], "by": "root"}


class Watch:
    """The command on a terminal of its own."""

    def __init__(self, *arguments: str, columns: int = 100, rows: int = 30, **environment: str) -> None:
        self.master, self._slave = pty.openpty()
        self.resize(columns, rows)
        self.before = termios.tcgetattr(self._slave)
        self.output = b""
        inherited = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
        self.process = subprocess.Popen(
            [sys.executable, "-c", RUN, *arguments],
            stdin=self._slave,
            stdout=self._slave,
            stderr=self._slave,
            cwd=ROOT,
            start_new_session=True,
            env={**inherited, "TERM": "xterm", "PYTHONIOENCODING": "utf-8", **environment},
        )

    def resize(self, columns: int, rows: int) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def read(self, longest_s: float) -> None:
        if select.select([self.master], [], [], longest_s)[0]:
            self.output += os.read(self.master, 65536)

    def screen(self) -> str:
        """The last one that is whole, without colours; empty before it."""
        whole, _, _ = self.output.rpartition(END)
        content = whole.rpartition(BEGIN)[2].decode() if BEGIN in whole else ""
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", content).replace("\r", "")

    def until(self, what: Callable[[str], object]) -> str:
        end = time.monotonic() + PATIENCE_S
        while not what(self.screen()):
            assert time.monotonic() < end, self.stuck()
            self.read(0.1)
        return self.screen()

    def stuck(self) -> str:
        """What it has drawn last, and where each of its threads is; its exit code if it has ended."""
        drawn, code = self.output.count(BEGIN), self.process.poll()
        if code is None:
            self.process.send_signal(signal.SIGUSR1)
            end = time.monotonic() + 1.0
            while time.monotonic() < end:
                self.read(0.1)
        state = Path(f"/proc/{self.process.pid}/status").read_text().splitlines()[2] if code is None else f"exit {code}"
        return f"{state}, drawn {drawn} times\n" + self.output[-6000:].decode(errors="replace")

    def ends(self) -> int:
        """Its exit code; nothing is left undone on the terminal."""
        end = time.monotonic() + PATIENCE_S
        while self.process.poll() is None:
            assert time.monotonic() < end
            self.read(0.1)
        while select.select([self.master], [], [], 0)[0]:
            self.read(0)
        assert self.output.count(ENTER) == 1
        assert LEAVE in self.output.rpartition(ENTER)[2]
        assert BEGIN not in self.output.rpartition(LEAVE)[2]
        assert termios.tcgetattr(self._slave) == self.before
        return self.process.returncode

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.master)
        os.close(self._slave)


@pytest.fixture
def watched(tmp_path: Path) -> Iterator[WatchedService]:
    made = WatchedService(tmp_path)
    made.start()
    yield made
    made.stop()


Start = Callable[..., Watch]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    begun: list[Watch] = []

    def watch(*arguments: str, **fields: object) -> Watch:
        begun.append(Watch("--socket", str(tmp_path / "events.sock"), *arguments, **fields))  # type: ignore[arg-type]
        return begun[-1]

    yield watch
    for each in begun:
        each.close()


def test_it_shows_what_happens_and_comes_back_by_itself(watched: WatchedService, start: Start) -> None:
    watch = start()
    shown = watch.until(lambda screen: "LIVE" in screen)
    assert "no fault: every test is quiet" in shown
    watched.tick = FAULTY
    watched.records.append(CLEARED)
    watch.until(lambda screen: "FAULT fA_du (dosing unit filter)" in screen and "erased by root: 3" in screen)
    watched.stop()
    shown = watch.until(lambda screen: "AWAY" in screen)
    assert "trying again" in shown
    assert "9.012" not in shown
    assert "FAULT fA_du" not in shown
    watched.start()
    watch.until(lambda screen: "LIVE" in screen and "FAULT fA_du" in screen and "9.012 bar" in screen)
    assert watch.screen().count("erased by root: 3") == 1  # it asked for what came after
    os.write(watch.master, b"q")
    assert watch.ends() == 0


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, -signal.SIGINT)])
def test_a_signal_leaves_the_terminal_as_it_was(
    watched: WatchedService, start: Start, number: signal.Signals, code: int
) -> None:
    watch = start()
    watch.until(lambda screen: "LIVE" in screen)
    watch.process.send_signal(number)
    assert watch.ends() == code


def test_ticks_that_stop_are_not_shown_as_live(watched: WatchedService, start: Start) -> None:
    watch = start()
    watch.until(lambda screen: "LIVE" in screen)
    watched.hold.set()
    shown = watch.until(lambda screen: "WAITING" in screen)
    assert "nothing has come for" in shown
    assert "9.012" not in shown
    watched.hold.clear()
    watch.until(lambda screen: "LIVE" in screen)


def test_systems_in_turn_and_sizes_that_change(watched: WatchedService, start: Start) -> None:
    watch = start("--system", "doors", columns=120)
    assert "doors (2 of 2, Tab: next)" in watch.until(lambda screen: "LIVE" in screen)
    os.write(watch.master, b"\t")
    watch.until(lambda screen: "uds (1 of 2, Tab: next)" in screen)
    watch.resize(40, 10)
    small = watch.until(lambda screen: screen and max(map(len, screen.splitlines())) <= 40)
    assert len(small.splitlines()) <= 10


def test_no_colour(watched: WatchedService, start: Start) -> None:
    plain, coloured = start(NO_COLOR="1"), start()
    for watch in (plain, coloured):
        watch.until(lambda screen: "LIVE" in screen)
    assert b"\x1b[32m" in coloured.output
    assert not re.search(rb"\x1b\[[0-9;]*m", plain.output)


def test_it_is_drawn_five_times_a_second_at_most(watched: WatchedService, start: Start) -> None:
    begun = time.monotonic()
    watch = start()
    watch.until(lambda screen: "LIVE" in screen)
    live = time.monotonic()
    while time.monotonic() < live + 2.0:
        watch.read(0.1)
    assert 2 <= watch.output.count(BEGIN) <= 5 * (time.monotonic() - begun) + 1


def test_it_waits_for_a_service_that_is_not_there_yet(tmp_path: Path, start: Start) -> None:
    watch = start("--control", str(tmp_path / "control.sock"))
    watch.until(lambda screen: "AWAY" in screen and "No such file or directory" in " ".join(screen.splitlines()))
    late = WatchedService(tmp_path)
    late.start()
    watch.until(lambda screen: "LIVE" in screen)
    late.stop()


@pytest.mark.parametrize("arguments", [["--lines"], ["--after", "0"], ["--json"]])
def test_lines_are_printed_where_they_are_asked_for(
    watched: WatchedService, start: Start, arguments: list[str]
) -> None:
    watched.records.append(CLEARED)
    watch = start(*arguments)
    end = time.monotonic() + PATIENCE_S
    while b"root" not in watch.output:
        assert time.monotonic() < end
        watch.read(0.1)
    assert ENTER not in watch.output


def test_a_screen_and_lines_are_not_both(watched: WatchedService, start: Start) -> None:
    watch = start("--screen", "--json")
    assert watch.process.wait(PATIENCE_S) != 0
    watch.read(1.0)
    assert b"leave out --lines, --json, --once and --after" in watch.output
