"""The second logger: the external sensors in volts, on a clock of its own.

Its n-th sample is due at the CAN time start + n `PERIOD`, and taken up to `JITTER` off. The column `time_s` says

    logger_time = (can_time - starts_s + JITTER) (1 + drift_ppm / 1e6)

(so that it never begins below zero), to 0.1 ms. An ideal synchronisation finds the inverse of that, `Clocking.inverse`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from faultline.testbench.day import Day
from faultline.testbench.errors import RigError
from faultline.testbench.faults import Fault, strength
from faultline.testbench.plant import Array
from faultline.testbench.pulsation import pulse
from faultline.testbench.sensors import ExternalSensor
from faultline.testbench.simulation import MARGIN, Run
from faultline.testbench.undeclared import swapped

PERIOD = 0.1  # s, thesis 5.7: sampled at 10 Hz
JITTER = 0.005  # s, half width: its task has others beside it
START_SPREAD = 3.0  # s, half width: it is started and stopped by hand
DRIFT_PPM = 50.0  # half width: two ordinary quartzes against each other

COLUMN_OF = {"y_p_tp": 0, "y_p_ap": 2}
"""Where each external sensor sits in `Run.pressures`."""
P_DU = 3
"""Where the controller's own one does."""

OFF_VOLTS = {1.0: 0.0, 2.0: 5.0}
"""What the converter reads of a sensor that is off, by the size of that fault: both beyond the table of any sensor."""

RANGES = {
    "starts_s": (-150.0, 150.0), "stops_s": (-150.0, 150.0),  # somebody walked from one logger to the other
    "drift_ppm": (-500.0, 500.0),  # ten times what a quartz may do: a resonator's
    "dropped": (0.0, 0.5), "noise": (0.0, 20.0),
}  # fmt: skip
SHORTEST = 1.0  # s: a file with less has no samples to speak of


@dataclass(frozen=True)
class SecondLogger:
    """How the second logger is set; what is None is drawn anew for every seed.

    It runs from `starts_s` after the first CAN frame to `stops_s` after the CAN log's end [s], its clock is `drift_ppm`
    fast, the share `dropped` of its samples is lost, and its sensors have `noise` times their usual noise.

    Raises:
        RigError: a value is out of range.
    """

    starts_s: float | None = None
    stops_s: float | None = None
    drift_ppm: float | None = None
    dropped: float = 0.005  # a busy logger's queue, now and then
    noise: float = 1.0

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise RigError(f"{name} {value:g} of the second logger is not in {low:g}..{high:g}")

    def clocking(self, duration: float, rng: np.random.Generator) -> "Clocking":
        """What it really does beside a CAN log of `duration` [s].

        Raises:
            RigError: it would stop before it has started.
        """
        # All are drawn, whatever is given: so giving one changes none of the others.
        drawn = (
            rng.uniform(-START_SPREAD, START_SPREAD),
            rng.uniform(-START_SPREAD, START_SPREAD),
            rng.uniform(-DRIFT_PPM, DRIFT_PPM),
        )
        given = (self.starts_s, self.stops_s, self.drift_ppm)
        starts, stops, drift = (d if g is None else g for d, g in zip(drawn, given, strict=True))
        if duration + stops - starts < SHORTEST:
            raise RigError(f"the second logger starts at {starts:.1f} s and would stop at {duration + stops:.1f} s")
        return Clocking(starts, stops, drift, self.dropped, self.noise)


@dataclass(frozen=True)
class Clocking:
    """What the second logger did; the fields are those of `SecondLogger`."""

    starts_s: float
    stops_s: float
    drift_ppm: float
    dropped: float
    noise: float

    @property
    def needs_after(self) -> float:
        """How long a run has to go on after the CAN log's end [s]."""
        return max(MARGIN, self.stops_s)

    def logger_time(self, can_time: Array) -> Array:
        """Its own time [s] at CAN times (n,) [s]."""
        return (can_time - self.starts_s + JITTER) * (1.0 + 1e-6 * self.drift_ppm)

    def inverse(self) -> tuple[float, float]:
        """(offset_s, drift) of can_time = offset_s + (1 + drift) logger_time, exactly."""
        return self.starts_s - JITTER, 1.0 / (1.0 + 1e-6 * self.drift_ppm) - 1.0

    def truth(self) -> dict[str, float]:
        """What a synchronisation is judged by."""
        offset, drift = self.inverse()
        return {**asdict(self), "offset_s": offset, "drift": drift}


def external_csv(
    run: Run,
    sensors: Mapping[str, ExternalSensor],
    faults: Sequence[Fault],
    duration: float,
    clocking: Clocking,
    day: Day,
    rng: np.random.Generator,
    phases: np.random.Generator,
) -> str:
    """The second logger's CSV: `time_s` on its own clock, one column of volts a sensor.

    Before the run's first step the system has been at rest, so that its first pressures hold.
    """
    start, stop = clocking.starts_s, duration + clocking.stops_s
    t = np.asarray(start + np.arange(int((stop - start) / PERIOD)) * PERIOD, dtype=np.float64)
    t += rng.uniform(-JITTER, JITTER, len(t))
    t = t[rng.random(len(t)) >= clocking.dropped]
    zeros = {"y_p_tp": day.zero_p_tp, "y_p_ap": day.zero_p_ap}
    columns = [f"{value:.4f}" for value in clocking.logger_time(t).tolist()]
    for signal, plain in sensors.items():
        sensor = replace(plain, noise=clocking.noise * plain.noise)
        true: Array = np.interp(t, run.t, run.pressures[:, COLUMN_OF[signal]])
        if signal == "y_p_ap":
            other = np.interp(t, run.t, run.pressures[:, P_DU])
            true = np.where([swapped(faults, time) for time in t.tolist()], other, true)
        if signal == "y_p_tp":
            true = true + np.interp(t, run.ecu_t, run.ripple) * pulse(phases.random(len(t)))
        offset, off = (
            np.array([strength(faults, name, time) for time in t.tolist()])
            for name in (f"f{signal}", f"off_{signal.removeprefix('y_')}")
        )
        read = sensor.read(true, offset + zeros[signal], rng)
        volts = np.select([off == size for size in OFF_VOLTS], [*OFF_VOLTS.values()], read)
        columns = [f"{row},{volt:.4f}" for row, volt in zip(columns, volts.tolist(), strict=True)]
    header = ",".join(["time_s", *(sensor.column for sensor in sensors.values())])
    return "\n".join([header, *columns, ""])
