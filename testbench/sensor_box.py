"""The box that puts the added sensors on an instrumented vehicle's bus, in pascal by their tables.

It has zeroed them at rest at atmospheric pressure before the log, over `ZEROED_OVER` samples: what is left of their
zero error is the mean of that many samples' noise.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from faultline.testbench.bus import Knowledge
from faultline.testbench.day import Day
from faultline.testbench.faults import Fault, reading, strength
from faultline.testbench.pulsation import pulse
from faultline.testbench.sensors import ExternalSensor
from faultline.testbench.simulation import Run
from faultline.testbench.undeclared import swapped

ZEROED_OVER = 100  # 10 s at 10 Hz, within the standstill that a workshop waits for


class SensorBox:
    """State: the zero errors left [Pa], the noise and the phases of the pump's ripple to come."""

    def __init__(
        self,
        sensors: Mapping[str, ExternalSensor],
        faults: Sequence[Fault],
        day: Day,
        rng: np.random.Generator,
        phases: np.random.Generator,
    ) -> None:
        self._p_tp, self._p_ap = sensors["y_p_tp"], sensors["y_p_ap"]
        self._faults, self._rng, self._phases = faults, rng, phases
        self._zero_tp, self._zero_ap = (
            float(sensor.noise / ZEROED_OVER**0.5 * rng.standard_normal()) for sensor in (self._p_tp, self._p_ap)
        )
        self._zero_tp += day.zero_p_tp
        self._zero_ap += day.zero_p_ap

    def add(self, known: Knowledge, run: Run, t: float) -> Knowledge:
        """What is `known`, with what the box reads of the run at `t` [s]."""
        after = np.clip(np.searchsorted(run.t, t, side="right"), 1, len(run.t) - 1)
        near = slice(after - 1, after + 1)  # of a whole run, each reading would copy an hour
        p_tp, _, p_ap, p_du = (np.interp(t, run.t[near], pressure) for pressure in run.pressures[near].T)
        if swapped(self._faults, t):
            p_ap = p_du
        ripple = run.ripple[max(int(np.searchsorted(run.ecu_t, t, side="right")) - 1, 0)]
        p_tp += ripple * float(pulse(self._phases.random(1))[0])
        return known._replace(
            p_tp=self._read(self._p_tp, "p_tp", p_tp, self._zero_tp, t),
            p_ap=self._read(self._p_ap, "p_ap", p_ap, self._zero_ap, t),
        )

    def _read(self, sensor: ExternalSensor, name: str, true: float, zero: float, t: float) -> float:
        error = zero + sensor.noise * self._rng.standard_normal() + strength(self._faults, f"fy_{name}", t)
        volts = sensor.convert(np.array([true]), error)
        return reading(self._faults, name, float(np.interp(volts, sensor.volts, sensor.pascal)[0]), t)
