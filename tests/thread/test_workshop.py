"""The workshop's test of recorded cycles: every tick of the log, and what a running service sends of it."""

import json
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest
from ports import multicast

from faultline.service.bundle.load import load_bundle
from faultline.service.core.decision.decision import Decision
from faultline.service.core.memory.freeze import Sample
from faultline.service.core.monitor import Monitor
from faultline.service.core.residuals.observer import Tick as Observed
from faultline.service.daemon.views import description, live_tick
from faultline.service.logs import open_log
from faultline.service.protocol.live import LiveTick, SystemDescription
from faultline.service.workshop.cycle import Cycle
from faultline.service.workshop.plan import plan
from faultline.service.workshop.result import Result
from faultline.service.workshop.verdict import Seen, Verdict, judge

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FAULTLINE = str(Path(sys.executable).with_name("faultline"))
FAULT = ("--fault", "fA_du", "--size", "0.65", "--onset")
SPEED = 5.0
HOLD_S = 5.0


def recorded(folder: Path, dwell_s: int, *fault: str) -> Path:
    """A recording of a cycle as the workshop asks for: every mode for `dwell_s` [s], twice, and 35 s of idle before."""
    duties = [(35, 0.0), *((dwell_s, duty) for duty in (0.0, 0.5, 1.0, 0.0, 0.5, 1.0, 0.0))]
    segments = "".join(
        f"[[segment]]\nduration_s = {seconds}.0\nsetpoint_bar = 10.0\nduty = {duty}\n" for seconds, duty in duties
    )
    (folder / "workshop.toml").write_text(f'schema = 1\nname = "workshop"\n{segments}')
    record = [FAULTLINE, "rig", "record", "--cycle", str(folder / "workshop.toml"), "--duration", f"{75 + 7 * dwell_s}"]
    places = ["--kind", "instrumented", "--out", str(folder / "logs"), "--truth", str(folder / "truth")]
    subprocess.run([*record, "--seed", "11", *fault, "--id", "cycle", *places], check=True)
    return folder / "logs" / "cycle"


def followed(path: Path) -> tuple[Cycle, Verdict]:
    """What every tick of the log says, as the control socket would send it."""
    bundle = load_bundle(GOLDEN / "bundle")
    here: Any = SimpleNamespace(name="uds", bundle=bundle, recorder=SimpleNamespace(latest=None))
    system = msgspec.convert(json.loads(msgspec.json.encode(description(here))), SystemDescription)
    cycle = Cycle(system, plan(system.steady, 60.0), 600.0)

    def watch(tick: Observed, decision: Decision) -> None:
        here.recorder.latest = Sample.of(tick, decision)
        if cycle.ended is None:
            sent = cast("tuple[int, bytes]", live_tick(here, -1))
            cycle.take(msgspec.json.decode(sent[1], type=LiveTick))

    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, "truck", bundle.id, watch)
    for _ in monitor.log(open_log(path).relative()):
        pass
    assert cycle.ended == "complete", cycle.progress.seconds
    return cycle, judge(cycle, "complete", Seen([], []))


def test_a_whole_cycle_without_a_fault(tmp_path: Path) -> None:
    cycle, verdict = followed(recorded(tmp_path, 75))
    assert (verdict.kind, verdict.candidates) == ("no-fault", [])
    assert cycle.elapsed_s < 600.0


def test_a_whole_cycle_with_a_clogged_filter(tmp_path: Path) -> None:
    _, verdict = followed(recorded(tmp_path, 75, *FAULT, "150"))
    assert (verdict.kind, verdict.present) == ("fault", True)
    assert verdict.candidates[0].faults[0].component == "dosing unit filter"


@pytest.mark.waits
def test_beside_a_running_service(tmp_path: Path) -> None:
    """A large fault is told however late frames come; whether every step was done in time is not asked here."""
    log, bus, control = recorded(tmp_path, 25, *FAULT, "70"), multicast(), tmp_path / "control"
    sockets = ["--socket", str(tmp_path / "events"), "--control", str(control)]
    run = [FAULTLINE, "run", "--bundle", str(GOLDEN / "bundle"), "--bus", bus, "--speed", str(SPEED)]
    workshop = [FAULTLINE, "workshop", "--control", str(control), "--report", str(tmp_path / "report.html"), "--json"]
    times = ["--hold", str(HOLD_S), "--patience", "120"]
    with (tmp_path / "service").open("wb") as out:
        service = subprocess.Popen([*run, *sockets, "--source", "truck"], stdout=out, stderr=out)
    replay = None
    try:
        end = time.monotonic() + 60.0
        while not control.exists():
            assert service.poll() is None, (tmp_path / "service").read_text()
            assert time.monotonic() < end
            time.sleep(0.05)
        replay = subprocess.Popen(
            [FAULTLINE, "replay", str(log), "--bus", bus, "--speed", str(SPEED)], stderr=subprocess.DEVNULL
        )
        done = subprocess.run([*workshop, *times], capture_output=True, check=False, timeout=500)
    finally:
        for process in (replay, service):
            if process is not None:
                process.terminate()
                process.wait(30)
    assert done.returncode == 1, done.stderr.decode()
    found = msgspec.json.decode(done.stdout, type=Result)
    assert (found.verdict.kind, found.source) == ("fault", "truck")
    assert "fA_du" in {fault.name for each in found.verdict.candidates for fault in each.faults}
    assert [each.during_test for each in found.remembered] == [True]
    assert found.steps[0].done
    assert "<svg" in (tmp_path / "report.html").read_text()
