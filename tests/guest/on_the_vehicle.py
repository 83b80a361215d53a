"""What is done in the guest: faultline installed, started, shown a recording, and hurt. Standard library only.

Every step writes a line to /vm/steps.jsonl; one that fails does not keep the next from being tried.
"""

import json
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

FAULTLINE = ("/opt/faultline/bin/python", "-P", "/opt/faultline/bin/faultline")
INSTALL = (*FAULTLINE, "install", "--prefix", "/opt/faultline", "--base", "/opt/python", "--interface", "vcan0")
BUNDLES = "/var/lib/faultline-bundles/uds"
INCOMING = "/var/lib/faultline-bundles/incoming"
KEYS = "/etc/faultline/keys"
EVENTS = "/run/faultline/events.sock"
TOGGLES = 20
DEAF_S = 8.0
"""Signals that do not come are told as missing after some 3 s."""
FLOOD_S = float(sys.argv[2]) if sys.argv[1:2] == ["flood"] else 10.0


def run(*words: str) -> str:
    """What a command prints; it must succeed."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}: {done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout


def property_of(name: str) -> str:
    """Of the unit."""
    return run("systemctl", "show", "faultline", "--property", name, "--value").strip()


def until(what: str, check: Callable[[], object], seconds: float = 30.0) -> float:
    """Waits for something to be so; how long that took [s]."""
    begin = time.monotonic()
    while not check():
        assert time.monotonic() - begin < seconds, f"not within {seconds:.0f} s: {what}"
        time.sleep(0.1)
    return time.monotonic() - begin


def subscribed(seconds: float) -> Iterator[dict[str, object]]:
    """What a subscriber hears that asks for everything, for so long at most."""
    end = time.monotonic() + seconds
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(EVENTS)
        client.sendall(b'{"after": 0}\n')
        rest = b""
        while (left := end - time.monotonic()) > 0:
            client.settimeout(left)
            try:
                part = client.recv(65536)
            except TimeoutError:
                return
            if not part:
                return
            *lines, rest = (rest + part).split(b"\n")
            yield from map(json.loads, lines)


def hears(seconds: float = 30.0) -> None:
    """Frames reach the service: with nothing wrong with its bus, by its own word."""
    for said in subscribed(seconds):
        if said["schema"] == "faultline.health/1":
            standing = {(each["kind"]) for each in said["conditions"]}  # type: ignore[attr-defined]
        elif said["transition"] == "started":
            standing = set()
        else:
            continue
        if not standing:
            return
    raise AssertionError(f"within {seconds:.0f} s the service has heard no traffic")


def healthy(seconds: float = 30.0) -> None:
    """The last word on its health is that all is well, for longer than a service that hears nothing takes to say so."""
    end = time.monotonic() + seconds
    while True:
        last: list[object] = []
        for said in subscribed(DEAF_S):
            if said["schema"] == "faultline.health/1":
                last = said["conditions"]  # type: ignore[assignment]
        if not last:
            return
        assert time.monotonic() < end, f"after {seconds:.0f} s: {last}"


def play(log: str) -> "subprocess.Popen[bytes]":
    """A recording onto the bus, in its own time."""
    return subprocess.Popen(["canplayer", "-I", log, "vcan0=can0"])


def traffic() -> "subprocess.Popen[bytes]":
    """The recording over and over, until it is killed: the player ends where its bus goes down."""
    again = "while :; do canplayer -I /vm/can.log vcan0=can0 2>/dev/null; sleep 0.2; done"
    return subprocess.Popen(["/bin/sh", "-c", again])


def installed() -> str:
    run(*INSTALL, "--virtual")
    run("cp", "/vm/fleet.pub", KEYS)
    said = run(*FAULTLINE, "bundle", "install", "/vm/version-0", "--into", BUNDLES, "--keys", KEYS)
    run("systemd-sysusers")
    run("systemctl", "daemon-reload")
    return said.splitlines()[-1]


def started_without_its_bus() -> str:
    begin = time.monotonic()
    run("systemctl", "start", "faultline")  # returns once the service is ready
    took = time.monotonic() - begin
    assert not Path("/sys/class/net/vcan0").exists()
    assert property_of("ActiveState") == "active"
    return f"ready after {took:.1f} s; {property_of('StatusText')}"


def exposure() -> str:
    said = run("systemd-analyze", "security", "faultline", "--no-pager")
    found = re.search(r"Overall exposure level for faultline.service: ([\d.]+)", said)
    assert found is not None, said
    assert float(found.group(1)) <= 1.1, said
    return found.group(1)


def bus_made() -> str:
    run("systemctl", "restart", "systemd-networkd")  # makes the bus, as the installed files say
    until(
        "vcan0 is up",
        lambda: Path("/sys/class/net/vcan0/operstate").exists() and "UP" in run("ip", "link", "show", "vcan0"),
    )
    time.sleep(6.0)  # the service looks for it every 5 s at least
    return "up"


def alarm_from_a_recording() -> str:
    process = play("/vm/can.log")
    for said in subscribed(90.0):
        if said.get("transition") == "occurred":
            named = {fault for each in said["diagnoses"] for fault in each["faults"]}  # type: ignore[attr-defined]
            assert "fA_du" in named, said
            assert process.wait(60) == 0
            return f"{sorted(named)} at tick {said['tick']}"
    raise AssertionError("no alarm")


def memory() -> str:
    status = Path(f"/proc/{property_of('MainPID')}/status").read_text()
    resident = int(re.search(r"VmRSS:\s+(\d+) kB", status).group(1)) / 1024  # type: ignore[union-attr]
    assert resident < 110, f"{resident:.0f} MB"
    return f"{resident:.0f} MB"


def link_toggled() -> str:
    before = property_of("MainPID")
    for _ in range(TOGGLES):
        run("ip", "link", "set", "vcan0", "down")
        run("ip", "link", "set", "vcan0", "up")
    healthy()
    assert property_of("MainPID") == before
    return f"{TOGGLES} times"


def device_removed_and_back() -> str:
    before = property_of("MainPID")
    run("ip", "link", "del", "vcan0")
    kinds: set[object] = set()
    for said in subscribed(20.0):
        if said["schema"] == "faultline.health/1":
            kinds = {each["kind"] for each in said["conditions"]}  # type: ignore[attr-defined]
            if "bus-removed" in kinds:
                break
    assert "bus-removed" in kinds, kinds
    run("ip", "link", "add", "vcan0", "type", "vcan")
    run("ip", "link", "set", "vcan0", "up")
    healthy()
    assert property_of("MainPID") == before
    return "told, and heard again"


def reloaded() -> str:
    before = property_of("MainPID")
    run("cp", "-r", "/vm/version-1", f"{INCOMING}/uds")
    run("systemctl", "start", "faultline-bundle@uds")  # tries it, takes it, and reloads the service
    healthy()
    assert property_of("MainPID") == before
    said = run("journalctl", "-u", "faultline", "-b", "--no-pager")
    assert "taken up" in said, said
    return next(line for line in said.splitlines() if "taken up" in line).partition("faultline run: ")[2]


def sent() -> int:
    """Frames onto the bus since it was made."""
    return int(Path("/sys/class/net/vcan0/statistics/tx_packets").read_text())


def computed_s() -> float:
    """The service's time on the processor [s]."""
    return int(property_of("CPUUsageNSec")) / 1e9


def flooded() -> str:
    """As many foreign frames as this machine can send, beside those that it looks for: none of its own is lost."""
    begin, before, computed = time.monotonic(), sent(), computed_s()
    time.sleep(FLOOD_S)
    calm = 100.0 * (computed_s() - computed) / (time.monotonic() - begin), (sent() - before) / FLOOD_S
    begin, before, computed = time.monotonic(), sent(), computed_s()
    words = ["timeout", f"{FLOOD_S:g}", "cangen", "vcan0", "-g", "0", "-i", "-I", "321", "-L", "8", "-D", "r"]
    subprocess.run(words, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    took = time.monotonic() - begin
    flood = 100.0 * (computed_s() - computed) / took, (sent() - before) / took
    assert flood[1] > 1000, f"{flood[1]:.0f} frames/s are no flood"
    healthy()  # it hears its own frames still
    process = property_of("MainPID")
    run("systemctl", "kill", "--signal=TERM", "faultline")  # what was lost is told at the end at the latest
    until("another process", lambda: property_of("MainPID") not in (process, "0"))
    until("ready", lambda: property_of("ActiveState") == "active")
    lost = [line for line in run("journalctl", "-u", "faultline", "-b", "--no-pager").splitlines() if "dropped" in line]
    assert not lost, lost
    return "; ".join(f"{share:.1f} % of a core at {rate:.0f} frames/s" for share, rate in (calm, flood))


def killed() -> str:
    before = property_of("MainPID")
    run("kill", "-9", before)
    took = until("another process", lambda: property_of("MainPID") not in (before, "0"))
    took += until("ready", lambda: property_of("ActiveState") == "active")
    hears()
    return f"back after {took:.1f} s"


def stopped_by_a_signal() -> str:
    before = property_of("MainPID")
    run("kill", "-STOP", before)
    took = until("another process", lambda: property_of("MainPID") not in (before, "0"), 60.0)
    took += until("ready", lambda: property_of("ActiveState") == "active")
    hears()
    return f"the watchdog had it back after {took:.1f} s"


def quiet_journal() -> str:
    lines = run("journalctl", "-u", "faultline", "-b", "--no-pager").splitlines()
    seconds = time.clock_gettime(time.CLOCK_BOOTTIME)
    ours = [line for line in lines if "faultline run: " in line]
    assert len(ours) < 60, "\n".join(ours)  # with all that was done to it: what is quiet is another test's matter
    return f"{len(ours)} lines in {seconds:.0f} s"


def steps(*done: Callable[[], str]) -> int:
    """Each, with what it says or why it failed; how many failed."""
    failed = 0
    for step in done:
        begin, passed = time.monotonic(), True
        try:
            said = step()
        except Exception as error:  # noqa: BLE001 what went wrong is the result
            passed, said = False, f"{type(error).__name__}: {error}"
        failed += not passed
        with Path("/vm/steps.jsonl").open("a") as file:
            took = round(time.monotonic() - begin, 1)
            file.write(json.dumps({"step": step.__name__, "passed": passed, "said": said, "took_s": took}) + "\n")
            file.flush()
    return failed


def installed_until_the_power_is_cut() -> str:
    """Each bundle newer than the one before; what is acknowledged is written where a cut does not reach."""
    installed()
    for turn in range(1000):
        version = min(turn, 7)
        run(*FAULTLINE, "bundle", "install", f"/vm/version-{version}", "--into", BUNDLES, "--keys", KEYS)
        with Path("/vm/installed.txt").open("a") as file:
            file.write(f"{version}\n")
            file.flush()
            os.fsync(file.fileno())
    return "nobody cut it"


def as_it_was(acknowledged: int) -> str:
    """After a power cut: the bundle in use is whole and no older than what was acknowledged, and is run."""
    run(*INSTALL)
    run("cp", "/vm/fleet.pub", KEYS)
    said = run(*FAULTLINE, "bundle", "verify", f"{BUNDLES}/current", "--keys", KEYS)
    version = json.loads(Path(f"{BUNDLES}/current/manifest.json").read_bytes())["version"]
    assert version >= acknowledged, f"version {version} is in use, {acknowledged} was installed"
    run(*FAULTLINE, "bundle", "install", "/vm/version-7", "--into", BUNDLES, "--keys", KEYS)
    run("systemd-sysusers")
    run("systemctl", "daemon-reload")
    run("systemctl", "start", "faultline")
    return f"{said.splitlines()[-1]}; version {acknowledged} was acknowledged"


def everything() -> int:
    """All that is done to a service in one life of the machine."""
    failed = steps(installed, started_without_its_bus, exposure, bus_made, alarm_from_a_recording, memory)
    process = traffic()
    failed += steps(
        link_toggled, device_removed_and_back, reloaded, flooded, killed, stopped_by_a_signal, quiet_journal
    )
    process.kill()
    return failed


def main() -> int:
    what, *more = sys.argv[1:]
    if what == "install":
        return steps(installed_until_the_power_is_cut)
    if what == "flood":
        failed = steps(installed, started_without_its_bus, bus_made)
        process = traffic()
        failed += steps(flooded)
        process.kill()
        return failed
    if what == "after":
        (acknowledged,) = map(int, more)

        def after_the_cut() -> str:
            return as_it_was(acknowledged)

        return steps(after_the_cut)
    return everything()


if __name__ == "__main__":
    sys.exit(main())
