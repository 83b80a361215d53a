"""What is done in the guest: faultline installed, started, shown a recording, and hurt. Standard library only.

Every step writes a line to /vm/steps.jsonl; one that fails does not keep the next from being tried.
"""

import json
import os
import re
import socket
import subprocess
import sys
import threading
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
FLOOD_S = float(sys.argv[2]) if sys.argv[1:2] == ["flood"] else 6.0


def run(*words: str) -> str:
    """What a command prints; it must succeed."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}: {done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout


def property_of(name: str) -> str:
    """Of the unit."""
    return run("systemctl", "show", "faultline", "--property", name, "--value").strip()


def until(what: str, check: Callable[[], object], seconds: float = 120.0) -> float:
    """Waits for something to be so; how long that took [s]."""
    begin = time.monotonic()
    while not check():
        assert time.monotonic() - begin < seconds, f"not within {seconds:.0f} s: {what}"
        time.sleep(0.1)
    return time.monotonic() - begin


def lines(seconds: float, after: int = 0) -> Iterator[bytes]:
    """The lines that a subscriber hears that asks for all after this number, for so long at most."""
    end = time.monotonic() + seconds
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(EVENTS)
        client.sendall(b'{"after": %d}\n' % after)
        rest = b""
        while (left := end - time.monotonic()) > 0:
            client.settimeout(left)
            try:
                part = client.recv(65536)
            except TimeoutError:
                return
            if not part:
                return
            *whole, rest = (rest + part).split(b"\n")
            yield from whole


def subscribed(seconds: float, after: int = 0) -> Iterator[dict[str, object]]:
    """The same, read."""
    return map(json.loads, lines(seconds, after))


def told() -> list[bytes]:
    """All that is held, of earlier runs too."""
    return [*lines(2.0)]


def last() -> int:
    """Number of the last thing that was told."""
    seen = told()
    return int(json.loads(seen[-1])["seq"]) if seen else 0


def hears(after: int, seconds: float = 120.0) -> None:
    """Frames reach the service: with nothing wrong with its bus, by its own word after this number."""
    for said in subscribed(seconds, after):
        if said["schema"] == "faultline.health/1":
            standing = {(each["kind"]) for each in said["conditions"]}  # type: ignore[attr-defined]
        elif said.get("transition") == "started":
            standing = set()
        else:
            continue
        if not standing:
            return
    raise AssertionError(f"within {seconds:.0f} s the service has heard no traffic")


def healthy(seconds: float = 120.0) -> None:
    """The last word on its health is that all is well, for longer than a service that hears nothing takes to say so.

    A frame that a busy machine sends late or early is reported for 20 s: a wait must outlast a few of them.
    """
    end = time.monotonic() + seconds
    while True:
        standing: list[object] = []
        for said in subscribed(DEAF_S):
            if said["schema"] == "faultline.health/1":
                standing = said["conditions"]  # type: ignore[assignment]
        if not standing:
            return
        assert time.monotonic() < end, f"after {seconds:.0f} s: {standing}"


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


def one_python() -> str:
    """The unit's libpython is of the same build as its interpreter: /root, where a RUNPATH may point, is hidden."""
    maps = Path(f"/proc/{property_of('MainPID')}/maps").read_text()
    libraries = {line.split()[-1] for line in maps.splitlines() if "libpython" in line}
    assert all(each.startswith("/opt/python/lib/") for each in libraries), libraries
    return ", ".join(libraries) or "linked statically"


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
    process, seen = play("/vm/can.log"), []
    for said in subscribed(180.0):
        if said.get("transition") == "occurred":
            named = {fault for each in said["diagnoses"] for fault in each["faults"]}  # type: ignore[attr-defined]
            assert "fA_du" in named, said
            process.kill()  # what follows plays recordings of its own
            process.wait()
            return f"{sorted(named)} at tick {said['tick']}"
        seen.append({key: said[key] for key in ("tick", "transition", "conditions", "fired") if key in said})
    raise AssertionError(f"no alarm, player {process.poll()}: {seen}")


def asked(*words: str) -> dict[str, object]:
    """The answer of `faultline faults`."""
    done = subprocess.run([*FAULTLINE, "faults", *words], capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stderr
    answer: dict[str, object] = json.loads(done.stdout)
    return answer


def faults() -> list[dict[str, object]]:
    """What is remembered."""
    found: list[dict[str, object]] = asked("list", "--json")["faults"]  # type: ignore[assignment]
    return found


def remembered() -> str:
    """The fault, its freeze frame, and the entry in the system's journal."""
    (fault,) = faults()
    assert fault["status"]["test_failed"], fault  # type: ignore[index]
    frame = asked("show", str(fault["number"]), "--json")["frames"]["first"]  # type: ignore[index]
    assert frame["alarm"], frame
    assert len(frame["inputs"]) == 5, frame
    entries = run(
        "journalctl", "-t", "faultline", "FAULTLINE_CHANGE=confirmed", "-o", "json", "--no-pager"
    ).splitlines()
    assert [json.loads(entry)["FAULTLINE_NUMBER"] for entry in entries] == [str(fault["number"])], entries
    return f"{fault['components']}, {fault['dtcs']}, {json.loads(entries[0])['MESSAGE']}"


def told_on_the_bus() -> str:
    """DM1, by a unit of its own, as the kernel's J1939 protocol receives it."""
    run("modprobe", "can-j1939")
    config = Path("/etc/faultline/j1939.toml")
    config.write_text(config.read_text().replace("transmit = false", "transmit = true"))
    exposure = run("systemd-analyze", "security", "--no-pager", "faultline-j1939").splitlines()[-1]
    with socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_J1939) as network:
        network.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        network.bind(("vcan0", socket.J1939_NO_NAME, 0xFECA, socket.J1939_NO_ADDR))
        network.settimeout(30.0)
        run("systemctl", "start", "faultline-j1939")
        try:
            content, (_, _, group, address) = network.recvfrom(1785)
        except TimeoutError as error:
            said = run("journalctl", "-u", "faultline-j1939", "-b", "--no-pager", "-o", "cat")
            raise AssertionError(f"nothing was heard: {said}") from error
    run("systemctl", "stop", "faultline-j1939")
    assert (group, address) == (0xFECA, 144), (group, address)
    codes = {
        (content[k] | content[k + 1] << 8 | content[k + 2] >> 5 << 16, content[k + 2] & 31)
        for k in range(2, len(content) - 3, 4)
    }
    (fault,) = faults()
    assert codes >= {(each["spn"], each["fmi"]) for each in fault["dtcs"]}, (content, fault)  # type: ignore[attr-defined]
    assert content[0] == 0xC4, content  # amber; the lamp of emission faults is not ours
    return f"{content.hex()}; {exposure}"


def erased() -> str:
    """By root, who is so for the service too, though it runs among users of its own."""
    number = str(faults()[0]["number"])
    assert run(*FAULTLINE, "faults", "clear", number) == f"erased: {number}\n"
    assert number not in [str(each["number"]) for each in faults()]
    other = ["setpriv", "--reuid", "nobody", "--regid", "faultline-events", "--clear-groups"]
    done = subprocess.run([*other, *FAULTLINE, "faults", "clear", "--all"], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stdout
    assert "may not erase faults" in done.stderr, done.stderr
    return done.stderr.strip()


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
    before, seen = property_of("MainPID"), last()
    run("ip", "link", "del", "vcan0")
    kinds: set[object] = set()
    for said in subscribed(20.0, seen):
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
    process = property_of("MainPID")
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
    assert property_of("MainPID") == process, "another process"
    run("systemctl", "kill", "--signal=TERM", "faultline")  # what was lost is told at the end at the latest
    until("another process", lambda: property_of("MainPID") not in (process, "0"))
    until("ready", lambda: property_of("ActiveState") == "active")
    lost = [line for line in run("journalctl", "-u", "faultline", "-b", "--no-pager").splitlines() if "dropped" in line]
    assert not lost, lost
    return "; ".join(f"{share:.1f} % of a core at {rate:.0f} frames/s" for share, rate in (calm, flood))


def flooded_with_its_own() -> str:
    """Frames that its filter lets through, random: of another sender of its groups, then of the very sender."""
    process, seen = property_of("MainPID"), last()
    for identifier in ("18FF2000", "18FF20F9"):
        words = ["timeout", "3", "cangen", "vcan0", "-g", "0", "-i", "-e", "-I", identifier, "-L", "8", "-D", "r"]
        before, begin = sent(), time.monotonic()
        subprocess.run(words, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        rate = (sent() - before) / (time.monotonic() - begin)
        assert rate > 500, f"{rate:.0f} frames/s are no flood"
    memory()
    healthy(150.0)
    assert property_of("MainPID") == process, "another process"
    after = [*subscribed(3.0, seen)]
    kinds = {each["kind"] for said in after for each in said.get("conditions", [])}  # type: ignore[attr-defined]
    assert kinds & {"second-sender", "frames-lost"}, kinds
    assert "occurred" not in {said.get("transition") for said in after}, after
    return f"{rate:.0f} frames/s; told: {', '.join(sorted(kinds))}"


def killed() -> str:
    before, seen, known = property_of("MainPID"), told(), faults()
    run("kill", "-9", before)
    took = until("another process", lambda: property_of("MainPID") not in (before, "0"))
    took += until("ready", lambda: property_of("ActiveState") == "active")
    hears(int(json.loads(seen[-1])["seq"]))
    assert told()[: len(seen)] == seen, "what was told before is not all there"
    assert [each["number"] for each in faults()][: len(known)] == [each["number"] for each in known], "forgotten"
    return f"back after {took:.1f} s, with {len(seen)} that were told before"


def stopped_by_a_signal() -> str:
    before, seen = property_of("MainPID"), last()
    run("kill", "-STOP", before)
    took = until("another process", lambda: property_of("MainPID") not in (before, "0"), 60.0)
    took += until("ready", lambda: property_of("ActiveState") == "active")
    hears(seen)
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


def until_the_power_is_cut() -> str:
    """Bundles are installed, each newer than the one before, while a bus that comes and goes makes events.

    What is acknowledged, and what a subscriber has seen, is written where a cut does not reach.
    """
    process = traffic()
    toggle = "while :; do ip link set vcan0 down; sleep 3; ip link set vcan0 up; sleep 12.5; done"
    subprocess.Popen(["/bin/sh", "-c", toggle])
    threading.Thread(target=_seen, daemon=True).start()
    for turn in range(1000):
        version = min(turn, 7)
        run(*FAULTLINE, "bundle", "install", f"/vm/version-{version}", "--into", BUNDLES, "--keys", KEYS)
        _written("/vm/installed.txt", b"%d\n" % version)
    process.kill()
    return "nobody cut it"


def _seen() -> None:
    for line in lines(600.0):
        _written("/vm/seen.jsonl", line + b"\n")


def _written(path: str, content: bytes) -> None:
    with Path(path).open("ab") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


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


def all_that_was_seen() -> str:
    """After a power cut: every line that the subscriber has seen is there, byte for byte, and the numbers go on."""
    seen = Path("/vm/seen.jsonl").read_bytes().splitlines()
    held = told()
    assert held[: len(seen)] == seen, f"{len(seen)} were seen, and of them {len(set(seen) & set(held))} are there"
    numbers = [json.loads(line)["seq"] for line in held]
    assert numbers == [*range(1, len(held) + 1)], numbers
    return f"{len(seen)} were seen, all are there"


def everything() -> int:
    """All that is done to a service in one life of the machine."""
    failed = steps(installed, started_without_its_bus, one_python, exposure, bus_made, alarm_from_a_recording, memory)
    failed += steps(remembered, told_on_the_bus)
    process = traffic()
    failed += steps(
        link_toggled,
        device_removed_and_back,
        reloaded,
        flooded,
        flooded_with_its_own,
        killed,
        erased,
        stopped_by_a_signal,
        quiet_journal,
    )
    process.kill()
    return failed


def main() -> int:
    what, *more = sys.argv[1:]
    if what == "flood":
        failed = steps(installed, started_without_its_bus, bus_made)
        process = traffic()
        failed += steps(flooded)
        process.kill()
        return failed
    if what == "steps":  # by name, to look at some alone
        return steps(*(globals()[name] for name in more))
    if what == "cut":
        failed = steps(installed, started_without_its_bus, bus_made)
        return failed or steps(until_the_power_is_cut)
    if what == "after":
        (acknowledged,) = map(int, more)

        def after_the_cut() -> str:
            return as_it_was(acknowledged)

        return steps(after_the_cut, all_that_was_seen)
    return everything()


if __name__ == "__main__":
    sys.exit(main())
