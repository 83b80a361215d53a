"""What the service's process does in the endurance campaign; only what a vehicle has is imported here.

    python tests/campaigns/endured.py soak HOURS | fuzz FRAMES SEED | rate SECONDS FOREIGN

Each time that it has looked at itself, a line of JSON goes to standard error: standard output has the events.
"""

import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from faultline.service.bundle.load import load_bundle
from faultline.service.bus import Bus
from faultline.service.bus.base import BATCH, QUEUE
from faultline.service.bus.interface import Interface
from faultline.service.bus.reader import CLASSIC
from faultline.service.bus.socketcan import EFF_FLAG, SocketCan
from faultline.service.daemon.loop import Loop
from faultline.service.daemon.pipeline import BusChannel, watched
from faultline.service.daemon.sequencer import Sequencer
from faultline.service.logs import Frame, open_log
from faultline.service.outputs.socket import EventSocket
from faultline.service.store.journal import Journal
from faultline.service.systemd import Notifier

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
VIRTUAL = Interface(3, is_can=True, is_up=True, virtual=True)
SO_SNDBUFFORCE = 32  # asm-generic/socket.h
STEP_S = 0.01  # what a second brings is sent in so small parts
LOOKS = 50
"""How often a process looks at itself."""


def looked(at: float) -> None:
    """Resident memory [MiB] and open descriptors, at so many hours or frames."""
    status = Path("/proc/self/status").read_text().splitlines()
    resident = next(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024
    descriptors = len([*Path("/proc/self/fd").iterdir()])
    print(json.dumps({"at": at, "rss_mib": resident, "descriptors": descriptors}), file=sys.stderr, flush=True)


class Playback(Bus):
    """The golden recording again and again, as fast as it is taken, then the loop ends; `now` is where it is [s]."""

    def __init__(self, hours: float) -> None:
        super().__init__()
        self.now = 1000.0
        self._until = self.now + 3600.0 * hours
        self._every = 3600.0 * hours / LOOKS
        self._due = self.now + self._every
        self._frames = self._again()
        self._read, self._write = os.pipe()
        os.write(self._write, b"x")  # frames wait, always

    def _again(self) -> Iterator[Frame]:
        log = open_log(GOLDEN / "log")
        frames, begin = [*log.relative()], self.now
        while True:
            for t, can_id, is_extended, data in frames:
                yield Frame(begin + t, can_id, is_extended, data)
            begin += log.duration_s + 0.01

    def fileno(self) -> int:
        return self._read

    @property
    def dropped(self) -> int:
        return 0

    def receive(self) -> list[Frame]:
        found = [next(self._frames) for _ in range(BATCH)]
        self.now = found[-1].t
        self.counts.frames += len(found)
        if self.now >= self._due:
            looked((self.now - 1000.0) / 3600.0)
            self._due += self._every
        if self.now >= self._until:
            signal.raise_signal(signal.SIGTERM)
        return found

    def send(self, frame: Frame) -> None:
        raise NotImplementedError

    def close(self) -> None:
        os.close(self._read)
        os.close(self._write)


def soak(hours: float) -> None:
    """The daemon's loop with a bundle, a bus and a subscriber, so many hours of log time."""
    bundle = load_bundle(GOLDEN / "bundle")
    with (
        TemporaryDirectory() as folder,
        Journal(Path(folder) / "events.sqlite", print) as journal,
        EventSocket(Path(folder) / "s") as subscribers,
    ):
        bus = Playback(hours)
        line = BusChannel("bus", bus, [watched(bundle, "truck", 1.0)], lambda _: None)
        sequencer = Sequencer("truck", journal.last)
        loop = Loop(sequencer, [line], journal, subscribers, Notifier({}), lambda _: None, lambda: bus.now)
        threading.Thread(target=subscriber, args=(Path(folder) / "s",), daemon=True).start()
        loop.serve()
        bus.close()


def subscriber(path: Path) -> None:
    """Hears everything and keeps nothing."""
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
        client.sendall(b'{"after": 0}\n')
        while client.recv(65536):
            pass


def mutated(chance: random.Random, recorded: list[Frame]) -> Iterator[Frame]:
    """Frames of every kind that a bus or somebody on it can make, at times that mostly go on, after the recording."""
    t = recorded[-1].t
    while True:
        t = max(0.0, t + chance.expovariate(500.0))
        if chance.random() < 1e-4:
            t = max(0.0, t + chance.choice([-1.0, 1.0]) * 100.0 * chance.random())
        frame = chance.choice(recorded)
        can_id, extended, data = frame.can_id, frame.is_extended, frame.data
        kind = chance.random()
        if kind < 0.4:  # the right one with wrong bytes
            broken = bytearray(data)
            for _ in range(chance.randrange(1, 9)):
                broken[chance.randrange(len(broken))] = chance.choice([0, 0xFF, 0xFE, 0xFB, chance.randrange(256)])
            data = bytes(broken)
        elif kind < 0.55:  # anything at all
            extended = chance.random() < 0.5
            can_id = chance.randrange(1 << (29 if extended else 11))
            data = chance.randbytes(chance.choice([0, 1, 7, 8, 12, 64, chance.randrange(65)]))
        elif kind < 0.7:  # the right one, of another length
            data = chance.randbytes(chance.randrange(65))
        elif kind < 0.8:  # a neighbour of it: another priority, another sender, a bit of it
            can_id ^= chance.choice([1 << chance.randrange(29), chance.randrange(256), chance.randrange(8) << 26])
        yield Frame(t, can_id, extended, data)


def fuzz(count: int, seed: int) -> None:
    """So many mutated frames through decoding, sampling, residuals, decision and events.

    The recording with its fault comes first: what the first diagnosis takes of memory is made then.
    """
    made = watched(load_bundle(GOLDEN / "bundle"), "truck", 1.0)
    recorded = [Frame(t, n, extended, data) for t, n, extended, data in open_log(GOLDEN / "log").relative()]
    for frame in recorded:
        list(made.hear([frame]))
        made.taken()
    frames = mutated(random.Random(seed), recorded)  # noqa: S311 no secret
    for k in range(1, count + 1):
        frame = next(frames)
        list(made.hear([frame]))
        made.taken()
        if k % 500 == 0:
            made.look(frame.t)
        if k % (count // LOOKS) == 0:
            looked(float(k))


def rate(seconds: float, foreign: int) -> None:
    """So many foreign frames a second beside the recording, in real time, with no kernel's filter before decoding."""
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with suppress(PermissionError):  # as long a queue as `faultline install` lets the service have; else the usual one
        there.setsockopt(socket.SOL_SOCKET, SO_SNDBUFFORCE, QUEUE)
    command = [sys.executable, __file__, "send", str(seconds), str(foreign), str(there.fileno())]
    bundle = load_bundle(GOLDEN / "bundle")
    with (
        SocketCan("can0", make=lambda *_: here, look=lambda _: VIRTUAL, lost=lambda _: None) as bus,
        TemporaryDirectory() as folder,
        Journal(Path(folder) / "events.sqlite", print) as journal,
        EventSocket(Path(folder) / "s") as subscribers,
    ):
        line = BusChannel("bus", bus, [watched(bundle, "truck", 1.0)], lambda _: None)
        loop = Loop(Sequencer("truck", journal.last), [line], journal, subscribers, Notifier({}), lambda _: None)
        sender = subprocess.Popen(command, pass_fds=[there.fileno()], stdout=subprocess.PIPE, text=True)

        def wait() -> None:
            sender.wait()
            time.sleep(1.0)
            signal.raise_signal(signal.SIGTERM)

        threading.Thread(target=wait, daemon=True).start()
        begin, busy = time.monotonic(), time.process_time()
        loop.serve()
        share = (time.process_time() - busy) / (time.monotonic() - begin - 1.0)
        assert sender.stdout is not None
        said = json.loads(sender.stdout.read())
    there.close()
    fresh = load_bundle(GOLDEN / "bundle").table
    for t, can_id, is_extended, data in open_log(GOLDEN / "log").relative():
        if t <= seconds - STEP_S:
            fresh.decode(can_id, is_extended, data)
    wanted, taken = (sum(table.taken.values()) for table in (fresh, bundle.table))
    print(json.dumps({**said, "wanted": wanted, "taken": taken, "share": share}), file=sys.stderr)


def send(seconds: float, foreign: int, descriptor: int) -> None:
    """The other end: sends what is due, and counts what the queue does not take."""
    frames = [frame for frame in open_log(GOLDEN / "log").relative() if frame[0] < seconds]
    stranger = CLASSIC.pack(0x123, 8, bytes(8))
    sent = {"ours": 0, "foreign": 0, "full": 0}
    with socket.socket(fileno=descriptor) as out:
        out.setblocking(False)

        def put(content: bytes, whose: str) -> None:
            try:
                out.send(content)
                sent[whose] += 1
            except BlockingIOError:
                sent["full"] += 1

        begin, k = time.monotonic(), 0
        for step in range(round(seconds / STEP_S)):
            time.sleep(max(0.0, begin + STEP_S * step - time.monotonic()))
            while k < len(frames) and frames[k][0] <= STEP_S * step:
                put(CLASSIC.pack(frames[k][1] | EFF_FLAG, len(frames[k][3]), frames[k][3]), "ours")
                k += 1
            for _ in range(round(foreign * STEP_S)):
                put(stranger, "foreign")
    print(json.dumps(sent))


if __name__ == "__main__":
    what, number, *more = sys.argv[1:]
    if what == "soak":
        soak(float(number))
    elif what == "rate":
        rate(float(number), int(more[0]))
    elif what == "send":
        send(float(number), int(more[0]), int(more[1]))
    else:
        fuzz(int(number), int(more[0]))
