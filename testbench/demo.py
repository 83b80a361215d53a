"""The main job end to end: record, ingest, calibrate, tune, export, listen, replay, isolate."""

import argparse
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from faultline.options import Parser
from faultline.testbench.promise import RECORDINGS, Recording, Verdict, problems, sentence
from faultline.writing import check_folder, write_file

EXAMPLE = """example:
  faultline demo --out out/demo

It needs no root and no network. It exits with 1 unless both faults are isolated as the structure of the model promises.
"""

SPEED = 20
MULTICAST = "udp_multicast:239.74.163.2"  # stays on this machine: its hop limit is 0
PROBE_S = 0.2
READY_S = 20.0
MARKER = ".faultline-demo"
"""A file by which the demo knows a folder of its own, the only kind it replaces."""

TRIES = 3
LATEST_S = 0.2
"""Log time [s] that a replayed frame may be late: a machine too busy for the speed shows its own stalls, not faults."""


class DemoError(Exception):
    """A step of the demo failed; the message says which."""


def main(argv: list[str]) -> int:
    """Runs the demo; returns 0 where everything was isolated as promised, 1 where not."""
    parser = Parser(
        "faultline demo", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/demo"), help="where everything goes; an earlier demo's is replaced"
    )
    parser.add_argument("--speed", type=float, default=SPEED, help="replay this many times faster than real time")
    options = parser.parse_args(argv)
    if not 0 < options.speed < float("inf"):
        parser.error("--speed must be a number above zero")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # the processes it started end with it
    started = time.monotonic()
    try:
        _make_room(options.out)
        good = Demo(options.out, options.speed).run()
    except DemoError as error:
        print(f"faultline demo: error: {error}", file=sys.stderr)
        return 2
    print(f"\n{time.monotonic() - started:.0f} s in all; everything is in {options.out}")
    return 0 if good else 1


def _make_room(out: Path) -> None:
    """Replaces an earlier demo's folder, and nothing else; raises `DemoError` where something else is in the way."""
    if out.is_symlink() or (out.exists() and not (out / MARKER).is_file()):
        raise DemoError(f"{out} exists and is no demo's folder; name another with --out, or remove it")
    if Path.cwd().is_relative_to(out.resolve()):
        raise DemoError(f"{out} is the folder you are in, or above it; name another with --out")
    check_folder(out)
    if out.exists():
        shutil.rmtree(out)
    write_file(out / MARKER, "")


class Demo:
    """The steps, each a `faultline` command in a process of its own."""

    def __init__(self, out: Path, speed: float) -> None:
        self._out = out
        self._speed = speed
        self._start = time.monotonic()
        self._logs: dict[Recording, Path] = {}

    def run(self) -> bool:
        """All steps; whether the faults were isolated as promised."""
        print("faultline demo: all recordings are simulated by the test rig, none is of a real vehicle")
        self._record()
        self._bundle()
        bus = self._bus()
        verdicts = []
        for recording in RECORDINGS:
            if recording.fault:
                verdicts.append(self._live(recording, bus))
            elif recording.purpose == "evaluate":
                verdicts.append(self._judge(recording, None))
        return self._summary(verdicts)

    def _record(self) -> None:
        self._step(f"the rig records {len(RECORDINGS)} runs, `ingest` joins CAN log and second logger (two at a time)")
        with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
            for recording, (log, told) in zip(RECORDINGS, pool.map(self._one, RECORDINGS), strict=True):
                self._logs[recording] = log
                print(f"   {recording.purpose:<10}{log.name}: {told}")

    def _one(self, recording: Recording) -> tuple[Path, str]:
        bench, truth = self._out / "bench", self._out / "truth"
        self._call("rig", "record", *recording.arguments, "--out", bench, "--truth", truth)
        told = self._call("ingest", bench / recording.name, "--out", self._out / "logs")
        return self._out / "logs" / recording.name, told.strip().splitlines()[-1].strip()

    def _bundle(self) -> None:
        calibrated, tuning, bundle = self._out / "calibrated.toml", self._out / "tuning.json", self._out / "bundle"
        [calibrate] = self._of("calibrate")
        found = json.loads(self._call("structure", "uds", "--json", "-"))
        tests = [test for test in found["tests"] if test.get("residual")]
        self._step(f"structure: {len(found['mtes'])} tests in the thesis's model, {len(tests)} with integral causality")
        for test in tests:
            print(f"   {test['name']} predicts {test['predicts']}, sensitive to {', '.join(test['faults'])}")
        self._step("calibrate: the thesis's four-state model is fitted to one fault-free run")
        self._show(self._call("calibrate", "uds", calibrate, "--out", calibrated, show=True))
        self._step("tune: thresholds and ranking evidence from other fault-free runs")
        self._show(self._call("tune", calibrated, *self._of("tune"), "--out", tuning, show=True))
        self._step("export: ten tests with integral causality as one ONNX graph in one bundle")
        dbc = calibrate / "uds.dbc"
        self._show(self._call("export", calibrated, "--tuning", tuning, "--dbc", dbc, "--out", bundle))

    def _bus(self) -> str:
        if Path("/sys/class/net/vcan0").exists() and hasattr(socket, "AF_CAN"):
            self._step("bus: socketcan:vcan0, the kernel's virtual CAN")
            return "socketcan:vcan0"
        bus = f"{MULTICAST}:{_free_port()}"
        self._step(f"bus: {bus} on this machine only, because the kernel has no vcan0")
        return bus

    def _live(self, recording: Recording, bus: str) -> Verdict:
        """The recording over the bus, again and slower where this machine was too busy to keep its time."""
        log = self._logs[recording]
        speed = self._speed
        for _ in range(TRIES):
            minutes = recording.duration / 60
            self._step(f"live: {log.name}, {minutes:g} min at {speed:g}x; `watch` prints the alarms as they come")
            late = self._play(log, bus, speed)
            if late <= LATEST_S:
                return self._judge(recording, self._out / f"{log.name}.events.jsonl")
            print(f"   not counted: this machine was too busy, a frame came {late:.1f} s of log time late")
            speed /= 2
        raise DemoError(
            f"{log.name}: a frame was more than {LATEST_S:g} s of log time late {TRIES} times; stop what else runs here"
        )

    def _play(self, log: Path, bus: str, speed: float) -> float:
        """The daemon listens, subscribers watch, the log is replayed; the log time [s] its latest frame was late."""
        where = self._out / "events.sock"
        run = ("run", "--bundle", self._out / "bundle", "--bus", bus, "--socket", where, "--source", log.name)
        watch = ("watch", "--socket", where, "--wait", READY_S, "--after", 0)
        words = self._out / f"{log.name}.daemon.log"
        with (self._out / f"{log.name}.events.jsonl").open("wb") as told, words.open("wb") as errors:
            daemon = self._spawn(*run, "--speed", speed, stdout=subprocess.DEVNULL, stderr=errors)
            started = [
                daemon,
                self._spawn(*watch, "--bundle", self._out / "bundle"),
                self._spawn(*watch, "--json", stdout=told),
            ]
            try:
                self._ready(where, daemon, words)
                played = json.loads(self._call("replay", log, "--bus", bus, "--speed", speed, "--json", show=True))
                time.sleep(1.0)  # what was sent last is still on its way
            finally:
                daemon.send_signal(signal.SIGTERM)
                codes = [_end(process) for process in started]
        if any(codes):
            raise DemoError(f"daemon and subscribers exited with {codes}, not with 0; see {words}")
        self._show("\n".join(words.read_text().splitlines()[1:]))  # the first line says that it was ready
        return float(played["worst_s"]) * speed

    def _judge(self, recording: Recording, events: Path | None) -> Verdict:
        log = self._logs[recording]
        arguments = [self._out / "bundle", log, "--truth", self._out / "truth" / f"{log.name}.toml"]
        picture = self._out / f"{recording.fault or 'fault-free'}.png"
        more = ["--events", events] if events else []
        told = self._call("evaluate", *arguments, *more, "--picture", picture, "--json", accept=(0, 1))
        return Verdict(**json.loads(told))

    def _summary(self, verdicts: Iterable[Verdict]) -> bool:
        self._step("summary, against truth.toml")
        good = True
        for verdict in verdicts:
            wrong = problems(verdict)
            good = good and not wrong
            print(f"   {sentence(verdict)}: {'NOT as promised, ' + '; '.join(wrong) if wrong else 'as promised'}")
        for picture in sorted(self._out.glob("*.png")):
            print(f"   picture: {picture}")
        return good

    def _of(self, purpose: str) -> list[Path]:
        return [log for recording, log in self._logs.items() if recording.purpose == purpose]

    def _step(self, text: str) -> None:
        print(f"[{time.monotonic() - self._start:5.1f} s] {text}", flush=True)

    def _show(self, text: str) -> None:
        for line in text.strip().splitlines():
            print(f"   {line}", flush=True)

    def _call(self, *arguments: object, accept: Sequence[int] = (0,), show: bool = False) -> str:
        """A command's standard output; raises `DemoError` with its last words where it fails.

        With `show` its progress and its errors appear on the terminal as they come.
        """
        errors = None if show else subprocess.PIPE
        done = subprocess.run(_command(arguments), stdout=subprocess.PIPE, stderr=errors, text=True, check=False)
        if done.returncode not in accept:
            words = (done.stderr or "see above").strip().splitlines()
            raise DemoError(f"faultline {' '.join(map(str, arguments))} exited with {done.returncode}: {words[-1]}")
        return done.stdout

    def _spawn(self, *arguments: object, **options: object) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(_command(arguments), **options)  # type: ignore[call-overload, no-any-return]

    def _ready(self, where: Path, daemon: "subprocess.Popen[bytes]", words: Path) -> None:
        for _ in range(round(READY_S / PROBE_S)):
            if where.exists():
                time.sleep(3 * PROBE_S)  # the watchers connect
                return
            if daemon.poll() is not None:
                raise DemoError(f"the daemon ended with {daemon.returncode}: {words.read_text().strip()}")
            time.sleep(PROBE_S)
        raise DemoError(f"the daemon was not ready in {READY_S:g} s")


def _end(process: "subprocess.Popen[bytes]") -> int:
    """The exit code of a process that should be at its end."""
    try:
        return process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def _command(arguments: Iterable[object]) -> list[str]:
    return [str(Path(sys.executable).with_name("faultline")), *map(str, arguments)]


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
