"""A daemon at its limit of file descriptors refuses clients and goes on diagnosing."""

import json
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ports import multicast

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FAULTLINE = str(Path(sys.executable).with_name("faultline"))
LIMIT, CLIENTS, WITHIN_S = 36, 80, 40.0


def until(what: str, check: Callable[[], object]) -> None:
    end = time.monotonic() + WITHIN_S
    while not check():
        assert time.monotonic() < end, what
        time.sleep(0.05)


def said(path: str) -> list[dict[str, Any]]:
    """The whole lines that the daemon has printed."""
    return [json.loads(line) for line in Path(path).read_bytes().split(b"\n")[:-1]]


def test_clients_that_use_up_the_descriptors_end_neither_the_daemon_nor_the_diagnosis(tmp_path: Path) -> None:
    bus, control, events = multicast(), tmp_path / "c.sock", tmp_path / "e.sock"
    command = [FAULTLINE, "run", "--bundle", str(GOLDEN / "bundle"), "--bus", bus, "--speed", "20"]
    command += ["--socket", str(events), "--control", str(control)]
    with ExitStack() as opened, (tmp_path / "out").open("wb") as out:
        process = subprocess.Popen(
            command,
            stdout=out,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (LIMIT, LIMIT)),
        )
        opened.callback(process.wait)
        opened.callback(process.kill)
        until("the sockets", lambda: control.exists() and events.exists())
        for k in range(CLIENTS):
            client = opened.enter_context(socket.socket(socket.AF_UNIX))
            client.connect(str((control, events)[k % 2]))
            client.send(b"{}\n" if k % 2 else b'{"ask":"live"}\n')
        until(
            "the condition",
            lambda: (
                "clients-refused" in {each["kind"] for line in said(out.name) for each in line.get("conditions", [])}
            ),
        )
        player = opened.enter_context(
            subprocess.Popen(
                [FAULTLINE, "replay", str(GOLDEN / "log"), "--bus", bus, "--speed", "20"], stderr=subprocess.DEVNULL
            )
        )
        until("the fault", lambda: "occurred" in {line.get("transition") for line in said(out.name)})
        assert process.poll() is None
        player.wait(WITHIN_S)
