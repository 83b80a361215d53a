"""What any subscriber has seen is in the store, however the daemon ends."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from ports import multicast

from faultline.service.store.file import StoreFile

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FAULTLINE = str(Path(sys.executable).with_name("faultline"))
SPEED = 20.0
KILLS = 4
WITHIN_S = 20.0


class Service:
    """The daemon by its configuration, with a store, and a recording that is played to it over and over."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.socket, self.store = folder / "events.sock", folder / "events.sqlite"
        bus = multicast()
        (folder / "faultline.toml").write_text(
            f'source = "golden"\n[[bus]]\nname = "bus"\ninterface = "{bus}"\n'
            f'[[bundle]]\npath = "{GOLDEN / "bundle"}"\nbus = "bus"\n[trust]\nallow_unsigned = true\n'
            f'[events]\nsocket = "{self.socket}"\n[store]\npath = "{self.store}"\n'
        )
        replay = [FAULTLINE, "replay", str(GOLDEN / "log"), "--bus", bus, "--speed", str(SPEED)]
        again = ["/bin/sh", "-c", 'while "$@"; do :; done', "replay", *replay]
        self.player = subprocess.Popen(again, start_new_session=True, stderr=subprocess.DEVNULL)
        self.start()

    def start(self) -> None:
        command = [FAULTLINE, "run", "--config", str(self.folder / "faultline.toml"), "--speed", str(SPEED)]
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def end(self) -> None:
        os.killpg(self.player.pid, signal.SIGKILL)
        self.player.wait()
        self.kill()


class Subscriber(threading.Thread):
    """Hears until the service ends; asks for what comes after the last id that it has."""

    def __init__(self, path: Path, after: str | None) -> None:
        super().__init__(daemon=True)
        self.path, self.after = path, after
        self.lines: list[bytes] = []

    def run(self) -> None:
        end = time.monotonic() + WITHIN_S
        with socket.socket(socket.AF_UNIX) as client:
            while True:
                try:
                    client.connect(str(self.path))
                    break
                except (FileNotFoundError, ConnectionRefusedError):
                    assert time.monotonic() < end
                    time.sleep(0.02)
            client.sendall(b'{"after": "%s"}\n' % self.after.encode() if self.after else b'{"after": 0}\n')
            with client.makefile("rb") as stream:
                self.lines += (line for line in stream if line.endswith(b"\n"))


def runs(lines: Sequence[bytes]) -> set[str]:
    """The runs of the daemon that the records' ids begin with."""
    return {json.loads(line)["id"].rpartition("-")[0] for line in tuple(lines)}


@pytest.mark.waits
def test_what_was_seen_before_a_kill_is_there_after_it(tmp_path: Path) -> None:
    seed = int.from_bytes(os.urandom(4))
    print("seed", seed)
    chance = np.random.default_rng(seed)
    service, seen, after = Service(tmp_path), list[bytes](), None
    try:
        for turn in range(KILLS):
            subscriber = Subscriber(service.socket, after)
            subscriber.start()
            begin = time.monotonic()
            # The first lines may be what the run before had stored and not yet sent: each run is to add one of its own.
            while runs(subscriber.lines) <= runs(seen) and time.monotonic() < begin + WITHIN_S:
                time.sleep(0.005)
            time.sleep(float(chance.uniform(0.0, 1.5)))
            service.kill()
            subscriber.join(WITHIN_S)
            assert subscriber.lines, f"turn {turn}: nothing was told; {(tmp_path / 'log').read_text()}"
            seen += subscriber.lines
            after = json.loads(seen[-1])["id"]
            service.start()
    finally:
        service.end()
    store = StoreFile(service.store)
    kept = store.before(None, 9999)
    store.close()
    lines = [each.line for each in kept]
    assert store.aside is None
    assert seen == lines[: len(seen)], "every one, once and in order, as each subscriber asked for what came after"
    records = [json.loads(line) for line in lines]
    assert [record["seq"] for record in records] == list(range(1, len(records) + 1))
    assert len({record["id"] for record in records}) == len(records)
    assert len(runs(lines)) >= KILLS, "every run has a name of its own"
