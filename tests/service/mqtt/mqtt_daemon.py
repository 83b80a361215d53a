"""A daemon that tells what a test says: both sockets, as docs/events.md and docs/control.md have them."""

import json
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any


class FakeDaemon:
    """Serves `records` (lines of JSON with their id and number), from the one at `first` on; older ones are gone."""

    def __init__(self, folder: Path, source: str = "truck-17", run: str = "5e0c72b1") -> None:
        self.events, self.control = folder / "events.sock", folder / "control.sock"
        self.source, self.run = source, run
        self.records: list[tuple[str, int, bytes]] = []
        self.first = 0
        self.faults: dict[int, dict[str, Any]] = {}
        self.conditions: list[dict[str, str]] = []
        self.asked: list[object] = []  # what subscribers asked to begin after
        self.answers: Callable[[dict[str, Any]], bytes] | None = None  # instead of what the control socket answers
        self.given = 0  # records that were handed to the kernel
        self._changed = threading.Condition()
        self._life = _Life()

    def start(self) -> None:
        self._life = life = _Life()
        life.is_on = True
        for path, serve in ((self.events, self._subscriber), (self.control, self._question)):
            path.unlink(missing_ok=True)
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listener.bind(str(path))
            listener.listen(8)
            life.socks.append(listener)
            threading.Thread(target=self._accept, args=(life, listener, serve), daemon=True).start()

    def stop(self) -> None:
        """As a daemon that is killed: connections end, socket files stay."""
        with self._changed:
            self._life.is_on = False
            self._changed.notify_all()
        for sock in self._life.socks:
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
            sock.close()

    def tell(self, schema: str = "faultline.event/1", *, missing: int = 0, **fields: object) -> str:
        """Adds a record, whose number leaves out `missing`; gives its id."""
        with self._changed:
            seq = (self.records[-1][1] if self.records else 0) + 1 + missing
            identifier = f"{self.source}-{self.run}-{seq}"
            record = {"schema": schema, "id": identifier, "seq": seq, "wall": "2026-03-01T10:00:00.250Z", **fields}
            self.records.append((identifier, seq, json.dumps(record).encode() + b"\n"))
            self._changed.notify_all()
        return identifier

    def tell_fault(self, number: int, change: str = "confirmed") -> str:
        """A record on a fault, and what the control socket says of it."""
        fault = {"number": number, "system": "uds", "components": ["dosing unit"], "change": change}
        if change in ("aged", "displaced"):
            self.faults.pop(number, None)
        else:
            self.faults[number] = fault
        return self.tell("faultline.fault/1", change=change, fault=fault)

    def tell_cleared(self, *numbers: int) -> str:
        for number in numbers:
            self.faults.pop(number, None)
        return self.tell("faultline.cleared/1", numbers=list(numbers), by="root")

    def storm(self, count: int) -> list[str]:
        """So many events at once."""
        return [self.tell(transition="refined", alarm=["t02"] * 40, bundle="0" * 64) for _ in range(count)]

    def _accept(self, life: "_Life", listener: socket.socket, serve: "Serve") -> None:
        with suppress(OSError):
            while True:
                sock, _ = listener.accept()
                with self._changed:
                    if not life.is_on:  # it was stopped meanwhile: nobody ends this one later
                        sock.close()
                        return
                    life.socks.append(sock)
                threading.Thread(target=self._serve, args=(life, sock, serve), daemon=True).start()

    def _serve(self, life: "_Life", sock: socket.socket, serve: "Serve") -> None:
        with sock, suppress(OSError, ValueError):
            serve(life, sock)

    def _subscriber(self, life: "_Life", sock: socket.socket) -> None:
        after = json.loads(sock.makefile("rb").readline()).get("after")
        with self._changed:
            self.asked.append(after)
            place = self._place(after)
        while life.is_on:
            with self._changed:
                while life.is_on and place >= len(self.records):
                    self._changed.wait()
                batch = self.records[place : place + 50]
            for _, _, line in batch:
                sock.sendall(line)
                place += 1
                self.given = max(self.given, place)

    def _place(self, after: object) -> int:
        for place, (identifier, _, _) in enumerate(self.records[self.first :], start=self.first + 1):
            if identifier == after:
                return place
        return self.first

    def _question(self, _: "_Life", sock: socket.socket) -> None:
        for line in sock.makefile("rb"):
            asked = json.loads(line)
            sock.sendall(self.answers(asked) if self.answers else self.answer(asked))

    def answer(self, asked: dict[str, Any]) -> bytes:
        with self._changed:
            seq = self.records[-1][1] if self.records else 0
            faults = [self.faults[number] for number in sorted(self.faults)]
        if asked["ask"] == "faults":
            answer: dict[str, Any] = {"faults": faults, "overflow": False, "seq": seq}
        elif asked["ask"] == "state":
            answer = {"source": self.source, "version": "0", "since": None, "wall": None, "cycle": 1, "seq": seq}
            answer |= {"conditions": self.conditions, "store": {}, "buses": [], "systems": []}
        else:
            answer = {"error": {"code": "bad-request", "message": "no such question"}}
        return json.dumps(answer).encode() + b"\n"


class _Life:
    """From a start to its stop: what is accepted in one is not served in the next."""

    def __init__(self) -> None:
        self.is_on = False
        self.socks: list[socket.socket] = []


Serve = Callable[[_Life, socket.socket], None]
