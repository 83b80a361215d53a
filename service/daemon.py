"""Listen on a CAN bus and tell subscribers which component is failing."""

import argparse
import selectors
import signal
import socket
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType

import msgspec

from service.bundle import load_bundle, verify_golden
from service.bus import Bus, open_bus
from service.bus.losses import Losses
from service.core.events import Event, encode
from service.core.monitor import Monitor
from service.outputs.socket import EventSocket

EXAMPLE = """example:
  faultline run --bundle /etc/faultline/bundle --bus socketcan:can0 --socket /run/faultline/events.sock
"""

LAG_S = 0.02
"""Ticks run this far [s, wall] behind the clock, so that a frame still in the socket's queue is in its own tick."""

IDLE_S = 0.5  # longest sleep, and the shortest time in which a stop is noticed

LOSSES_S = 60.0  # how often losses are told where there are new ones


def main(argv: list[str]) -> int:
    """Runs the daemon until SIGTERM or SIGINT; returns its exit code."""
    parser = argparse.ArgumentParser(
        "faultline run", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--bundle", type=Path, required=True, help="the bundle folder")
    parser.add_argument("--bus", required=True, help="socketcan:NAME or udp_multicast:GROUP:PORT; it must be there")
    parser.add_argument("--socket", type=Path, required=True, help="where subscribers connect (Unix socket)")
    parser.add_argument(
        "--source", default=socket.gethostname(), help="the vehicle's name in events (default: the host's)"
    )
    parser.add_argument("--speed", type=float, default=1.0, help="how many times real time the bus runs, for replays")
    options = parser.parse_args(argv)
    if not 0 < options.speed < float("inf"):
        parser.error("--speed must be a number above zero")
    bundle = load_bundle(options.bundle)
    verify_golden(bundle)
    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, options.source, bundle.id)
    with open_bus(options.bus, bundle.table.wanted) as bus, EventSocket(options.socket) as subscribers:
        _say(
            f"ready, bundle {bundle.manifest.name} {bundle.id[:12]}, bus {options.bus}, "
            f"events on {options.socket}" + (f", {options.speed:g}x" if options.speed != 1 else "")
        )
        Daemon(monitor, bus, subscribers, options.speed, Losses(bus, bundle.table)).serve()
    return 0


def _say(text: str) -> None:
    print(f"faultline run: {text}", file=sys.stderr, flush=True)


class Daemon:
    """The one loop: frames to the monitor, its events to the subscribers and to standard output.

    Log time is monotonic time since the first frame, times `speed`.
    """

    def __init__(
        self,
        monitor: Monitor,
        bus: Bus,
        subscribers: EventSocket,
        speed: float,
        losses: Losses,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._monitor = monitor
        self._bus = bus
        self._subscribers = subscribers
        self._speed = speed
        self._losses = losses
        self._losses_due = clock() + LOSSES_S
        self._clock = clock
        self._start: float | None = None  # monotonic time of the first frame
        self._stopped = False
        self._printing = True

    def serve(self) -> None:
        """Serves until a signal to stop."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        with selectors.DefaultSelector() as selector:
            selector.register(self._bus.fileno(), selectors.EVENT_READ)
            self._subscribers.register(selector)
            try:
                while not self._stopped:
                    ready = selector.select(self._patience())
                    self._listen()
                    self._subscribers.serve(ready)
                    if self._clock() >= self._losses_due:
                        self._tell_losses()
            finally:
                self._tell_losses()

    def _stop(self, _number: int, _frame: FrameType | None) -> None:
        self._stopped = True

    def _listen(self) -> None:
        """Takes what the bus has, then lets the clock run as far as the bus has been read."""
        now = self._clock()  # before the bus is read, because what comes after that has not been read
        frames = self._bus.receive()
        for frame in frames:
            if self._start is None:
                self._start = frame.t
            self._tell(self._monitor.frame(self._log_time(frame.t), frame.can_id, frame.is_extended, frame.data))
        if not frames and self._start is not None:
            self._tell(self._monitor.advance(self._log_time(now - LAG_S)))

    def _log_time(self, monotonic: float) -> float:
        assert self._start is not None
        return (monotonic - self._start) * self._speed

    def _patience(self) -> float:
        """How long nothing need be done if no frame comes [s]."""
        due = self._monitor.next_tick_s
        if due is None or self._start is None:
            return IDLE_S
        return min(IDLE_S, max(0.0, self._start + due / self._speed + LAG_S - self._clock()))

    def _tell_losses(self) -> None:
        self._losses_due = self._clock() + LOSSES_S
        if news := self._losses.news():
            _say(news)

    def _tell(self, events: list[Event]) -> None:
        for event in events:
            dated = msgspec.structs.replace(event, wall=datetime.now(UTC).isoformat(timespec="milliseconds"))
            self._subscribers.publish(dated)
            self._print(encode(dated))

    def _print(self, line: bytes) -> None:
        """Standard output is one subscriber more: where nobody reads it any longer, the others still are told."""
        if self._printing:
            try:
                sys.stdout.buffer.write(line)
                sys.stdout.buffer.flush()
            except BrokenPipeError:
                self._printing = False
                _say("standard output is closed; events go on over the socket")
