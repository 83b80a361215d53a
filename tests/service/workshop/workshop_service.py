"""A control socket as docs/control.md has it: it answers, plays ticks to who asks for live values, and ends."""

import json
import socket
import threading
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from faultline.service.core.records.fault import Status
from faultline.service.protocol.live import LiveTick, SystemDescription

BUNDLE = "ab" * 32
SYSTEM: dict[str, Any] = {
    "name": "uds",
    "bundle": BUNDLE,
    "version": 3,
    "sensor_set": "instrumented",
    "period_s": 0.2,
    "settling_s": 20.0,
    "modes": ["edge", "idle", "partial", "maximum"],
    "instructions": {"idle": "hold the pressure and do not dose", "partial": "dose some", "maximum": "dose at maximum"},
    "inputs": [
        {
            "signal": "y_p_du",
            "unit": "Pa",
            "lower": 5e5,
            "upper": 16e5,
            "display": [{"unit": "bar", "size": 1e5, "digits": 3}],
        },
        {"signal": "dc_dose", "unit": "1", "lower": 0.0, "upper": 1.0},
    ],
    "generators": [
        {"name": "t1.ode", "test": "t1", "predicts": "y_p_du", "inputs": ["y_p_du"], "faults": ["fA_du"]},
        {"name": "t2.ode", "test": "t2", "predicts": "y_p_du", "inputs": ["y_p_du"], "faults": ["fA_du", "fq"]},
    ],
    "faults": [
        {"name": "fA_du", "component": "filter", "description": "filter clogged", "spn": 3362, "fmi": 7},
        {"name": "fq", "component": "pump", "description": "delivers too little"},
    ],
    "disturbances": [],
    "equations": [{"name": "e01", "description": "pump flow"}],
}
UDS = msgspec.convert(SYSTEM, SystemDescription)
FILTER = {"faults": ["fA_du"], "rank": 1, "p": 0.9, "near": []}
PUMP = {"faults": ["fq"], "rank": 2, "p": 0.1, "near": []}


def line(tick: int, mode: str = "idle", **fields: Any) -> dict[str, Any]:
    """A live line: all tests are quiet, unless `fields` say otherwise."""
    quiet: dict[str, Any] = {
        "schema": "faultline.live/2",
        "system": "uds",
        "bundle": BUNDLE,
        "tick": tick,
        "t_s": round(tick * 0.2, 3),
        "mode": mode,
        "z": [1e6, {"idle": 0.0, "maximum": 1.0}.get(mode, 0.5)],
        "quality": ["good", "good"],
        "y_hat": [1e6, 1e6],
        "r": [0.0, 0.0],
        "sigma": [1.0, 1.0],
        "sums": [0.1, -0.2],
        "usable": [True, True],
        "alarm": [],
        "cannot_tell": [],
        "suspected": False,
        "anomaly": False,
        "diagnoses": [],
        "separating": [],
    }
    return quiet | fields


def tick(number: int, mode: str = "idle", **fields: Any) -> LiveTick:
    """The same as the command reads it."""
    return msgspec.convert(line(number, mode, **fields), LiveTick)


def visits(modes: Iterable[str], seconds: float = 61.0, begin: int = 0, **fields: Any) -> Iterator[dict[str, Any]]:
    """Live lines of so many seconds of each mode, with 8 s of edge before it."""
    number = begin
    for mode in modes:
        for k in range(round((8.0 + seconds) / 0.2)):
            yield line(number, "edge" if k < 40 else mode, **fields)
            number += 1


ROUND = ("idle", "partial", "maximum")
WHOLE = ROUND * 2


def remembered(number: int, occurrences: int = 1, *, there: bool = False, component: str = "filter") -> dict[str, Any]:
    """A remembered fault."""
    seen = {"id": "truck-1", "wall": "2026-01-01T00:00:00+00:00", "cycle": 1}
    names = Status.__struct_fields__
    return {
        "number": number,
        "system": "uds",
        "bundle": BUNDLE,
        "diagnoses": [FILTER],
        "components": [component],
        "dtcs": [{"spn": 3362, "fmi": 7}],
        "tests": ["t1"],
        "modes": ["idle"],
        "status": {name: name == "confirmed" or (there and name == "test_failed") for name in names},
        "mask": 8 + there,
        "fdc": 127,
        "occurrences": occurrences,
        "trips": 1,
        "healing": 0,
        "aging": 0,
        "first": seen,
        "latest": seen,
    }


class Service:
    """Serves at `path`. `live` is played once; then the connection ends, or with `stays` nothing comes any more.

    `after` replaces answers once the ticks were asked for.
    """

    def __init__(
        self,
        path: Path,
        live: Iterable[Mapping[str, Any]] = (),
        *,
        stays: bool = False,
        answers: Mapping[str, Any] | None = None,
        after: Mapping[str, Any] | None = None,
    ) -> None:
        self.path, self._stays, self._after = path, stays, after or {}
        self._live = [json.dumps(each).encode() + b"\n" for each in live]
        self.answers: dict[str, Any] = {
            "state": {
                "source": "truck-17",
                "version": "0.1.0",
                "wall": "2026-01-01T00:00:00+00:00",
                "seq": 1,
                "conditions": [],
                "systems": [{"name": "uds", "bundle": BUNDLE}],
            },
            "system": SYSTEM,
            "faults": {"faults": [], "overflow": False, "seq": 1},
            **(answers or {}),
        }
        self._ended = threading.Event()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(path))
        self._listener.listen()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Service":
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as last:
            last.connect(str(self.path))
        self._thread.join(10.0)
        self._listener.close()

    def _serve(self) -> None:
        while not self._ended.is_set():
            client, _ = self._listener.accept()
            threading.Thread(target=self._talk, args=(client,), daemon=True).start()

    def _talk(self, client: socket.socket) -> None:
        with client, client.makefile("rb") as lines:
            for question in lines:
                ask = json.loads(question)["ask"]
                if ask == "live":
                    self.answers |= self._after
                    self._play(client)
                    return
                client.sendall(json.dumps(self.answers[ask]).encode() + b"\n")

    def _play(self, client: socket.socket) -> None:
        try:
            for each in self._live:
                client.sendall(each)
            if self._stays:
                self._ended.wait(60.0)
        except (BrokenPipeError, ConnectionResetError):
            return
