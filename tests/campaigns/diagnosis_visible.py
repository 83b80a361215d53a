"""Whether a fault changes anything that is measured: the same drive with and without it, as only the rig can have it.

A clogged pump filter moves the pressure behind it, which nothing measures. Where the pump does not starve, and no
ripple reaches the sensor before the filter, there is nothing to see, and a diagnosis that is silent is right.
"""

import numpy as np

from faultline.testbench.cycles import DOSING_FROM
from faultline.testbench.request import Request
from faultline.testbench.simulation import Run
from faultline.testbench.sizes import PERIOD, SIGMAS, WINDOW, means

QUIETER = 0.1  # of the spread of y_p_tp: a hundred samples show 14 %


def changes(asked: Request, run: Run, healthy: Run) -> bool:
    """Whether some 10 s mean moves by `SIGMAS` of its sensor's noise after the onset, or the spread of y_p_tp.

    The means are those that sizes by effect are defined by (`testbench/sizes.py`).
    """
    onset = min(fault.onset_s for fault in asked.faults)
    t = np.arange(max(onset, DOSING_FROM), asked.duration, PERIOD)
    external, ecu = asked.vehicle.external, asked.vehicle.ecu_sensors
    noise = np.array([external["y_p_tp"].noise, external["y_p_ap"].noise, ecu.noise_p_du, ecu.noise_n_p])
    shift = np.abs(means(run, t) - means(healthy, t))[:: round(WINDOW)] / noise  # windows that do not overlap
    spread = [np.hypot(noise[0], np.interp(t, r.ecu_t, r.ripple) / 2**0.5).mean() for r in (run, healthy)]
    return bool(shift.max() > SIGMAS or abs(spread[0] / spread[1] - 1.0) > QUIETER)
