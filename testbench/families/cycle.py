"""What is asked of a family's plant over time: a set point of the pressure and a dose."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.testbench.units import BAR

Array = npt.NDArray[np.float64]

STANDING_S, BUILDING_S = 12.0, 25.0


@dataclass(frozen=True)
class Asked:
    """Instants `t` (n,) [s] from which the set point (n,) [Pa, 0: pump off] and the dose (n,) [0..1] hold."""

    t: Array
    setpoint: Array
    dose: Array

    def at(self, t: float) -> tuple[float, float]:
        """Set point [Pa] and dose at a time [s]."""
        k = max(int(np.searchsorted(self.t, t, side="right")) - 1, 0)
        return float(self.setpoint[k]), float(self.dose[k])


@dataclass(frozen=True, kw_only=True)
class Style:
    """How a family's cycles go.

    Set points between `low` and `high` [bar], each held for `holds` (least, most) [s] around `usual` [bar] in the part
    `steady` of all cases; they step, or move at `ramp` [bar/s]. Doses are held for `doses` (least, most) [s]; the
    part `idle` is none, `full` is full, and they step, or move at `dose_ramp` [1/s].
    """

    low: float = 8.0
    high: float = 12.0
    usual: float = 10.0
    steady: float = 0.5
    holds: tuple[float, float] = (20.0, 60.0)
    doses: tuple[float, float] = (8.0, 25.0)
    idle: float = 0.3
    full: float = 0.25
    ramp: float = np.inf
    dose_ramp: float = np.inf


def asked(style: Style, duration_s: float, rng: np.random.Generator) -> Asked:
    """A random cycle: it stands still, builds the pressure, and then doses at changing set points."""
    begin = STANDING_S + BUILDING_S
    t = np.arange(0.0, duration_s, 0.1)
    setpoint, dose = np.full(len(t), style.usual * BAR), np.zeros(len(t))
    setpoint[t < STANDING_S] = 0.0
    now = begin
    while now < duration_s:
        level = style.usual if rng.random() < style.steady else rng.uniform(style.low, style.high)
        setpoint[t >= now] = level * BAR
        now += rng.uniform(*style.holds)
    now = begin
    while now < duration_s:
        kind, partial = rng.random(), rng.uniform(0.05, 0.95)
        dose[t >= now] = 0.0 if kind < style.idle else 1.0 if kind < style.idle + style.full else partial
        now += rng.uniform(*style.doses)
    moving = t >= begin
    setpoint[moving] = _limited(setpoint[moving], 0.1 * style.ramp * BAR)
    return Asked(t, setpoint, _limited(dose, 0.1 * style.dose_ramp))


def _limited(value: Array, most: float) -> Array:
    """A course (n,) whose steps are at most so large."""
    if not np.isfinite(most):
        return value
    found = value.copy()
    for k in range(1, len(value)):
        found[k] = found[k - 1] + min(max(value[k] - found[k - 1], -most), most)
    return found
