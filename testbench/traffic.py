"""The frames on the bus: when each is sent, each waiting for the one before, and what its sender knows then."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from faultline.testbench.bus import Dbc, Knowledge, Sender
from faultline.testbench.effects import fitted
from faultline.testbench.request import Request
from faultline.testbench.sensor_box import SensorBox
from faultline.testbench.simulation import Run
from faultline.testbench.streams import stream

FRAME_TIME = 0.00027  # s on the bus: 29-bit identifier, 8 bytes and some stuffing at 500 kbit/s


class Frame(NamedTuple):
    """A data frame with a 29-bit identifier at time `t` [s] after the first one."""

    t: float
    frame_id: int
    data: bytes


def schedule(senders: Sequence[Sender], duration: float, rng: np.random.Generator) -> Iterator[tuple[float, Sender]]:
    """Who sends when over `duration` [s], the first at time 0."""
    due: list[tuple[float, int, Sender]] = []
    for sender in senders:
        count = int(duration / sender.period) + 1
        jitter = np.clip(rng.normal(0.0, sender.jitter, count), -3 * sender.jitter, 3 * sender.jitter)
        times = rng.uniform(0.1, 1.0) * sender.period + np.arange(count) * sender.period + jitter
        due += [(t, sender.message.frame_id, sender) for t in times.tolist()]
    due.sort(key=lambda frame: frame[:2])
    first, free = due[0][0], 0.0
    for t, _, sender in due:
        now = max(t - first, free)
        if now > duration:
            return
        free = now + FRAME_TIME
        yield now, sender


def frames(request: Request, dbc: Dbc, runs: Iterable[Run]) -> Iterator[Frame]:
    """All frames of a run, or of stretches of it, each of which reaches back by the vehicle's `log_delay` at least."""
    vehicle = fitted(request.vehicle, request.effects)
    senders, box = dbc.controllers, None
    if request.kind == "instrumented":
        senders = (*senders, dbc.sensor_box)
        box = SensorBox(
            vehicle.external,
            request.faults,
            request.day,
            stream(request.seed, request.cycle.name, "box"),
            stream(request.seed, request.cycle.name, "ripple"),
        )
    stretches = iter(runs)
    run = next(stretches)
    for t, sender in schedule(senders, request.duration, stream(request.seed, request.cycle.name, "can")):
        while run.t[-1] < t:
            run = next(stretches)
        latest = np.searchsorted(run.ecu_t, t - vehicle.log_delay, side="right") - 1
        known = Knowledge(*run.ecu[latest].tolist())
        if box and sender is dbc.sensor_box:
            known = box.add(known, run, t)
        yield Frame(t, sender.message.frame_id, sender.encode(known))
