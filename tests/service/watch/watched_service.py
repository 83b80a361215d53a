"""A service for the screen: both sockets, as docs/events.md and docs/control.md have them."""

import json
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

SYSTEM: dict[str, Any] = {
    "name": "uds",
    "bundle": "ab",
    "period_s": 0.2,
    "inputs": [
        {"signal": "y_p_du", "unit": "Pa", "display": [{"unit": "bar", "size": 1e5, "digits": 3}]},
        {"signal": "dc_dose", "unit": "1"},
    ],
    "generators": [
        {"test": "t02", "predicts": "y_p_du", "faults": ["fA_du", "fy_p_du"]},
        {"test": "t05", "predicts": "y_p_du", "faults": ["fA_du"]},
    ],
    "faults": [
        {"name": "fA_du", "component": "dosing unit filter", "description": "filter clogged"},
        {"name": "fy_p_du", "component": "pressure sensor", "description": "sensor drifts"},
    ],
    "equations": [{"name": "e03", "description": "flow of the pump"}],
}
STATE: dict[str, Any] = {
    "source": "truck-17",
    "version": "0.1.0",
    "seq": 3,
    "systems": [{"name": "uds"}, {"name": "doors"}],
    "conditions": [{"kind": "frozen", "of": "y_p_ap", "since": "2026-03-01T10:00:00Z"}],
}
TICK: dict[str, Any] = {
    "schema": "faultline.live/2",
    "system": "uds",
    "bundle": "ab",
    "tick": 62,
    "t_s": 12.4,
    "mode": "partial",
    "z": [9.012e5, 0.35],
    "quality": ["good", "good"],
    "y_hat": [8.98e5, 9.034e5],
    "r": [0.0, 0.0],
    "sigma": [1.0, 1.0],
    "usable": [True, True],
    "sums": [0.5, -0.25],
    "alarm": [],
    "cannot_tell": [],
    "suspected": False,
    "anomaly": False,
    "diagnoses": [],
    "separating": [],
}
FAULTY = TICK | {
    "sums": [1.6, -0.25],
    "alarm": ["t02"],
    "cannot_tell": ["t05"],
    "anomaly": True,
    "diagnoses": [{"faults": ["fA_du"], "rank": 1, "p": 0.7}, {"faults": ["fy_p_du"], "rank": 2, "p": 0.25}],
    "separating": [{"between": [["fA_du"], ["fy_p_du"]], "telling": [], "waiting": ["t05"]}],
}


class WatchedService:
    """Serves `state`, `systems`, the `tick` of each as often as it is told, and `records`; all are read when asked."""

    def __init__(self, folder: Path) -> None:
        self.events, self.control = folder / "events.sock", folder / "control.sock"
        self.state = STATE
        self.systems = {"uds": SYSTEM, "doors": SYSTEM | {"name": "doors"}}
        self.tick = TICK
        self.records: list[dict[str, Any]] = []
        self.hold = threading.Event()  # no ticks
        self._ended = threading.Event()
        self._socks: list[socket.socket] = []
        self._lock = threading.Lock()

    def start(self) -> None:
        self._ended = ended = threading.Event()
        for path, serve in ((self.control, self._answer), (self.events, self._tell)):
            path.unlink(missing_ok=True)
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listener.bind(str(path))
            listener.listen(8)
            self._socks.append(listener)
            threading.Thread(target=self._accept, args=(listener, serve, ended), daemon=True).start()

    def stop(self) -> None:
        """As a service that is killed."""
        with self._lock:
            self._ended.set()
            for sock in self._socks:
                with suppress(OSError):
                    sock.shutdown(socket.SHUT_RDWR)
                sock.close()
            self._socks.clear()

    def _accept(
        self, listener: socket.socket, serve: Callable[[socket.socket, threading.Event], None], ended: threading.Event
    ) -> None:
        with suppress(OSError):
            while True:
                sock, _ = listener.accept()
                with self._lock:
                    if ended.is_set():
                        sock.close()
                        return
                    self._socks.append(sock)
                threading.Thread(target=self._serve, args=(serve, sock, ended), daemon=True).start()

    def _serve(
        self, serve: Callable[[socket.socket, threading.Event], None], sock: socket.socket, ended: threading.Event
    ) -> None:
        with suppress(OSError, ValueError):
            serve(sock, ended)

    def _answer(self, sock: socket.socket, ended: threading.Event) -> None:
        for line in sock.makefile("rb"):
            asked = json.loads(line)
            if asked["ask"] == "live":
                while not ended.wait(0.05):
                    if self.hold.is_set():
                        continue
                    sock.sendall(json.dumps(self.tick | {"system": asked["name"]}).encode() + b"\n")
                return
            answer = self.state if asked["ask"] == "state" else self.systems[asked["name"]]
            sock.sendall(json.dumps(answer).encode() + b"\n")

    def _tell(self, sock: socket.socket, ended: threading.Event) -> None:
        after = json.loads(sock.makefile("rb").readline()).get("after")
        told = next((k + 1 for k, each in enumerate(self.records) if each["id"] == after), 0)
        while not ended.wait(0.02):
            for each in self.records[told:]:
                sock.sendall(json.dumps(each).encode() + b"\n")
                told += 1
