"""The conditions of a day: what differs from one drive of a vehicle to the next, drawn from the recording's seed.

Between two drives the reductant has another temperature, the sensors' electronics too, and the tank another level. Of
the profiles only `everyday` has days; sizes are assumptions of ours, stated here and in the truth file.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from faultline.testbench.streams import stream
from faultline.testbench.units import MBAR

VISCOSITY_SD = 0.05  # of its logarithm: some 2 degC, 2 to 3 % a degree (32.5 % urea in water near 20 degC)
ZERO_SD = {"p_tp": 1.0, "p_ap": 3.0, "p_du": 3.0}  # mbar: 0.04, 0.02 and 0.02 % of the range
LEVEL_SD = 5.0  # mbar: 5 cm of reductant

DAILY = ("everyday",)
"""The profiles whose recordings have a day of their own."""


@dataclass(frozen=True)
class Day:
    """What is constant over a recording; by default nothing differs.

    `viscosity` is a factor of what laminar parts resist, and the pump's leakage is divided by it; the three zeros [Pa]
    are added to readings: they are what is left after the sensor box's zeroing (`ingest` takes those of a second logger
    away, as it does any constant error); `level` [Pa] is the head in the tank above the rated one.
    """

    viscosity: float = 1.0
    zero_p_tp: float = 0.0
    zero_p_ap: float = 0.0
    zero_p_du: float = 0.0
    level: float = 0.0

    def truth(self) -> Mapping[str, float]:
        """What a truth file says: the factor, and the rest in pascal."""
        return {
            "viscosity": self.viscosity,
            "zero_p_tp_pa": self.zero_p_tp,
            "zero_p_ap_pa": self.zero_p_ap,
            "zero_p_du_pa": self.zero_p_du,
            "level_pa": self.level,
        }


CALM = Day()


def day_of(profile: str, seed: int, cycle: str) -> Day:
    """The day of a recording: that of its seed and cycle, or none in a profile without days."""
    if profile not in DAILY:
        return CALM
    rng = stream(seed, cycle, "day")
    return Day(
        viscosity=math.exp(VISCOSITY_SD * rng.standard_normal()),
        zero_p_tp=float(ZERO_SD["p_tp"] * MBAR * rng.standard_normal()),
        zero_p_ap=float(ZERO_SD["p_ap"] * MBAR * rng.standard_normal()),
        zero_p_du=float(ZERO_SD["p_du"] * MBAR * rng.standard_normal()),
        level=float(LEVEL_SD * MBAR * rng.standard_normal()),
    )
