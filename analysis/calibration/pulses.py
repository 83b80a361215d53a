"""For a calibration's report: would the valve's pulses make a better residual input than the duty cycle (7.5.1)?"""

import msgspec

from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import Model
from faultline.analysis.recordings.observe import observe
from faultline.analysis.recordings.pulse import estimate_pulse
from faultline.analysis.recordings.pulse_input import InputChoice, choose_input
from faultline.analysis.recordings.track import tracks_of
from faultline.service.core.errors import InputError
from faultline.service.logs import Log

AFTER_PUMP, IN_UNIT = "y_p_ap", "y_p_du"
"""The pressures in which the valve's ripple shows."""


class Pulses(msgspec.Struct, frozen=True, kw_only=True):
    """The pulses that were made out, and the better input of every test; or the `reason` why that cannot be said."""

    frequency_hz: float | None = None
    tests: tuple[InputChoice, ...] = ()
    reason: str = ""


def pulses(calibrated: Model, log: Log) -> Pulses | None:
    """The comparison over one fault-free recording of the calibrated vehicle; None of a system without such a valve."""
    if not calibrated.modes.bounded or not {AFTER_PUMP, IN_UNIT} <= calibrated.known.keys():
        return None
    dose = calibrated.modes.bounded[0]
    try:
        bank = build_bank(calibrated)
        table = log.table({name: known.unit for name, known in calibrated.known.items()}, log.id)
        tracks = tracks_of(log.signals(table), calibrated.known)
        pulse = estimate_pulse(tracks[AFTER_PUMP], tracks[IN_UNIT], tracks[dose])
        tests = choose_input(bank, observe(bank, log.signals(table)), pulse, tracks, dose)
    except InputError as reason:
        return Pulses(reason=str(reason))
    return Pulses(frequency_hz=pulse.frequency_hz, tests=tuple(tests))


def sentences(found: Pulses) -> list[str]:
    """The comparison as lines of text."""
    if found.frequency_hz is None:
        return [f"the valve's pulses as input: cannot be compared, {found.reason}"]
    lines = [f"the valve's pulses ({found.frequency_hz:.3f} Hz) as input instead of the duty cycle, at partial dose:"]
    lines += [
        f"  {t.test} ({t.predicts}): RMS {t.rms_duty:.0f} with the duty cycle, {t.rms_pulses:.0f} with pulses; "
        f"better: {t.better}"
        for t in found.tests
    ]
    return lines
