"""Small and large faults by their effect: what a person at the bench would call just visible, and twice that.

Small is the smallest size that moves a 10 s mean of a pressure or of the pump speed by more than three standard
deviations of that sensor's noise somewhere in the validation cycle (thesis 5.7.2), large one that moves it twice as
far. `python -m faultline.testbench.sizes` finds them and prints the file `sizes.toml`, which is frozen: decision logic
is tuned to none of it.
"""

import tomllib
from collections.abc import Callable
from functools import cache
from importlib import resources

import numpy as np

from faultline.testbench.bus import Knowledge
from faultline.testbench.cycles import CYCLES, DOSING_FROM
from faultline.testbench.faults import FAULTS, Fault, limit
from faultline.testbench.plant import Array
from faultline.testbench.simulation import Run, simulate
from faultline.testbench.undeclared import UNDECLARED
from faultline.testbench.vehicles import BENCH

WINDOW = 10.0  # s
PERIOD = 0.1  # s, of the samples that are averaged
SIGMAS = 3.0
DURATION = 240.0  # s: every dose of the validation cycle comes once
TOLERANCE = 0.005  # of the size


@cache
def frozen() -> dict[str, tuple[float, float]]:
    """The small and the large size of every fault that has a size."""
    table = tomllib.loads(resources.files("faultline.testbench").joinpath("sizes.toml").read_text())
    return {name: (sizes["small"], sizes["large"]) for name, sizes in table["fault"].items()}


def effect(fault: Fault, healthy: Run) -> float:
    """The largest shift of a 10 s mean against the healthy run, in standard deviations of the sensor's noise."""
    run = simulate(BENCH, CYCLES["validation"], [fault], 1, DURATION)
    read = np.array([fault.size * (fault.name == "fy_p_tp"), fault.size * (fault.name == "fy_p_ap"), 0.0, 0.0])
    sensors, external = BENCH.ecu_sensors, BENCH.external
    noise = (external["y_p_tp"].noise, external["y_p_ap"].noise, sensors.noise_p_du, sensors.noise_n_p)
    t = np.arange(DOSING_FROM, DURATION, PERIOD)
    return float((np.abs(means(run, t) + read - means(healthy, t)) / noise).max())


def means(run: Run, t: Array) -> Array:
    """Means of `WINDOW` seconds, one beginning every second of t: of p_tp, p_ap, y_p_du [Pa] and n_p [rev/s].

    Without the added sensors' noise, which no single window should decide about.

    Args:
        run: a run of the rig.
        t: (K,) instants `PERIOD` apart, of the rig's clock [s].

    Returns:
        (windows, 4).
    """
    known = np.searchsorted(run.ecu_t, t, side="right") - 1
    columns = [
        np.interp(t, run.t, run.pressures[:, 0]),
        np.interp(t, run.t, run.pressures[:, 2]),
        run.ecu[known, Knowledge._fields.index("p_du")],
        run.ecu[known, Knowledge._fields.index("n_p")],
    ]
    size, step = round(WINDOW / PERIOD), round(1.0 / PERIOD)
    sums = np.cumsum(np.vstack([np.zeros(4), np.stack(columns, axis=1)]), axis=0)
    return np.asarray((sums[size:] - sums[:-size])[::step] / size)


def found(name: str, healthy: Run) -> tuple[float, float]:
    """The small and the large size of fault `name`; the largest possible one where no size is that visible."""

    def at(size: float) -> float:
        return effect(Fault(name, size, 0.0), healthy)

    largest = limit(name)
    small = _smallest(lambda size: at(size) - SIGMAS, largest)
    return small, _smallest(lambda size: at(size) - 2 * SIGMAS, largest)


def main() -> None:
    """Finds all sizes and prints the file."""
    healthy = simulate(BENCH, CYCLES["validation"], (), 1, DURATION)
    print("# Found by `python -m faultline.testbench.sizes`; frozen before any decision logic was tuned to them.")
    for name, (_, meaning) in FAULTS.items():
        if name.startswith("off_") or name in UNDECLARED:
            continue  # silence has no size, and what nobody has declared nobody looks for
        small, large = found(name, healthy)
        print(f"\n[fault.{name}]  # {meaning}\nsmall = {small:.3g}\nlarge = {large:.3g}", flush=True)


def _smallest(excess: Callable[[float], float], largest: float) -> float:
    """The size where `excess` becomes positive, by bisection of the logarithm; `largest` if it never does."""
    low, high = largest * 1e-5, largest
    if excess(high) < 0.0:
        return largest
    while high > low * (1 + TOLERANCE):
        middle = (low * high) ** 0.5
        low, high = (low, middle) if excess(middle) > 0.0 else (middle, high)
    return high


if __name__ == "__main__":
    main()
