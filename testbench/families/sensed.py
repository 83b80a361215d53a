"""What the sensors and the bus make of a family's run: lags, pulsation, noise, resolution, and when what is sent."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from faultline.testbench.bus import Dbc, Knowledge
from faultline.testbench.families.faulty import errors_at
from faultline.testbench.faults import Fault
from faultline.testbench.traffic import FRAME_TIME, Frame

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """First-order `lag` [s], mean over a `window` [s], `noise` (standard deviation), `resolution`, and an error `zero`.

    `pulsation` is the amplitude of the pump's ripple at 30 rev/s, `pulses` how many there are in a revolution.
    """

    noise: float
    resolution: float = 0.0
    lag: float = 0.0
    window: float = 0.0
    zero: float = 0.0
    pulsation: float = 0.0
    pulses: int = 6


@dataclass(frozen=True, kw_only=True)
class Tachometer:
    """The pump's speed: a mean over `window` [s], `noise` and `resolution` [rev/s], renewed each `renewed` [s].

    With `teeth` it is counted how many of so many on a wheel have passed within the window.
    """

    noise: float = 0.03
    resolution: float = 0.0
    window: float = 0.0
    renewed: float = 0.0
    teeth: int = 0


@dataclass(frozen=True, kw_only=True)
class Bus:
    """Periods and jitter (sd) [s] of the controller's and the sensor box's frames, and which part of them is lost.

    The controller sends what it knew at its last task, of which there is one each `task` [s].
    """

    ecu: float = 0.2
    box: float = 0.1
    ecu_jitter: float = 0.008
    box_jitter: float = 0.003
    task: float = 0.02
    lost: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Seen:
    """All that lies between the plant and its recording."""

    sensors: dict[str, Sensor]
    speed: Tachometer = field(default_factory=Tachometer)
    bus: Bus = field(default_factory=Bus)


@dataclass(frozen=True)
class Course:
    """A run: `t` (K,) [s] evenly, `pressures` (K, 4) [Pa], `speed` (K,) [rev/s], the valve's `duty` (K,), faults."""

    t: Array
    pressures: Array
    speed: Array
    duty: Array
    faults: tuple[Fault, ...] = ()

    @property
    def step(self) -> float:
        """Between two instants [s]."""
        return float(self.t[1] - self.t[0])


PLACE = {"y_p_tp": 0, "y_p_ap": 2, "y_p_du": 3}


def frames(course: Course, seen: Seen, dbc: Dbc, rng: np.random.Generator) -> Iterator[Frame]:
    """The frames of a run, from its first to its last."""
    turned = np.cumsum(course.speed) * course.step
    felt = {
        name: _lagged(_mean(course.pressures[:, PLACE[name]], sensor.window / course.step), sensor.lag / course.step)
        + sensor.pulsation * np.sqrt(course.speed / 30.0) * np.sin(2 * np.pi * sensor.pulses * turned)
        for name, sensor in seen.sensors.items()
    }
    width = max(1, round(seen.speed.window / course.step))
    whole = np.concatenate([np.zeros(width), turned])
    if seen.speed.teeth:
        whole = np.floor(whole * seen.speed.teeth) / seen.speed.teeth
    mean = (whole[width:] - whole[: len(turned)]) / (width * course.step)
    senders = {sender.message.name: sender for sender in (*dbc.controllers, dbc.sensor_box)}
    due = [
        *((t, "UDS_ECU") for t in _times(course, seen.bus.ecu, seen.bus.ecu_jitter, seen.bus.lost, rng)),
        *((t, "UDS_SENSORS") for t in _times(course, seen.bus.box, seen.bus.box_jitter, seen.bus.lost, rng)),
    ]
    free, shown, renewed = -np.inf, 0.0, -np.inf
    first = min(due)[0]
    for t, name in sorted(due):
        at = t if name == "UDS_SENSORS" else t - (t % seen.bus.task)
        k = min(int(at / course.step), len(course.t) - 1)
        off = errors_at(course.faults, at)
        reads = {s: _read(felt[s][k] + off.get(s, 0.0), sensor, rng) for s, sensor in seen.sensors.items()}
        if name == "UDS_ECU" and at - renewed >= seen.speed.renewed - 1e-9:
            value = mean[k] + seen.speed.noise * rng.standard_normal() if mean[k] > 0.0 else 0.0
            shown, renewed = max(_rounded(value, seen.speed.resolution), 0.0), at
        known = Knowledge(reads["y_p_du"], shown, float(course.duty[k]), 0.0, reads["y_p_tp"], reads["y_p_ap"])
        free = max(t, free) + FRAME_TIME
        yield Frame(free - first, senders[name].message.frame_id, senders[name].encode(known))


def _times(course: Course, period: float, jitter: float, lost: float, rng: np.random.Generator) -> list[float]:
    count = int(course.t[-1] / period) - 1
    t = rng.uniform(0.1, 1.0) * period + np.arange(count) * period
    t += np.clip(rng.normal(0.0, jitter, count), -0.4 * period, 0.4 * period)
    return [float(at) for at in t[rng.random(count) >= lost] if at >= 0.0]


def _lagged(value: Array, steps: float) -> Array:
    """A first-order lag of so many steps, from a steady start."""
    if steps <= 0.0:
        return value
    share = 1.0 - np.exp(-1.0 / steps)
    return np.asarray(value[0] + lfilter([share], [1.0, share - 1.0], value - value[0]))


def _mean(value: Array, steps: float) -> Array:
    """Over the last so many steps, from a steady start."""
    width = max(1, round(steps))
    return np.asarray(
        np.convolve(np.concatenate([np.full(width - 1, value[0]), value]), np.ones(width) / width, "valid")
    )


def _read(value: float, sensor: Sensor, rng: np.random.Generator) -> float:
    return _rounded(float(value) + sensor.zero + sensor.noise * rng.standard_normal(), sensor.resolution)


def _rounded(value: float, resolution: float) -> float:
    return resolution * round(value / resolution) if resolution else value
