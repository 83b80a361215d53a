"""A daemon for the tests of HTTP: docs/control.md and docs/events.md on two sockets, and whatever state a test wants.

Events are served by the daemon's own `EventSocket`; the control socket is a small fake.
"""

import queue
import selectors
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Cleared, Dtc, Fault, FaultRecord, Seen, Status
from faultline.service.core.records.health import Health
from faultline.service.outputs.socket import EventSocket
from faultline.service.store.file import Record

Json = dict[str, Any]

BUNDLE = "ab" * 32
NAMES = [
    {"name": "fA_du", "component": "dosing unit filter", "description": "clogged", "spn": 3362, "fmi": 7},
    {"name": "fy_p_ap", "component": "pump pressure sensor", "description": "drifts", "spn": 4334, "fmi": 20},
]


def status(**bits: bool) -> Status:
    names = [field.name for field in msgspec.structs.fields(Status)]
    return Status(**{name: bits.get(name, False) for name in names})


FAILED = status(test_failed=True, test_failed_this_cycle=True, pending=True, confirmed=True, warning=True)
PASSED = status(confirmed=True, failed_since_clear=True)
PENDING = status(test_failed=True, pending=True)


def fault(number: int, system: str = "uds", state: Status = FAILED, **fields: Any) -> Fault:
    seen = Seen(id=f"truck-5e0c72b1-{number}", wall="2026-03-01T10:00:00Z", cycle=7)
    diagnoses = [
        Diagnosis(faults=["fA_du"], rank=1, p=0.7),
        Diagnosis(faults=["fy_p_ap"], rank=1, p=0.2),
        Diagnosis(faults=[], rank=2, p=None, near=["e3"]),
    ]
    known: Json = {
        "number": number,
        "system": system,
        "bundle": BUNDLE,
        "diagnoses": diagnoses,
        "components": ["dosing unit filter", "pump pressure sensor"],
        "dtcs": [Dtc(spn=520192, fmi=11)],
        "tests": ["t02", "t05"],
        "modes": ["partial"],
        "status": state,
        "mask": state.mask,
        "fdc": 127,
        "occurrences": 2,
        "trips": 1,
        "healing": 0,
        "aging": 0,
        "first": seen,
        "latest": seen,
    }
    return Fault(**{**known, **fields})


def record(seq: int, padding: int = 0) -> bytes:
    """A line about number `seq`: every seventh is of a fault, every fifth of health, every eleventh a clearing."""
    about: Health | FaultRecord | Cleared
    head: Json = {"id": f"truck-5e0c72b1-{seq}", "seq": seq, "wall": None}
    if seq % 11 == 0:
        about = Cleared(schema="faultline.cleared/1", numbers=[seq], by="root" + "x" * padding, **head)
    elif seq % 5 == 0:
        about = Health(schema="faultline.health/1", conditions=[], **head)
    else:
        told = fault(seq, tests=["t" + "0" * padding])
        about = FaultRecord(schema="faultline.fault/1", change="confirmed", fault=told, **head)
    return msgspec.json.encode(about) + b"\n"


class FakeDaemon:
    """Both sockets, in a thread. Everything a test changes is a plain attribute, read when a question comes.

    `asked` are the questions so far. `refusing` refuses clearing with a code, `silent` answers nothing at all,
    `turning_away` ends every connection for events (`turned_away` so far), as one that has too many.
    """

    def __init__(self, folder: Path) -> None:
        self.control, self.events = folder / "control.sock", folder / "events.sock"
        self.faults = {1: fault(1), 2: fault(2, state=PASSED), 3: fault(3, system="doors", state=PENDING)}
        self.systems = ["uds", "doors"]
        self.conditions: list[Json] = []
        self.told: list[Record] = []
        self.asked: list[Json] = []
        self.refusing: str | None = None
        self.silent = self.turning_away = False
        self.turned_away = 0
        self._thread: threading.Thread | None = None

    def __enter__(self) -> "FakeDaemon":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def running(self) -> bool:
        return self._thread is not None

    def start(self) -> None:
        """Begins to serve, with all that was told before."""
        self._work: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._wake, self._woken = socket.socketpair()
        self._ending = False
        ready = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(ready,))
        self._thread.start()
        assert ready.wait(10)

    def stop(self) -> None:
        """Ends as a killed process does: every connection with it."""
        if self._thread is not None:
            self._do(lambda: setattr(self, "_ending", True))
            self._thread.join()
            self._thread = None
            self._wake.close()
            self._woken.close()

    def tell(self, *seqs: int, padding: int = 0) -> None:
        """Tells records of these numbers; they are out when this returns."""
        done = threading.Event()

        def work() -> None:
            for seq in seqs:
                line = record(seq, padding)
                self.told.append(Record(seq, "event", line))
                if self.running:
                    self._socket.publish(self.told[-1])
            done.set()

        if self.running:
            self._do(work)
            assert done.wait(10)
        else:
            work()

    def tick(self, number: int, system: str = "uds", padding: int = 0) -> None:
        """Sends a live tick to all who watch."""
        tick = {"schema": "faultline.live/2", "system": system, "tick": number, "padding": "x" * padding}
        line = msgspec.json.encode(tick) + b"\n"

        def work() -> None:
            for sock in [sock for sock, name in self._watching.items() if name == system]:
                self._send(sock, line)

        self._do(work)

    @property
    def watchers(self) -> int:
        return len(self._watching)

    def _do(self, work: Callable[[], object]) -> None:
        self._work.put(lambda: (work(), None)[1])
        self._wake.send(b"x")

    def _run(self, ready: threading.Event) -> None:
        self._selector = selectors.DefaultSelector()
        self._buffers: dict[socket.socket, bytes] = {}
        self._watching: dict[socket.socket, str] = {}
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.control.unlink(missing_ok=True)
        listener.bind(str(self.control))
        listener.listen(64)
        self._socket = EventSocket(self.events, self.told)
        self._socket.register(self._selector)
        self._selector.register(listener, selectors.EVENT_READ, "control")
        self._selector.register(self._woken, selectors.EVENT_READ, "work")
        ready.set()
        while not self._ending:
            found = self._selector.select()
            self._socket.serve([each for each in found if each[0].data is not self._socket or not self._turn_away()])
            for key, _ in found:
                if key.data == "work":
                    self._woken.recv(1)
                    self._work.get()()
                elif key.data == "control":
                    self._accept(listener)
                elif key.data == "asker" and isinstance(key.fileobj, socket.socket):
                    self._hear(key.fileobj)
        self._socket.close()
        for sock in [listener, *self._buffers]:
            sock.close()
        self.control.unlink(missing_ok=True)
        self._selector.close()

    def _turn_away(self) -> bool:
        """Whether it did: whoever connects for events now."""
        if self.turning_away:
            sock, _ = self._socket._listener.accept()
            with sock:
                sock.sendall(b'{"error":"too many clients"}\n')
            self.turned_away += 1
        return self.turning_away

    def _accept(self, listener: socket.socket) -> None:
        sock, _ = listener.accept()
        self._buffers[sock] = b""
        self._selector.register(sock, selectors.EVENT_READ, "asker")

    def _hear(self, sock: socket.socket) -> None:
        try:
            content = sock.recv(65536)
        except ConnectionError:
            content = b""
        if not content:
            self._drop(sock)
            return
        *lines, self._buffers[sock] = (self._buffers[sock] + content).split(b"\n")
        for line in lines:
            self._answer(sock, line)

    def _answer(self, sock: socket.socket, line: bytes) -> None:
        question = msgspec.json.decode(line, type=dict)
        self.asked.append(question)
        if self.silent:
            return
        if question["ask"] == "live":
            if question["name"] in self.systems:
                self._watching[sock] = question["name"]
                return
            answer = _error("unknown", "no such system")
        else:
            answer = getattr(self, f"_{question['ask']}")(question)
        self._send(sock, msgspec.json.encode(answer) + b"\n")

    def _send(self, sock: socket.socket, line: bytes) -> None:
        try:
            sock.sendall(line)
        except OSError:
            self._drop(sock)

    def _drop(self, sock: socket.socket) -> None:
        if self._buffers.pop(sock, None) is not None:
            self._watching.pop(sock, None)
            self._selector.unregister(sock)
            sock.close()

    def _state(self, _: Json) -> Json:
        seq = self.told[-1].seq if self.told else 0
        counts = {"frames": 1000, "dropped": 3, "errors": 0, "trouble": None}
        tests = {"tick": 50, "alarm": ["t02"], "cannot_tell": [], "suspected": True, "anomaly": True}
        return {
            "source": "truck",
            "version": "0.1.0",
            "since": "2026-03-01T09:00:00Z",
            "cycle": 7,
            "seq": seq,
            "conditions": self.conditions,
            "store": {"path": "/var/lib/faultline/events.sqlite", "kept": seq, "failing": False},
            "buses": [{"name": "can", "interface": "socketcan:can0", **counts}],
            "systems": [{"name": name, "bundle": BUNDLE, "bus": "can", **tests} for name in self.systems],
        }

    def _faults(self, _: Json) -> Json:
        return {"faults": [*self.faults.values()], "overflow": False, "seq": self.told[-1].seq if self.told else 0}

    def _fault(self, question: Json) -> Json:
        known = self.faults.get(question["number"])
        if known is None:
            return _error("unknown", f"no fault {question['number']}")
        return {"fault": known, "frames": {"first": {"schema": "faultline.frame/1", "tick": 12}, "latest": None}}

    def _clear(self, question: Json) -> Json:
        number = question.get("number")
        if self.refusing is not None and (self.refusing != "not-kept at 2" or number == 2):
            return _error(self.refusing.partition(" ")[0], "as the test says")
        numbers = [*self.faults] if number is None else [number]
        if any(each not in self.faults for each in numbers):
            return _error("unknown", f"no fault {number}")
        for each in numbers:
            del self.faults[each]
        return {"cleared": numbers, "id": "truck-5e0c72b1-99"}

    def _records(self, question: Json) -> Json:
        count = min(question.get("count", 100), 500)
        if "after" in question:
            kept = [each for each in self.told if each.seq > question["after"]][:count]
        else:
            kept = [each for each in self.told if each.seq < question.get("before", 2**62)][-count:]
        return {"records": [msgspec.Raw(each.line.rstrip()) for each in kept]}

    def _history(self, question: Json) -> Json:
        return _error("unknown", "a service on the vehicle keeps no history; a recording has one")

    def _system(self, question: Json) -> Json:
        if question["name"] not in self.systems:
            return _error("unknown", f"no system {question['name']}")
        named = {"name": question["name"], "bundle": BUNDLE, "period_s": 0.2}
        return {**named, "inputs": [], "generators": [], "faults": NAMES}


def _error(code: str, message: str) -> Json:
    return {"error": {"code": code, "message": message}}
