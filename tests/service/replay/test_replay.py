"""A replay keeps every frame's time on the clock it is given."""

import json
from pathlib import Path

import pytest

from faultline.service import replay
from faultline.service.bus import BusError
from faultline.service.core.errors import InputError
from faultline.service.logs import Frame
from faultline.service.replay import Progress, main, play


class Clock:
    """Stands still but for sleeps and what a send is made to cost."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now += seconds


def _play(times: list[float], speed: float, cost: float = 0.0) -> tuple[list[float], replay.Played]:
    clock, sent = Clock(), list[float]()

    def send(frame: Frame) -> None:
        sent.append(clock.now - 1000.0)
        clock.now += cost

    frames = [Frame(t, 1, True, b"") for t in times]
    played = play(frames, send, speed, progress=lambda _: None, clock=clock, sleep=clock.sleep)
    return sent, played


def test_frames_go_out_at_their_times() -> None:
    sent, played = _play([0.0, 0.5, 2.0], 1.0)
    assert sent == pytest.approx([0.0, 0.5, 2.0])
    assert played.frames == 3
    assert played.log_s == 2.0
    assert played.worst_s == pytest.approx(0.0, abs=1e-9)
    assert played.wall_s == pytest.approx(2.0)


def test_speed_divides_the_time() -> None:
    assert _play([0.0, 10.0, 40.0], 20.0)[0] == pytest.approx([0.0, 0.5, 2.0])


def test_lateness_never_adds_up() -> None:
    sent, played = _play([0.1 * k for k in range(100)], 1.0, cost=0.09)
    assert sent == pytest.approx([0.1 * k for k in range(100)])
    assert played.worst_s == pytest.approx(0.09)


def test_what_is_due_after_a_stall_goes_out_at_once() -> None:
    sent, played = _play([0.0, 0.1, 0.2, 5.0], 1.0, cost=1.0)
    assert sent == pytest.approx([0.0, 1.0, 2.0, 5.0])
    assert played.worst_s == pytest.approx(2.8)


def test_progress_is_told_now_and_then() -> None:
    said: list[float] = []
    told = Progress(said.append, every=10.0)
    for t in range(35):
        told(float(t))
    assert said == [10.0, 20.0, 30.0]


class Fake:
    """A bus that keeps what it is sent."""

    def __init__(self) -> None:
        self.sent: list[Frame] = []

    def __enter__(self) -> "Fake":
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)


def test_plays_a_log_and_says_what_was_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = Fake()
    monkeypatch.setattr(replay, "open_bus", lambda spec: {"x:y": bus}[spec])
    log = tmp_path / "can.log"
    log.write_text("(100.0) can0 123#01\nnonsense\n(100.5) can0 18FF103D#02\n(100.9) can0 12")
    assert main([str(log), "--bus", "x:y", "--speed", "1000"]) == 0
    assert bus.sent == [Frame(0.0, 0x123, False, b"\x01"), Frame(0.5, 0x18FF103D, True, b"\x02")]
    captured = capsys.readouterr()
    assert captured.out == ""
    said = captured.err
    read = "faultline replay: 2 frames read, from 0.0 to 0.5 s, 8 bytes are lost, 1 lines could not be read (line 2:"
    assert read in said
    assert "the last line is cut off" in said
    assert "faultline replay: 2 frames of 0.5 s in " in said


def test_what_was_sent_as_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(replay, "open_bus", lambda _: Fake())
    log = tmp_path / "can.log"
    log.write_text("(100.0) can0 123#01\n(100.5) can0 123#02\n")
    assert main([str(log), "--bus", "x:y", "--speed", "1000", "--json"]) == 0
    captured = capsys.readouterr()
    assert captured.out.count("\n") == 1
    played = json.loads(captured.out)
    assert list(played) == ["frames", "log_s", "wall_s", "worst_s"]
    assert (played["frames"], played["log_s"]) == (2, 0.5)
    assert played["wall_s"] > 0
    assert played["worst_s"] >= 0
    assert "2 frames of 0.5 s in " in captured.err


@pytest.mark.parametrize("speed", ["0", "-1", "nan", "inf", "fast"])
def test_speed_is_a_positive_number(speed: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["x.log", "--bus", "socketcan:vcan0", "--speed", speed])
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert "--speed" in said
    assert "must be a number above zero" in said or speed == "fast"


def test_a_missing_log_or_bus_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        main([str(tmp_path / "no.log"), "--bus", "socketcan:vcan0"])
    log = tmp_path / "can.log"
    log.write_text("(100.0) can0 123#01\n")
    with pytest.raises(BusError, match="give socketcan:NAME"):
        main([str(log), "--bus", "nothing"])
