"""Calibrates the added sensors' zero where the system stands still at the start: there all pressures are ambient.

The error of an added sensor is mostly its zero (mounting, ageing); the slope is taken from the datasheet. Deviations
that all sensors share, the controller's own too, are the ambient pressure's and not the sensors'.
"""

from collections.abc import Iterable

import numpy as np

from faultline.analysis.model.bench import BenchSetup
from faultline.service.core.errors import InputError
from faultline.service.core.signals.values import FloatArray

ATMOSPHERE = 101_325.0  # Pa, the standard one
LEAST_S = 5.0  # a shorter standstill is not averaged over
LEAST_COUNT = 10  # readings
MARGIN_S = 1.0  # before the system starts; also covers the clocks' alignment
OUTLIER = 4.0  # standard deviations
WEATHER = 4e3
"""Pa: how far weather moves the ambient pressure from the standard one at sea level; altitude moves it further."""


class LevelError(InputError):
    """A sensor that reads at atmospheric pressure what it cannot."""


def standstill(
    t: FloatArray, drive: FloatArray, reference: FloatArray, setup: BenchSetup, ambient: float = ATMOSPHERE
) -> float:
    """Until when [s] a drained system stands still from the first sample on; 0 where it is too short.

    `t`, `drive` and `reference` [Pa] are (N,) samples from the CAN log, `ambient` [Pa] is the pressure around it.
    """
    turning = np.flatnonzero(drive > setup.drive_above)
    end = float(t[turning[0]] if len(turning) else t[-1]) - MARGIN_S
    inside = t <= end
    if end - t[0] < LEAST_S or abs(float(np.median(reference[inside])) - ambient) > setup.drained_pa:
        return 0.0
    return end


def ambient_seen(added: Iterable[FloatArray], reference: FloatArray, setup: BenchSetup) -> float:
    """Return the ambient pressure [Pa] by readings (N,) [Pa] at standstill; the standard one unless all contradict it.

    They do where the reference, which the controller trims itself, lies further from it than weather goes, and each of
    the `added` sensors lies nearer to the reference than to it.
    """
    off = zero_error(reference, setup)
    errors = [error for each in added if (error := zero_error(each, setup)) is not None]
    alike = off is not None and bool(errors) and all(abs(error - off) <= abs(error) for error in errors)
    return ATMOSPHERE + off if off is not None and alike and abs(off) > WEATHER else ATMOSPHERE


def check_level(pressure: FloatArray, setup: BenchSetup, where: str, ambient: float = ATMOSPHERE) -> None:
    """Refuses readings (N,) [Pa] at standstill, NaN left out, that are steady and far from `ambient` [Pa].

    Raises:
        LevelError: the message starts with `where`.
    """
    known = pressure[np.isfinite(pressure)]
    if len(known) >= LEAST_COUNT and abs(float(np.median(known)) - ambient) > setup.wrong_sensor_pa:
        raise LevelError(
            f"{where} reads {np.median(known) / 1e5:.2f} bar at standstill, where it is {ambient / 1e5:.2f} bar; check "
            "that column, unit and table are this sensor's and not another's, or leave a broken sensor out of "
            "external.tables"
        )


def check_drop(follower: FloatArray, reference: FloatArray, setup: BenchSetup, where: str) -> None:
    """Refuses the follower (N,) [Pa] if, under pressure, it is far below the reference (M,), downstream of it.

    NaN are left out. The clocks need not be known: a wrong table may be why they cannot be.

    Raises:
        LevelError: the message starts with `where`.
    """
    before, behind = follower[follower > 2 * ATMOSPHERE], reference[reference > setup.running_pa]
    if min(len(before), len(behind)) < LEAST_COUNT:
        return
    drop = float(np.median(before) - np.median(behind))
    if drop < -setup.uphill_pa:
        raise LevelError(
            f"{where} reads {-drop / 1e5:.1f} bar less than {setup.reference}, downstream of it, while the system "
            "runs; check that column, unit and table are this sensor's and of this drive, or leave a broken sensor out"
        )


def zero_error(pressure: FloatArray, setup: BenchSetup, ambient: float = ATMOSPHERE) -> float | None:
    """Mean reading less the ambient pressure [Pa], without outliers; None where it cannot be a zero error.

    `pressure` (N,) [Pa] are the sensor's readings at standstill; NaN are left out.
    """
    known = pressure[np.isfinite(pressure)]
    if len(known) < LEAST_COUNT:
        return None
    middle = float(np.median(known))
    spread = 1.4826 * float(np.median(np.abs(known - middle)))
    error = float(known[np.abs(known - middle) <= OUTLIER * spread + 1e-9].mean()) - ambient
    return None if spread > setup.steady_pa or abs(error) > setup.zero_error_pa else error
