"""Live on a bus: the same frames as in a recording, each at its time, however fast; and what can go wrong."""

import re
import signal
import socket
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import can
import pytest

from faultline.service.bus import open_bus
from faultline.testbench.bus import load_dbc
from faultline.testbench.command import main
from faultline.testbench.cycles import CYCLES
from faultline.testbench.live_bus import on_bus
from faultline.testbench.play import live, play
from faultline.testbench.request import Request
from faultline.testbench.simulation import simulate
from faultline.testbench.traffic import Frame, frames
from faultline.testbench.vehicles import VEHICLES

SHORT = ["play", "--cycle", "drive", "--duration", "60"]
GROUP = "udp_multicast:239.74.163.2"


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


@dataclass
class Clock:
    """Time that passes only in sleep, and by `work` [s] for each frame sent."""

    work: float = 0.0
    now: float = 100.0
    sent: list[tuple[float, Frame]] = field(default_factory=list)

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def send(self, frame: Frame) -> None:
        self.sent.append((self.now, frame))
        self.now += self.work


FRAMES = [Frame(0.01 * k, 1, b"") for k in range(1001)]


def test_sections_are_the_frames_of_a_recording() -> None:
    """With the oldest values that an effect can ask for, too."""
    for effects in ({}, {"log_delay": 1.5, "creeping_hose": 1.0}):
        request = Request("r", VEHICLES["truck"], CYCLES["drive"], (), 3, 60.0, effects=effects, kind="instrumented")
        run = simulate(request.vehicle, request.cycle, (), 3, 60.0, effects=effects)
        assert list(live(request, load_dbc())) == list(frames(request, load_dbc(), [run]))


@pytest.mark.parametrize("speed", [0.5, 1.0, 20.0])
def test_each_frame_has_its_time(speed: float) -> None:
    clock = Clock()
    played = play(FRAMES, clock.send, speed, pytest.fail, clock=clock, sleep=clock.sleep)
    assert [t for t, _ in clock.sent] == pytest.approx([100.0 + frame.t / speed for frame in FRAMES])
    assert (played.frames, played.time_s) == (1001, 10.0)
    assert played.wall_s == pytest.approx(10.0 / speed)
    assert played.worst_s == pytest.approx(0.0, abs=1e-9)


def test_it_says_how_far_behind_it_is_and_goes_on() -> None:
    clock, told = Clock(work=0.02), list[str]()
    played = play(FRAMES, clock.send, 1.0, told.append, clock=clock, sleep=clock.sleep)
    assert len(clock.sent) == 1001
    assert played.worst_s == pytest.approx(1001 * 0.01, rel=0.01)
    assert len(told) == 9  # every two of 20 s
    assert re.fullmatch(r"cannot keep up: 1\.0 s behind at 1 s; choose a lower --speed", told[0])


def test_a_stall_is_caught_up_with() -> None:
    """Deadlines, not pauses: a lost second is not lost for good."""
    clock = Clock()

    def send(frame: Frame) -> None:
        clock.send(frame)
        clock.now += 1.0 if frame.t == 5.0 else 0.0

    play(FRAMES, send, 1.0, lambda _: None, clock=clock, sleep=clock.sleep)
    assert clock.sent[-1][0] == pytest.approx(110.0)


def test_an_interrupt_ends_it_with_a_count() -> None:
    clock, told = Clock(), list[str]()

    def interrupted() -> Iterator[Frame]:
        yield from FRAMES[:500]
        raise KeyboardInterrupt

    assert play(interrupted(), clock.send, 1.0, told.append, clock=clock, sleep=clock.sleep).frames == 500
    assert told == ["interrupted"]


def test_python_can_receives_what_is_played() -> None:
    request = replace(Request("r", VEHICLES["bench"], CYCLES["drive"], (), 3, 60.0, kind="instrumented"), seed=5)
    wanted = list(live(request, load_dbc()))[:200]
    with can.Bus("rig", interface="virtual") as listener, on_bus("virtual:rig") as send:
        clock = Clock()
        play(wanted, send, 1.0, pytest.fail, clock=clock, sleep=clock.sleep)
        received = [listener.recv(1.0) for _ in wanted]
    assert [(m.arbitration_id, bytes(m.data), m.is_extended_id) for m in received if m] == [
        (frame.frame_id, frame.data, True) for frame in wanted
    ]


def test_the_service_hears_it_on_this_machines_multicast_and_the_truth_is_written(
    tmp_path: Path, port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_bus(f"{GROUP}:{port}") as listener:
        options = ["--bus", f"{GROUP}:{port}", "--speed", "1000", "--truth", str(tmp_path / "t" / "truth.toml")]
        assert main([*SHORT, "--fault", "fA_t", "--size", "small", "--onset", "45", *options]) == 0
        received = listener.receive()
    told = re.search(r"(\d+) frames of 60\.0 s", capsys.readouterr().err)
    assert told
    assert int(told[1]) == pytest.approx(77 * 60, rel=0.02)
    assert len(received) > 100
    truth = tomllib.loads((tmp_path / "t" / "truth.toml").read_text())
    assert [fault["name"] for fault in truth["fault"]] == ["fA_t"]


def test_control_c_ends_it_with_exit_code_0(port: int) -> None:
    code = "import sys; from faultline.testbench.command import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code]
    with (
        open_bus(f"{GROUP}:{port}") as listener,
        subprocess.Popen([*command, *SHORT, "--bus", f"{GROUP}:{port}"], stderr=subprocess.PIPE, text=True) as process,
    ):
        while not listener.receive():
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=20)
    assert process.returncode == 0
    assert re.search(r"interrupted\n.*\d+ frames of ", error)


@pytest.mark.parametrize(
    ("bus", "said"),
    [
        ("socketcan:nosuch0", "ip link add nosuch0 type vcan"),
        ("udp_multicast:239.74.163.2", "udp_multicast:239.74.163.2:43113"),
        ("udp_multicast:10.0.0.1:43113", "'10.0.0.1' is no multicast group"),
        ("udp_multicast:239.74.163.2:0", "'0' is no port"),
        ("socketcan:", "there is no bus"),
        ("serial:ttyS0", "there is no bus 'serial:ttyS0'"),
    ],
)
def test_a_bus_that_is_not_there_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bus: str, said: str
) -> None:
    assert main([*SHORT, "--bus", bus, "--truth", str(tmp_path / "truth.toml")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "truth.toml").exists()


def test_a_truth_that_is_there_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = tmp_path / "truth.toml"
    truth.write_text("of another run")
    assert main([*SHORT, "--bus", "virtual:x", "--truth", str(truth)]) == 2
    assert f"{truth} exists; remove it" in capsys.readouterr().err
    assert truth.read_text() == "of another run"


def test_a_speed_above_zero_is_needed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SHORT, "--bus", "virtual:x", "--speed", "0"]) == 2
    assert "--speed 0 is not above zero" in capsys.readouterr().err
