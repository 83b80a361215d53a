"""What turns a family's pump and opens its valve: controllers, motors and the valve's pulses."""

from collections.abc import Callable
from dataclasses import dataclass, field

from faultline.testbench.units import BAR


@dataclass
class PI:
    """Proportional and integral, with back-calculation at the limits; `forward` [rev/s] is added for a full dose."""

    gain: float  # rev/s/bar
    time: float  # s
    limit: float  # rev/s
    forward: float = 0.0
    integral: float = 0.0

    def __call__(self, error: float, dose: float, h: float) -> float:
        """The speed [rev/s] that is ordered, at the pressure error `error` [Pa], once per `h` [s]."""
        wanted = self.gain * error / BAR + self.integral + self.forward * dose
        speed = min(max(wanted, 0.0), self.limit)
        self.integral += h / self.time * (self.gain * error / BAR) + (speed - wanted) * min(1.0, h / self.time)
        return speed


@dataclass
class Velocity:
    """A PID algorithm in velocity form: each period changes the speed by increments, at most `slew` [rev/s/s]."""

    gain: float
    time: float
    lead: float  # s
    limit: float
    slew: float
    speed: float = 0.0
    last: tuple[float, float] = (0.0, 0.0)

    def __call__(self, error: float, dose: float, h: float) -> float:
        """As `PI`."""
        del dose
        e, (e1, e2) = error / BAR, self.last
        change = self.gain * ((e - e1) + h / self.time * e + self.lead / h * (e - 2.0 * e1 + e2))
        self.last = (e, e1)
        self.speed = min(max(self.speed + min(max(change, -self.slew * h), self.slew * h), 0.0), self.limit)
        return self.speed


@dataclass
class Relay:
    """Two speeds around what the dose needs, with hysteresis: the pressure saws within its band."""

    band: float  # bar, either way
    idle: float  # rev/s, roughly what holds the pressure without a dose
    dose: float  # rev/s more at full dose
    swing: float  # rev/s either way
    up: bool = True

    def __call__(self, error: float, dose: float, h: float) -> float:
        """As `PI`."""
        del h
        self.up = error > -self.band * BAR if self.up else error > self.band * BAR
        return max(self.idle + self.dose * dose + (self.swing if self.up else -self.swing), 0.0)


@dataclass
class Steps:
    """Another controller whose order is rounded to steps of the motor's driver [rev/s], within a dead band."""

    inner: Callable[[float, float, float], float]
    step: float
    last: float = 0.0

    def __call__(self, error: float, dose: float, h: float) -> float:
        """As `PI`."""
        wanted = self.inner(error, dose, h)
        if abs(wanted - self.last) > 0.6 * self.step:
            self.last = self.step * round(wanted / self.step)
        return self.last


@dataclass
class Foreknowing:
    """The speed that idle and dose would need by the maker's figures, and an integral that rests within a dead band."""

    idle: float  # rev/s
    dose: float  # rev/s more at full dose
    gain: float  # rev/s/bar
    time: float  # s
    band: float  # bar, either way
    integral: float = 0.0

    def __call__(self, error: float, dose: float, h: float) -> float:
        """As `PI`."""
        e = error / BAR
        if abs(e) > self.band:
            self.integral = min(max(self.integral + h / self.time * self.gain * e, -20.0), 20.0)
        return max(self.idle + self.dose * dose + self.gain * e + self.integral, 0.0)


@dataclass
class Motor:
    """Follows the ordered speed with a lag [s] (0: at once), at most so fast [rev/s/s]. State: `speed` [rev/s]."""

    lag: float = 0.0
    fastest: float = 1e9
    speed: float = 0.0

    def step(self, h: float, ordered: float) -> float:
        """The mean speed over the next `h` [s]."""
        wanted = (ordered - self.speed) * (min(1.0, h / (self.lag + 0.5 * h)) if self.lag else 1.0)
        change = min(max(wanted, -self.fastest * h), self.fastest * h)
        before = self.speed
        self.speed += change
        return 0.5 * (before + self.speed)


@dataclass
class Swinging:
    """A motor of second order: its natural `frequency` [rad/s] and `damping`. State: `speed` [rev/s] and its rate."""

    frequency: float
    damping: float
    speed: float = 0.0
    rate: float = 0.0

    def step(self, h: float, ordered: float) -> float:
        """As of `Motor`; by the semi-implicit method of Euler."""
        w, before = self.frequency, self.speed
        self.rate += h * (w * w * (ordered - self.speed) - 2.0 * self.damping * w * self.rate)
        self.speed = max(self.speed + h * self.rate, 0.0)
        return 0.5 * (before + self.speed)


@dataclass
class Pulses:
    """The dosing valve: pulses of a `frequency` [1/s] whose part `duty` is open; 0: it throttles without pulses."""

    frequency: float
    phase: float = field(default=0.0)

    def step(self, h: float, duty: float) -> float:
        """The part of the next `h` [s] that it is open."""
        if duty >= 1.0 or self.frequency <= 0.0:
            return duty
        begin, end = self.phase, self.phase + h * self.frequency
        self.phase = end % 1.0
        whole = min(end, 1.0)
        is_open = max(0.0, min(whole, duty) - begin)
        if end > 1.0:
            is_open += min(end - 1.0, duty)
        return is_open / (end - begin)
