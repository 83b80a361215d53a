"""One run of the rig in memory: plant, drive, valve, controller and faults on one time line.

Time 0 is the first frame of the CAN log. The run starts `MARGIN` earlier (at rest) and ends `MARGIN` later or when the
second logger stops, which it does on its own.
"""

import zlib
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from testbench.cycles import Cycle, Segment
from testbench.ecu import PERIOD, Command, Ecu
from testbench.effects import PROFILES, Surroundings, branches_of, checked, fitted
from testbench.faults import Fault, apply, reading, strength
from testbench.plant import Array, Plant
from testbench.pump import Drive
from testbench.sensors import Membrane
from testbench.valve import PulseWidth
from testbench.vehicles import Vehicle

STEP = 0.002  # s; tests/testbench/test_simulation.py halves it
MARGIN = 4.0  # s


def stream(seed: int, *names: str) -> np.random.Generator:
    """The random numbers of one purpose: independent of all other purposes, the same for the same seed and names."""
    return np.random.default_rng([seed, zlib.crc32("/".join(names).encode())])


@dataclass(frozen=True)
class Run:
    """A run: the hidden truth, and what the controller knew.

    `pressures` (steps, 4) [Pa] are the true p_tp, p_bp, p_ap, p_du at `t` (steps,) [s]. `ecu` (ticks, 4) are y_p_du
    [Pa], n_p [rev/s], dc_dose [0..1] and the requested dose [0..1] at `ecu_t` (ticks,) [s], once per `PERIOD`.
    """

    t: Array
    pressures: Array
    ecu_t: Array
    ecu: Array


def simulate(
    vehicle: Vehicle,
    cycle: Cycle,
    faults: Sequence[Fault],
    seed: int,
    duration: float,
    *,
    effects: Mapping[str, float] | None = None,
    step: float = STEP,
    after: float = MARGIN,
    progress: Callable[[float], None] = lambda _: None,
) -> Run:
    """Runs `cycle` for `duration` [s] and goes on for `after` [s]; `progress` is called with the part done [0..1].

    Unless `effects` are given, those of the profile `realistic` are there.

    Raises:
        RigError: the duration is too short for a cycle, or an effect is unknown.
    """
    present = checked(PROFILES["realistic"] if effects is None else effects)
    vehicle, surroundings = fitted(vehicle, present), Surroundings(present)
    segments = cycle.segments(duration, stream(seed, cycle.name, "cycle"))
    per_tick = round(PERIOD / step)
    ticks = round((MARGIN + duration + after) / PERIOD)
    wanted = _schedule(segments, ticks)
    noise = stream(seed, cycle.name, "ecu").standard_normal((ticks, 2)).tolist()
    plant = Plant(vehicle.plant, vehicle.pump, branches_of(vehicle))
    drive, valve, ecu = Drive(vehicle.pump), PulseWidth(vehicle.needle), Ecu()
    membrane = Membrane(vehicle.ecu_sensors, PERIOD)
    hidden, known = array("d"), array("d")
    for tick in range(ticks):
        t = tick * PERIOD - MARGIN
        apply(faults, plant, surroundings.step(plant, vehicle.plant, t, PERIOD), t)
        felt = membrane.feel(plant.p_du) + strength(faults, "fy_p_du", t)
        y_p_du = reading(faults, "p_du", vehicle.ecu_sensors.p_du(felt, noise[tick][0]), t)
        n_p = reading(faults, "n_p", vehicle.ecu_sensors.n_p(drive.speed, noise[tick][1]), t)
        setpoint, request = wanted[tick]
        command = ecu.update(y_p_du, setpoint, request)
        known.extend((y_p_du, n_p, command.duty, request))
        _advance(plant, drive, valve, command, step, per_tick, hidden)
        if tick % 500 == 0:
            progress(tick / ticks)
    progress(1.0)
    pressures = np.frombuffer(hidden).reshape(-1, 4)
    return Run(
        t=np.arange(1, len(pressures) + 1, dtype=np.float64) * step - MARGIN,
        pressures=pressures,
        ecu_t=np.arange(ticks, dtype=np.float64) * PERIOD - MARGIN,
        ecu=np.frombuffer(known).reshape(-1, 4),
    )


def _advance(
    plant: Plant, drive: Drive, valve: PulseWidth, command: Command, h: float, steps: int, hidden: "array[float]"
) -> None:
    """The steps of one controller period; appends the four pressures after each."""
    for _ in range(steps):
        speed = drive.step(h, command.speed, plant.p_ap - plant.p_bp)
        plant.step(h, speed, valve.opening(h, command.duty))
        hidden.extend((plant.p_tp, plant.p_bp, plant.p_ap, plant.p_du))


def _schedule(segments: Sequence[Segment], ticks: int) -> list[tuple[float | None, float]]:
    """Setpoint [Pa] and requested dose [0..1] at every tick; the first and last segment last through the margins."""
    ends = np.cumsum([segment.duration for segment in segments])
    times = np.arange(ticks) * PERIOD - MARGIN
    which = np.minimum(np.searchsorted(ends, times, side="right"), len(segments) - 1)
    return [(segments[i].setpoint, segments[i].duty) for i in which]
