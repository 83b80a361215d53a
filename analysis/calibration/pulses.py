"""For a calibration's report: would the actuator's pulses make a better residual input than the duty cycle (7.5.1)?"""

import msgspec

from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import Model
from faultline.analysis.recordings.observe import observe
from faultline.analysis.recordings.pulse import estimate_pulse
from faultline.analysis.recordings.pulse_input import InputChoice, choose_input
from faultline.analysis.recordings.track import tracks_of
from faultline.service.core.errors import InputError
from faultline.service.logs import Log


class Pulses(msgspec.Struct, frozen=True, kw_only=True):
    """The pulses of `command` that were made out, and in `mode` the better input of every test.

    Or the `reason` why that cannot be said.
    """

    command: str
    mode: str
    frequency_hz: float | None = None
    tests: tuple[InputChoice, ...] = ()
    reason: str = ""


def pulses(calibrated: Model, log: Log) -> Pulses | None:
    """The comparison over one fault-free recording of the calibrated vehicle; None of a system without a bench."""
    setup = calibrated.bench
    if setup is None:
        return None
    mode = calibrated.modes.rest.name
    try:
        bank = build_bank(calibrated)
        table = log.table({name: known.unit for name, known in calibrated.known.items()}, log.id)
        tracks = tracks_of(log.signals(table), calibrated.known)
        pulse = estimate_pulse(tracks[setup.follower], tracks[setup.reference], tracks[setup.command], setup)
        tests = choose_input(bank, observe(bank, log.signals(table)), pulse, tracks, setup.command)
    except InputError as reason:
        return Pulses(command=setup.command, mode=mode, reason=str(reason))
    return Pulses(command=setup.command, mode=mode, frequency_hz=pulse.frequency_hz, tests=tuple(tests))


def sentences(found: Pulses) -> list[str]:
    """The comparison as lines of text."""
    if found.frequency_hz is None:
        return [f"the pulses of {found.command} as input: cannot be compared, {found.reason}"]
    lines = [
        f"the pulses of {found.command} ({found.frequency_hz:.3f} Hz) as input instead of the duty cycle, "
        f"in mode {found.mode}:"
    ]
    lines += [
        f"  {t.test} ({t.predicts}): RMS {t.rms_duty:.0f} with the duty cycle, {t.rms_pulses:.0f} with pulses; "
        f"better: {t.better}"
        for t in found.tests
    ]
    return lines
