"""`faultline mqtt` as a process, and its configuration."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import faultline

PROGRAM = """
import sys
from importlib.metadata import EntryPoint
from faultline.service.cli import dispatch
command = EntryPoint("mqtt", "faultline.service.mqtt.command:main", "faultline.commands")
sys.exit(dispatch(["mqtt", *sys.argv[1:]], {"mqtt": command}))
"""

WARNINGS = "error,ignore::ResourceWarning"
"""All are errors but one: paho leaves the socket of a failed handshake to be collected."""

QUICK = """
import ctypes
ctypes.CDLL(None).prctl(1, 9)  # PR_SET_PDEATHSIG: a test that fails leaves nothing running
from faultline.service.mqtt import bridge, broker, sender
broker.RETRY_S = sender.RETRY_S = 0.1, 6.0
bridge.ASKED_S = 0.1, 1.0
bridge.LEAVING_S = 2.0
"""
"""Tries come ten times as fast; how long they wait is a matter of `Backoff`, which has tests of its own."""

PATIENCE_S = 20.0


def write_config(folder: Path, port: int, *lines: str, tls: tuple[str, ...] = (), **values: object) -> Path:
    """A configuration for the sockets in the folder; `values` replace or add keys of [mqtt]."""
    keys: dict[str, object] = {"host": "localhost" if tls else "127.0.0.1", "port": port}
    keys |= {"events": f"{folder}/events.sock", "control": f"{folder}/control.sock", "cursor": f"{folder}/cursor"}
    keys |= values
    rows = [
        f"{key} = {str(value).lower() if isinstance(value, bool | int) else repr(value)}" for key, value in keys.items()
    ]
    path = folder / "mqtt.toml"
    path.write_text("\n".join(["[mqtt]", *rows, *lines, *(["[mqtt.tls]", *tls] if tls else [])]) + "\n")
    return path


class Process:
    """It runs; `said` is what came on standard error so far.

    `before` is done in it first; files that it writes become no larger than `largest_file` [bytes].
    """

    def __init__(self, config: Path, before: str = "", largest_file: int | None = None, **environment: str) -> None:
        root = str(Path(str(faultline.__file__)).parents[1])
        if largest_file is not None:
            before += (
                f"\nimport resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({largest_file}, {largest_file}))\n"
            )
        self._process = subprocess.Popen(
            [sys.executable, "-c", before + QUICK + PROGRAM, "--config", str(config)],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": root, "PYTHONWARNINGS": WARNINGS, **environment},
        )
        self.said: list[str] = []
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as lines:
            for line in lines:
                with self._changed:
                    self.said.append(line.rstrip("\n"))
                    self._changed.notify_all()

    def wait_said(self, text: str, within_s: float = PATIENCE_S) -> str:
        """The first line with that text."""

        def found() -> str:
            return next((line for line in self.said if text in line), "")

        with self._changed:
            assert self._changed.wait_for(found, within_s), self.said
            return found()

    @property
    def memory(self) -> int:
        """Resident memory [bytes]."""
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) * 1024

    def is_running(self) -> bool:
        return self._process.poll() is None

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def wait(self, within_s: float = PATIENCE_S) -> int:
        code = self._process.wait(within_s)
        self._reader.join(within_s)
        return code

    def kill(self) -> None:
        if self.is_running():
            self.signal(signal.SIGKILL)
        self.wait()

    def stop(self) -> int:
        """Ends it as the service manager does; its exit code."""
        self.signal(signal.SIGTERM)
        return self.wait()


def wait_until(what: object, within_s: float = PATIENCE_S) -> None:
    """Until the function says yes; for what tells nobody that it has changed."""
    assert callable(what)
    end = time.monotonic() + within_s
    while not what():
        assert time.monotonic() < end
        time.sleep(0.01)
