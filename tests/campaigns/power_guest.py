"""What is done in the guest whose power is cut: the daemon and its outputs as installed, and a subscriber of each kind.

Each writes what it heard where a cut does not reach, before it goes on: the broker, before it acknowledges. Standard
library only; beside it in /vm lie on_the_vehicle.py and mqtt_fake_broker.py.
"""

import json
import os
import shutil
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

from mqtt_fake_broker import FakeBroker, Published
from on_the_vehicle import BUNDLES, EVENTS, FAULTLINE, INSTALL, KEYS, run, until

SHARE = Path("/vm")
CONTROL = "/run/faultline/control.sock"
STORE = Path("/var/lib/private/faultline/events.sqlite")
HTTP = 8080
READY_S, CAUGHT_UP_S, STILL_S = 180.0, 180.0, 8.0


class Heard:
    """What a subscriber heard, in a file that a cut does not reach; the host takes off a line that a cut has torn."""

    def __init__(self, kind: str) -> None:
        self._path = SHARE / f"heard-{kind}.jsonl"
        self.last_id, self.last_seq = "", 0
        for line in self._path.read_bytes().splitlines() if self._path.exists() else ():
            self._note(line)

    def take(self, line: bytes) -> None:
        with self._path.open("ab") as file:
            file.write(line + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self._note(line)

    def _note(self, line: bytes) -> None:
        said = json.loads(line)
        record = said.get("data", said)  # of a CloudEvent
        if record["seq"] >= self.last_seq:  # else one that has come twice
            self.last_id, self.last_seq = record["id"], record["seq"]


def of_socket(heard: Heard) -> None:
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(EVENTS)
        client.sendall(json.dumps({"after": heard.last_id or 0}).encode() + b"\n")
        with client.makefile("rb") as lines:
            for line in lines:
                if line.endswith(b"\n"):
                    heard.take(line[:-1])


def of_http(heard: Heard) -> None:
    with socket.create_connection(("127.0.0.1", HTTP), 10.0) as client:
        client.settimeout(None)
        path = "/v1/events" if heard.last_id else "/v1/events?after=0"
        resume = f"Last-Event-ID: {heard.last_id}\r\n" if heard.last_id else ""
        client.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{HTTP}\r\n{resume}\r\n".encode())
        with client.makefile("rb") as lines:
            status = lines.readline()
            if b" 200 " not in status:
                raise OSError(f"answered {status!r}")
            for line in lines:
                if line.startswith(b"data: ") and line.endswith(b"\n"):
                    heard.take(line[6:].rstrip(b"\r\n"))


def subscribe() -> tuple[dict[str, Heard], FakeBroker]:
    """One of each kind, from where its file ends; and the broker of the third, outside of the vehicle."""
    heard = {kind: Heard(kind) for kind in ("socket", "sse", "mqtt")}

    def taken(one: Published) -> int:
        if one.topic.endswith("/events"):
            heard["mqtt"].take(one.payload)
        return 0  # acknowledged after that

    for listen, kind in ((of_socket, "socket"), (of_http, "sse")):

        def again(listen=listen, kind=kind) -> None:  # type: ignore[no-untyped-def]
            while True:
                with suppress(OSError):  # not there, or gone again
                    listen(heard[kind])
                time.sleep(0.1)

        threading.Thread(target=again, daemon=True).start()
    return heard, FakeBroker(taken)


def installed(broker: int, speed: str) -> None:
    """As on a vehicle; the daemon is told how fast its bus runs, and has the processor that this takes."""
    run(*INSTALL, "--virtual")
    run("cp", "/vm/fleet.pub", KEYS)
    if not Path(BUNDLES, "current").exists():
        run(*FAULTLINE, "bundle", "install", "/vm/version-0", "--into", BUNDLES, "--keys", KEYS)
    command = f"{' '.join(FAULTLINE)} run --config /etc/faultline/faultline.toml --speed {speed}"
    for unit, more in (
        ("", f"ExecStart=\nExecStart={command}\nCPUQuota=\nWatchdogSec=60s\n"),
        ("-mqtt", ""),
        ("-web", ""),
    ):
        dropin = Path(f"/etc/systemd/system/faultline{unit}.service.d/guest.conf")
        dropin.parent.mkdir(parents=True, exist_ok=True)
        # The Python that the guest borrows may look for its library in a home, which the units hide: another is found.
        dropin.write_text(f"[Service]\nEnvironment=LD_LIBRARY_PATH=/opt/python/lib\n{more}")
    config = Path("/etc/faultline/mqtt.toml")
    config.write_text(config.read_text().replace('host = "localhost"', f'host = "127.0.0.1"\nport = {broker}\n#'))
    config = Path("/etc/faultline/faultline.toml")
    config.write_text('source = "truck-17"\n' + config.read_text())
    run("ip", "link", "set", "lo", "up")
    run("systemd-sysusers")
    run("systemctl", "daemon-reload")
    run("systemctl", "restart", "systemd-networkd")  # makes the bus
    until("vcan0 is there", lambda: Path("/sys/class/net/vcan0").exists())


def started() -> None:
    """By systemd, all three at once: it waits until each says that it is ready."""
    units = ("faultline", "faultline-mqtt", "faultline-web")
    begin = time.monotonic()
    done = subprocess.run(["systemctl", "start", *units], capture_output=True, text=True, check=False)
    said = run("journalctl", "-b", "--no-pager", "-o", "cat", "-n", "60") if done.returncode else ""
    assert done.returncode == 0, done.stderr + said
    print(f"started within {time.monotonic() - begin:.1f} s", flush=True)


def asked(question: str) -> dict[str, object]:
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(20.0)
        client.connect(CONTROL)
        client.sendall(json.dumps({"ask": question}).encode() + b"\n")
        with client.makefile("rb") as lines:
            answer: dict[str, object] = json.loads(lines.readline())
    return answer


def caught_up(heard: dict[str, Heard]) -> None:
    """Nothing is told any more, and everybody has heard all."""
    end, last, since = time.monotonic() + CAUGHT_UP_S, -1, time.monotonic()
    while time.monotonic() - since < STILL_S or any(each.last_seq != last for each in heard.values()):
        seq = int(str(asked("faults")["seq"]))
        if seq != last:
            last, since = seq, time.monotonic()
        if time.monotonic() > end:  # the host says what is missing
            print(f"not caught up with {last}: { ({kind: each.last_seq for kind, each in heard.items()}) }", flush=True)
            return
        time.sleep(0.2)
    print(f"all have caught up with {last}", flush=True)


def dumped() -> None:
    """What is remembered by the daemon's word, and what is in its store by SQLite's, after it has ended."""
    (SHARE / "faults.json").write_text(json.dumps(asked("faults")))
    run("systemctl", "stop", "faultline")
    time.sleep(2.0)  # what it told last reaches who is there
    (SHARE / "aside.json").write_text(json.dumps([each.name for each in STORE.parent.glob("*.damaged-*")]))
    copy = Path("/run/copy.sqlite")
    for suffix in ("", "-wal"):
        if (path := STORE.with_name(STORE.name + suffix)).exists():
            shutil.copy(path, copy.with_name(copy.name + suffix))
    with sqlite3.connect(copy) as db:
        lines = [bytes(line) for (line,) in db.execute("SELECT line FROM record ORDER BY seq")]
        sound = db.execute("PRAGMA integrity_check").fetchone()[0]
    assert sound == "ok", sound
    (SHARE / "store.jsonl").write_bytes(b"".join(lines))


def main() -> int:
    what, speed = sys.argv[1:]
    heard, broker = subscribe()
    installed(broker.port, speed)
    started()
    if what == "cut":
        player = ["canplayer", "-I", "/vm/fast.log", "-l", "i", "vcan0=can0"]
        subprocess.Popen(player, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    (SHARE / "ready").write_text("")
    if what == "cut":
        time.sleep(3600.0)  # until the power is cut
        return 1
    caught_up(heard)
    dumped()
    return 0


if __name__ == "__main__":
    sys.exit(main())
