"""The instrumented vehicle live on a bus: simulated in small sections while it is played, at any speed.

A section takes a hundredth of its length to simulate, and is simulated when its first frame is wanted: so that no frame
waits for long. Every frame has its own deadline on the clock; lateness does not add up.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain

from faultline.testbench.bus import Dbc
from faultline.testbench.ecu import PERIOD
from faultline.testbench.effects import EFFECTS
from faultline.testbench.request import Request
from faultline.testbench.simulation import MARGIN, Run, Simulation, joined
from faultline.testbench.traffic import Frame, frames

SECTION_TICKS = 5  # of the controller: 0.1 s, a millisecond's work
SECTIONS_KEPT = round(EFFECTS["log_delay"].largest / (SECTION_TICKS * PERIOD)) + 2  # what is sent may be that old
LATE_S = 0.1  # wall clock: more than a busy machine's ordinary stalls
TOLD_EVERY_S = 2.0  # wall clock


@dataclass
class Played:
    """What was sent: frames, their own time [s], the wall time it took and the latest that any was [s, wall clock]."""

    frames: int = 0
    time_s: float = 0.0
    wall_s: float = 0.0
    worst_s: float = 0.0


def live(request: Request, dbc: Dbc) -> Iterator[Frame]:
    """The frames that a recording of `request` would hold, simulated as they are asked for; the first is ready."""
    simulation = Simulation(
        request.vehicle,
        request.cycle,
        request.faults,
        request.seed,
        request.duration,
        effects=request.effects,
        day=request.day,
    )
    sent = frames(request, dbc, _stretches(simulation))
    return chain([next(sent)], sent)


def _stretches(simulation: Simulation) -> Iterator[Run]:
    """The run in stretches, each with what came shortly before."""
    kept = deque([simulation.advance(round(MARGIN / PERIOD))], SECTIONS_KEPT)
    while simulation.tick < simulation.ticks:
        kept.append(simulation.advance(SECTION_TICKS))
        yield joined(kept)


def play(
    sent: Iterable[Frame],
    send: Callable[[Frame], None],
    speed: float,
    say: Callable[[str], None],
    *,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Played:
    """Sends every frame at its time over `speed` after the start, until they end or the user interrupts.

    Where it cannot keep up it goes on as fast as it can, and says so every `TOLD_EVERY_S`.
    """
    played = Played()
    start = told = clock()
    try:
        for frame in sent:
            due = start + frame.t / speed
            while (ahead := due - clock()) > 0.0:
                sleep(ahead)
            send(frame)
            now = clock()
            played.frames += 1
            played.time_s = frame.t
            played.worst_s = max(played.worst_s, now - due)
            if now - due > LATE_S and now - told > TOLD_EVERY_S:
                told = now
                say(f"cannot keep up: {now - due:.1f} s behind at {frame.t:.0f} s; choose a lower --speed")
    except KeyboardInterrupt:
        say("interrupted")
    played.wall_s = clock() - start
    return played
