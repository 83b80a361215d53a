"""Calibrates the added sensors' zero where the pump stands still at the start: there every pressure is the ambient one.

The error of an added sensor is mostly its zero (mounting, ageing); the slope is taken from the datasheet. Deviations
that all sensors share, the controller's own too, are the ambient pressure's and not the sensors'.
"""

from collections.abc import Iterable

import numpy as np

from faultline.service.core.errors import InputError
from faultline.service.core.signals.values import FloatArray

ATMOSPHERE = 101_325.0  # Pa, what the project's model takes for the tank too
TURNING = 0.5  # rev/s, from which the pump runs
LEAST_S = 5.0  # a shorter standstill is not averaged over
LEAST_COUNT = 10  # readings
MARGIN_S = 1.0  # before the pump starts; also covers the clocks' alignment
PRESSURISED = 0.2e5  # Pa: y_p_du this far from atmospheric is a system that has not drained
STEADY = 0.05e5  # Pa: a standing column is quieter
PLAUSIBLE = 0.5e5  # Pa: a larger error is no zero error but a fault
IMPOSSIBLE = 0.8e5  # Pa: and a still larger one is another sensor, unit or table
OUTLIER = 4.0  # standard deviations
RUNNING = 5e5  # Pa: y_p_du from which the system is under pressure
WEATHER = 4e3
"""Pa: how far weather moves the ambient pressure from the standard one at sea level; altitude moves it further."""
UPHILL = 1.5e5  # Pa: fluid does not flow to a pressure that is so much higher, nor is a biased sensor so wrong


class LevelError(InputError):
    """A sensor that reads at atmospheric pressure what it cannot."""


def standstill(t: FloatArray, n_p: FloatArray, y_p_du: FloatArray, ambient: float = ATMOSPHERE) -> float:
    """Until when [s] the pump stands still in a drained system from the first sample on; 0 where it is too short.

    `t`, `n_p` [rev/s] and `y_p_du` [Pa] are (N,) samples from the CAN log, `ambient` [Pa] is the pressure around it.
    """
    turning = np.flatnonzero(n_p > TURNING)
    end = float(t[turning[0]] if len(turning) else t[-1]) - MARGIN_S
    inside = t <= end
    if end - t[0] < LEAST_S or abs(float(np.median(y_p_du[inside])) - ambient) > PRESSURISED:
        return 0.0
    return end


def ambient_seen(added: Iterable[FloatArray], y_p_du: FloatArray) -> float:
    """Return the ambient pressure [Pa] by readings (N,) [Pa] at standstill; the standard one unless all contradict it.

    They do where y_p_du, which the controller trims itself, lies further from it than weather goes, and each of the
    `added` sensors lies nearer to y_p_du than to it.
    """
    off = zero_error(y_p_du)
    errors = [error for error in map(zero_error, added) if error is not None]
    alike = off is not None and bool(errors) and all(abs(error - off) <= abs(error) for error in errors)
    return ATMOSPHERE + off if off is not None and alike and abs(off) > WEATHER else ATMOSPHERE


def check_level(pressure: FloatArray, where: str, ambient: float = ATMOSPHERE) -> None:
    """Refuses readings (N,) [Pa] at standstill, NaN left out, that are steady and far from `ambient` [Pa].

    Raises:
        LevelError: the message starts with `where`.
    """
    known = pressure[np.isfinite(pressure)]
    if len(known) >= LEAST_COUNT and abs(float(np.median(known)) - ambient) > IMPOSSIBLE:
        raise LevelError(
            f"{where} reads {np.median(known) / 1e5:.2f} bar at standstill, where it is {ambient / 1e5:.2f} bar; check "
            "that column, unit and table are this sensor's and not another's, or leave a broken sensor out of "
            "external.tables"
        )


def check_drop(p_ap: FloatArray, p_du: FloatArray, where: str) -> None:
    """Refuses y_p_ap (N,) [Pa] if, under pressure, it is far below y_p_du (M,), which is downstream of it.

    NaN are left out. The clocks need not be known: a wrong table may be why they cannot be.

    Raises:
        LevelError: the message starts with `where`.
    """
    before, behind = p_ap[p_ap > 2 * ATMOSPHERE], p_du[p_du > RUNNING]
    if min(len(before), len(behind)) < LEAST_COUNT:
        return
    drop = float(np.median(before) - np.median(behind))
    if drop < -UPHILL:
        raise LevelError(
            f"{where} reads {-drop / 1e5:.1f} bar less than y_p_du, downstream of it, while the pump runs; check that "
            "column, unit and table are this sensor's and of this drive, or leave a broken sensor out"
        )


def zero_error(pressure: FloatArray, ambient: float = ATMOSPHERE) -> float | None:
    """Mean reading less the ambient pressure [Pa], without outliers; None where it cannot be a zero error.

    `pressure` (N,) [Pa] are the sensor's readings at standstill; NaN are left out.
    """
    known = pressure[np.isfinite(pressure)]
    if len(known) < LEAST_COUNT:
        return None
    middle = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - middle)))
    error = float(known[np.abs(known - middle) <= OUTLIER * spread + 1e-9].mean()) - ambient
    return None if spread > STEADY or abs(error) > PLAUSIBLE else error
