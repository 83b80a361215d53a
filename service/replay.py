"""Play a recorded log onto a CAN bus, in real time or faster."""

import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec

from faultline.options import Parser
from faultline.service.bus import open_bus
from faultline.service.logs import Frame, open_log

EXAMPLE = """example:
  faultline replay logs/bench-validation-s3-fA_du --bus socketcan:vcan0 --speed 20
"""

TOLD_EVERY_S = 2.0


class Played(msgspec.Struct):
    """Statistics of a replay: frames, their log time [s], the wall time [s] and the largest delay [s, wall]."""

    frames: int = 0
    log_s: float = 0.0
    wall_s: float = 0.0
    worst_s: float = 0.0


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser("faultline replay", description=__doc__, epilog=EXAMPLE)
    parser.add_argument("log", type=Path, help="an instrumented recording (folder), or a candump log")
    parser.add_argument("--bus", required=True, help="socketcan:NAME or udp_multicast:GROUP:PORT; it must be there")
    parser.add_argument("--speed", type=float, default=1.0, help="how many times real time (default: 1)")
    parser.add_argument("--channel", help="the bus to replay, of a log of several")
    parser.add_argument("--json", action="store_true", help="print at the end what was sent, as one JSON object")
    options = parser.parse_args(argv)
    if not 0 < options.speed < float("inf"):
        parser.error("--speed must be a number above zero")
    log = open_log(options.log, options.channel)
    log.check_channels()
    if log.report.lost:
        _say(log.report.summary())
    with open_bus(options.bus) as bus:
        length = log.duration_s
        told = Progress(lambda t: _say(f"{t:.0f} s of {length:.0f} s"), TOLD_EVERY_S * options.speed)
        played = play(log.relative(), bus.send, options.speed, progress=told)
    _say(
        f"{played.frames} frames of {played.log_s:.1f} s in {played.wall_s:.1f} s, "
        f"the latest {1e3 * played.worst_s:.1f} ms behind its time"
    )
    if options.json:
        print(msgspec.json.encode(played).decode())
    return 0


def _say(text: str) -> None:
    print(f"faultline replay: {text}", file=sys.stderr, flush=True)


class Progress:
    """Reports log time [s] once each `every` [s] of it."""

    def __init__(self, say: Callable[[float], None], every: float) -> None:
        self._say = say
        self._every = every
        self._next = every

    def __call__(self, t: float) -> None:
        """Report log time `t`, if it is due."""
        if t >= self._next:
            self._next = t + self._every
            self._say(t)


def play(
    frames: Iterable[Frame],
    send: Callable[[Frame], None],
    speed: float,
    *,
    progress: Callable[[float], None],
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Played:
    """Send every frame at its time [s] over `speed` after the start.

    Each has its own deadline on the clock, so that lateness never adds up: after a stall the frames that are due go out
    at once.
    """
    played = Played()
    start = clock()
    for frame in frames:
        due = start + frame.t / speed
        while (ahead := due - clock()) > 0:
            sleep(ahead)
        send(frame)
        played.frames += 1
        played.log_s = frame.t
        played.worst_s = max(played.worst_s, clock() - due)
        progress(frame.t)
    played.wall_s = clock() - start
    return played
