"""A real browser at the page of a real server: of a finished recording, or of a daemon to which one is played."""

import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect, sync_playwright
from web_server import serving

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
FAULTLINE = str(Path(sys.executable).with_name("faultline"))
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PATIENCE_MS = 60_000  # a browser on a machine that is busy
expect.set_options(timeout=PATIENCE_MS)
PHONE = {"width": 360, "height": 740}
DESK = {"width": 1280, "height": 900}


@contextmanager
def browser() -> Iterator[Browser]:
    """A headless one; the test is skipped where there is none."""
    if CHROMIUM is None:
        pytest.skip("no Chromium: see tests/browser.sh")
    with sync_playwright() as tool:
        started = tool.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        try:
            yield started
        finally:
            started.close()


@contextmanager
def page(browser: Browser, url: str, refused: Sequence[int] = (), **options: Any) -> Iterator[Page]:
    """The page in a window of its own; what its console says and what fails is a failure of the test.

    But for answers of a status in `refused`, which the browser says on its own.
    """
    context = browser.new_context(**{"viewport": DESK, **options})
    context.set_default_timeout(PATIENCE_MS)
    opened = context.new_page()
    wrong: list[str] = []

    def hear(said: ConsoleMessage) -> None:
        expected = any(f"responded with a status of {status} " in said.text for status in refused)
        if said.type in ("error", "warning") and not expected:
            wrong.append(said.text)

    opened.on("console", hear)
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.on("request", lambda asked: None if asked.url.startswith(url) else wrong.append(f"asks {asked.url}"))
    try:
        opened.goto(url)
        yield opened
        assert not wrong, wrong
    finally:
        context.close()


@contextmanager
def recorded(folder: Path) -> Iterator[str]:
    """Where the golden recording is shown."""
    asked = ("--recording", str(GOLDEN / "log"), "--bundle", str(GOLDEN / "bundle"), "--listen", "127.0.0.1:0")
    with serving(*asked, log=folder / "serve.log", orderly=True) as running:
        yield running.url


class Vehicle:
    """A daemon with a store; `play` plays the golden recording to it."""

    def __init__(self, folder: Path, bus: str, speed: float) -> None:
        self.folder, self.bus, self.speed = folder, bus, speed
        self.control, self.events = folder / "control.sock", folder / "events.sock"
        self._opened = ExitStack()
        (folder / "faultline.toml").write_text(
            f'source = "truck-17"\n[[bus]]\nname = "bus"\ninterface = "{bus}"\n'
            f'[[bundle]]\npath = "{GOLDEN / "bundle"}"\nbus = "bus"\n[trust]\nallow_unsigned = true\n'
            f'[events]\nsocket = "{self.events}"\n[control]\nsocket = "{self.control}"\n'
            f'[store]\npath = "{folder / "events.sqlite"}"\n'
        )

    def __enter__(self) -> "Vehicle":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def start(self) -> None:
        """The daemon, anew."""
        self.daemon = self._run("run", "--config", str(self.folder / "faultline.toml"), "--speed", str(self.speed))

    def play(self) -> None:
        """Plays the recording once, in the background."""
        self._run("replay", str(GOLDEN / "log"), "--bus", self.bus, "--speed", str(self.speed))

    def _run(self, *command: str) -> "subprocess.Popen[bytes]":
        log = self._opened.enter_context((self.folder / "log").open("ab"))
        process = subprocess.Popen([FAULTLINE, *command], stdout=subprocess.DEVNULL, stderr=log)
        self._opened.callback(process.wait)
        self._opened.callback(process.kill)
        return process
