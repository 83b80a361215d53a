"""The service's two sockets as docs/control.md and docs/events.md have them, and faults to remember."""

import socket
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Dtc, Fault, Seen, Status

SEEN = Seen(id="truck-00000000-1", wall="2026-01-01T00:00:00.000+00:00", cycle=1)


def fault(
    number: int,
    *dtcs: tuple[int, int],
    there: bool = True,
    confirmed: bool = True,
    occurrences: int = 1,
    components: tuple[str, ...] = ("pump",),
) -> Fault:
    """One that is remembered; `there`: its test fails now."""
    status = Status(
        test_failed=there,
        test_failed_this_cycle=there,
        pending=there,
        confirmed=confirmed,
        not_completed_since_clear=False,
        failed_since_clear=True,
        not_completed_this_cycle=False,
        warning=False,
    )
    return Fault(
        number=number,
        system="uds",
        bundle="0" * 64,
        diagnoses=[Diagnosis(faults=["fq_pump"], rank=1, p=None)],
        components=list(components),
        dtcs=[Dtc(spn=spn, fmi=fmi) for spn, fmi in dtcs],
        tests=["t02"],
        modes=["dosing"],
        status=status,
        mask=status.mask,
        fdc=127 if there else -128,
        occurrences=occurrences,
        trips=1,
        healing=0,
        aging=0,
        first=SEEN,
        latest=SEEN,
    )


class FakeService:
    """`answer` overrides what is said to a question; None says nothing. `asked` counts questions."""

    def __init__(self, folder: Path) -> None:
        self.control, self.events = folder / "control.sock", folder / "events.sock"
        self.faults: list[Fault] = []
        self.answer: Any = ...
        self.asked = 0
        self._listeners: list[socket.socket] = []
        self._clients: list[socket.socket] = []
        self._subscribers: list[socket.socket] = []
        self.askers: list[socket.socket] = []
        self._changed = threading.Condition()

    def __enter__(self) -> "FakeService":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, *, control: bool = True, events: bool = True) -> None:
        """Serves; either socket may be left away."""
        for path, serve, wanted in ((self.control, self._answer, control), (self.events, self._subscribe, events)):
            if wanted:
                path.unlink(missing_ok=True)
                listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                listener.bind(str(path))
                listener.listen()
                self._listeners.append(listener)
                threading.Thread(target=self._accept, args=(listener, serve), daemon=True).start()

    def stop(self) -> None:
        """Goes away, as a service that is stopped: its sockets are gone and its connections end."""
        with self._changed:
            for each in (*self._listeners, *self._clients):
                with suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)
                each.close()
            for path in (self.control, self.events):
                path.unlink(missing_ok=True)
            self._listeners, self._clients, self._subscribers = [], [], []

    def tell(self, *faults: Fault) -> None:
        """Remembers these from now on, and tells that something has changed."""
        self.faults = list(faults)
        with self._changed:
            assert self._changed.wait_for(lambda: self._subscribers, 10)
            for each in self._subscribers:
                each.sendall(b'{"schema":"faultline.fault/1","seq":7}\n')

    def _accept(self, listener: socket.socket, serve: Any) -> None:
        with suppress(OSError):  # closed: that is the end
            while True:
                client, _ = listener.accept()
                with self._changed:
                    if listener not in self._listeners:  # stopped meanwhile
                        client.close()
                        return
                    self._clients.append(client)
                threading.Thread(target=self._served, args=(client, serve), daemon=True).start()

    def _served(self, client: socket.socket, serve: Any) -> None:
        with suppress(OSError), client.makefile("rb") as lines:
            for line in lines:
                serve(client, msgspec.json.decode(line))

    def _answer(self, client: socket.socket, question: Any) -> None:
        assert question == {"ask": "faults"}
        self.askers.append(client)
        self.asked += 1
        answer = self.answer
        if answer is ...:
            answer = {"faults": self.faults, "overflow": False, "seq": 7}
        if answer is not None:
            client.sendall(answer if isinstance(answer, bytes) else msgspec.json.encode(answer) + b"\n")

    def _subscribe(self, client: socket.socket, request: Any) -> None:
        assert request == {}
        with self._changed:
            self._subscribers.append(client)
            self._changed.notify_all()
