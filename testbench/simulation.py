"""A run of the rig: plant, drive, valve, controller and faults on one time line, whole or section by section.

Time 0 is the first frame of the CAN log. The run starts `MARGIN` earlier (at rest) and ends `MARGIN` later or when the
second logger stops, which it does on its own.
"""

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from faultline.testbench.cycles import Cycle, Segment
from faultline.testbench.day import CALM, Day
from faultline.testbench.ecu import PERIOD, Command, Ecu
from faultline.testbench.effects import PROFILES, Surroundings, branches_of, checked, fitted
from faultline.testbench.faults import Fault, apply, reading, strength
from faultline.testbench.plant import Array, Plant
from faultline.testbench.pulsation import Pulsation
from faultline.testbench.pump import Drive
from faultline.testbench.sensors import Membrane
from faultline.testbench.streams import stream
from faultline.testbench.undeclared import Disturbances, swapped
from faultline.testbench.valve import PulseWidth
from faultline.testbench.vehicles import Vehicle

STEP = 0.002  # s; tests/testbench/test_rig_simulation.py halves it
MARGIN = 4.0  # s


@dataclass(frozen=True)
class Run:
    """A run: the hidden truth, and what the controller knew.

    `pressures` (steps, 4) [Pa] are the true p_tp, p_bp, p_ap, p_du at `t` (steps,) [s]. `ecu` (ticks, 4) are y_p_du
    [Pa], n_p [rev/s], dc_dose [0..1] and the requested dose [0..1] at `ecu_t` (ticks,) [s], once per `PERIOD`. `ripple`
    (ticks,) [Pa] is the amplitude at p_tp then of what is too fast for the steps (effect `suction_pulsation`).
    """

    t: Array
    pressures: Array
    ecu_t: Array
    ecu: Array
    ripple: Array


class Simulation:
    """A run that is advanced section by section; the sections joined are the same run however long they are.

    It covers `MARGIN` before the cycle, the cycle's `duration` [s], and `after` [s] more. Unless `effects` are given,
    those of the profile `realistic` are there; unless a `day` is, none.

    Raises:
        RigError: the duration is too short for a cycle, or an effect is unknown.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        cycle: Cycle,
        faults: Sequence[Fault],
        seed: int,
        duration: float,
        *,
        effects: Mapping[str, float] | None = None,
        day: Day = CALM,
        step: float = STEP,
        after: float = MARGIN,
    ) -> None:
        present = checked(PROFILES["realistic"] if effects is None else effects)
        self._vehicle, self._surroundings = fitted(vehicle, present), Surroundings(present, day)
        self._faults, self._step, self._zero_p_du = faults, step, day.zero_p_du
        self.ticks, self.tick = round((MARGIN + duration + after) / PERIOD), 0
        self._wanted = _schedule(cycle.segments(duration, stream(seed, cycle.name, "cycle")), self.ticks)
        self._noise = stream(seed, cycle.name, "ecu")
        self._plant = Plant(self._vehicle.plant, self._vehicle.pump, branches_of(self._vehicle))
        self._drive, self._valve, self._ecu = Drive(self._vehicle.pump), PulseWidth(self._vehicle.needle), Ecu()
        self._membrane = Membrane(self._vehicle.ecu_sensors, PERIOD)
        self._disturbances = Disturbances(faults, self._vehicle.pump, self._vehicle.needle)
        self._pulsation = Pulsation(self._vehicle, present.get("suction_pulsation", 0.0))

    def advance(self, ticks: int) -> Run:
        """The next `ticks` periods of the controller, fewer at the end."""
        first, last = self.tick, min(self.tick + ticks, self.ticks)
        noise = self._noise.standard_normal((last - first, 2)).tolist()
        hidden, known, ripple = array("d"), array("d"), array("d")
        for self.tick, (noise_p, noise_n) in enumerate(noise, start=first):
            t = self.tick * PERIOD - MARGIN
            healthy = self._surroundings.step(self._plant, self._vehicle.plant, t, PERIOD)
            apply(self._faults, self._plant, healthy, t)
            self._disturbances.apply(self._plant, healthy, self._drive, self._valve, self._membrane, t)
            command = self._control(t, noise_p, noise_n, known)
            self._move(command, hidden)
            ripple.append(self._pulsation.amplitude(self._plant, self._drive.speed))
        self.tick = last
        per_tick = round(PERIOD / self._step)
        return Run(
            t=np.arange(first * per_tick + 1, last * per_tick + 1, dtype=np.float64) * self._step - MARGIN,
            pressures=np.frombuffer(hidden).reshape(-1, 4),
            ecu_t=np.arange(first, last, dtype=np.float64) * PERIOD - MARGIN,
            ecu=np.frombuffer(known).reshape(-1, 4),
            ripple=np.frombuffer(ripple),
        )

    def _control(self, t: float, noise_p: float, noise_n: float, known: "array[float]") -> Command:
        """What the controller orders at `t` [s]; appends what it knows."""
        sensors, faults = self._vehicle.ecu_sensors, self._faults
        pressure = self._plant.p_ap if swapped(self._faults, t) else self._plant.p_du
        felt = self._membrane.feel(pressure) + strength(faults, "fy_p_du", t) + self._zero_p_du
        y_p_du = reading(faults, "p_du", sensors.p_du(felt, noise_p), t)
        n_p = reading(faults, "n_p", sensors.n_p(self._drive.speed, noise_n), t)
        setpoint, request = self._wanted[self.tick]
        command = self._ecu.update(y_p_du, setpoint, request)
        known.extend((y_p_du, n_p, command.duty, request))
        return command

    def _move(self, command: Command, hidden: "array[float]") -> None:
        """The steps of one controller period; appends the four pressures after each."""
        plant, drive, valve, h = self._plant, self._drive, self._valve, self._step
        for _ in range(round(PERIOD / h)):
            speed = drive.step(h, command.speed, plant.p_ap - plant.p_bp)
            plant.step(h, speed, valve.opening(h, command.duty))
            hidden.extend((plant.p_tp, plant.p_bp, plant.p_ap, plant.p_du))


def joined(sections: Sequence[Run]) -> Run:
    """Sections that follow each other as one run."""
    return Run(
        np.concatenate([section.t for section in sections]),
        np.concatenate([section.pressures for section in sections]),
        np.concatenate([section.ecu_t for section in sections]),
        np.concatenate([section.ecu for section in sections]),
        np.concatenate([section.ripple for section in sections]),
    )


def simulate(
    vehicle: Vehicle,
    cycle: Cycle,
    faults: Sequence[Fault],
    seed: int,
    duration: float,
    *,
    effects: Mapping[str, float] | None = None,
    day: Day = CALM,
    step: float = STEP,
    after: float = MARGIN,
    progress: Callable[[float], None] = lambda _: None,
) -> Run:
    """The whole of a `Simulation`; `progress` is called with the part done [0..1]."""
    simulation = Simulation(vehicle, cycle, faults, seed, duration, effects=effects, day=day, step=step, after=after)
    sections = []
    while simulation.tick < simulation.ticks:
        sections.append(simulation.advance(500))
        progress(simulation.tick / simulation.ticks)
    return joined(sections)


def _schedule(segments: Sequence[Segment], ticks: int) -> list[tuple[float | None, float]]:
    """Setpoint [Pa] and requested dose [0..1] at every tick; the first and last segment last through the margins."""
    ends = np.cumsum([segment.duration for segment in segments])
    times = np.arange(ticks) * PERIOD - MARGIN
    which = np.minimum(np.searchsorted(ends, times, side="right"), len(segments) - 1)
    return [(segments[i].setpoint, segments[i].duty) for i in which]
