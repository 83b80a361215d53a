"""HTTP clients that are slow, hostile or vanish: do they delay the daemon? Writes docs/results/clients.md.

Rounds with and without them in turn, of one daemon and one server. What is measured is the daemon's own: its CPU time,
and how evenly its ticks come over the control socket.
"""

import argparse
import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from results_page import head_commit, provenance

from faultline.service.protocol.client import ControlClient

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "outputs" / "web"))
from ports import multicast
from web_browser import Vehicle
from web_server import Serving, serving

PAGE = Path(__file__).resolve().parents[2] / "docs" / "results" / "clients.md"
SETTLED_S, DRIVE_S = 3.0, 115.0
PERIOD_S = 0.2
STALLED, DRIPPING = 20, 20
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Round(NamedTuple):
    """CPU time of the daemon in parts of a core, and how far ticks came from their time [s]."""

    cpu: float
    late_s: list[float]


class Beset:
    """All kinds of bad clients at once, until it ends."""

    def __init__(self, running: Serving) -> None:
        self._running, self._over = running, threading.Event()
        self.asked = 0
        work: list[Callable[[], None]] = [self._vanish, self._flood, self._stall, self._drip]
        self._threads = [threading.Thread(target=each) for each in work]

    def __enter__(self) -> "Beset":
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()

    def _connected(self) -> socket.socket:
        sock = socket.socket()
        sock.settimeout(5.0)
        sock.connect(self._running.address)
        return sock

    def _stall(self) -> None:
        """Streams of everything that nobody reads."""
        socks = []
        for _ in range(STALLED):
            sock = self._connected()
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            sock.sendall(b"GET /v1/events?after=0 HTTP/1.1\r\nHost: localhost\r\n\r\n")
            socks.append(sock)
        self._over.wait()
        for sock in socks:
            sock.close()

    def _drip(self) -> None:
        """Requests of which a byte comes now and then."""
        socks = [self._connected() for _ in range(DRIPPING)]
        while not self._over.wait(0.5):
            for k, sock in enumerate(socks):
                try:
                    sock.send(b"G")
                except OSError:  # it was sent away, as it should be: another one comes
                    sock.close()
                    socks[k] = self._connected()
        for sock in socks:
            sock.close()

    def _vanish(self) -> None:
        """Whole pages of records are asked for, by nobody who takes them."""
        while not self._over.wait(0.01):
            with self._connected() as sock:
                sock.sendall(b"GET /v1/records?count=500 HTTP/1.1\r\nHost: localhost\r\n\r\n")
            self.asked += 1

    def _flood(self) -> None:
        """As many questions as one connection can ask, each another one."""
        sock = self._connected()
        while not self._over.is_set():
            try:
                sock.sendall(b"GET /v1/records?after=%d HTTP/1.1\r\nHost: localhost\r\n\r\n" % (self.asked % 1000))
                if not sock.recv(1 << 20):
                    raise ConnectionResetError
            except OSError:
                sock.close()
                sock = self._connected()
            self.asked += 1
        sock.close()


def cpu_s(pid: int) -> float:
    """CPU time that a process has used [s]."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / TICKS_PER_S


def measured(vehicle: Vehicle, seconds: float) -> Round:
    """The daemon for so long [s]."""
    before, begin = cpu_s(vehicle.daemon.pid), time.monotonic()
    came: list[tuple[int, float]] = []
    with ControlClient(vehicle.control) as control:
        for tick in control.live(None):
            came.append((tick.tick, time.monotonic()))
            if came[-1][1] - begin >= seconds:
                break
    used = cpu_s(vehicle.daemon.pid) - before
    late = [abs(t - s - (n - m) * PERIOD_S) for (m, s), (n, t) in pairwise(came)]
    return Round(used / (time.monotonic() - begin), late)


def row(name: str, rounds: list[Round]) -> str:
    """A line of the table: CPU in percent of a core with its spread, ticks in ms."""
    cpu = 100 * np.array([each.cpu for each in rounds])
    late = 1e3 * np.concatenate([each.late_s for each in rounds])
    return (
        f"| {name} | {np.median(cpu):.2f} ({cpu.min():.2f} to {cpu.max():.2f}) | {len(late)} | {np.median(late):.2f} "
        f"| {np.percentile(late, 99):.1f} | {late.max():.1f} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=8, help="of each kind")
    parser.add_argument("--seconds", type=float, default=12.0, help="a round")
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args()
    commit, begin = head_commit(), time.monotonic()
    alone, beset, asked = list[Round](), list[Round](), 0
    with TemporaryDirectory() as place, Vehicle(Path(place), multicast(), 1.0) as vehicle:
        places = ("--control", str(vehicle.control), "--events", str(vehicle.events), "--listen", "127.0.0.1:0")
        with serving(*places, log=Path(place) / "serve.log", orderly=True) as running:
            played = -DRIVE_S
            for k in range(2 * options.rounds):
                if time.monotonic() - played > DRIVE_S - 2 * options.seconds:
                    vehicle.play()
                    played = time.monotonic()
                    time.sleep(SETTLED_S)
                if k % 2:
                    with Beset(running) as clients:
                        beset.append(measured(vehicle, options.seconds))
                    asked += clients.asked
                else:
                    alone.append(measured(vehicle, options.seconds))
                print(f"{k + 1} of {2 * options.rounds}", file=sys.stderr)
    text = "\n".join(
        [
            "# Slow, hostile and vanishing HTTP clients",
            "",
            "The daemon at real traffic, `faultline serve` beside it, and of its clients:",
            "",
            f"* {STALLED} that take nothing of a stream of all events,",
            f"* {DRIPPING} that send a byte of a request now and then,",
            "* one that vanishes as soon as it has asked for 500 records, a hundred times a second,",
            "* one that asks as fast as it is answered.",
            "",
            f"{asked} questions in all; clients and daemon share two cores.",
            "Rounds with and without them in turn. Simulated data.",
            "",
            "How far ticks are off their time:",
            "",
            "| | CPU of the daemon [% of a core], median (range) | ticks | median [ms] | 99 % [ms] | longest [ms] |",
            "|---|---|---|---|---|---|",
            row("alone", alone),
            row("with them", beset),
            "",
            provenance(commit, time.monotonic() - begin),
            "",
        ]
    )
    options.out.write_text(text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
