"""Whether the duty cycle or the estimated pulses make the better residual input, test by test (thesis 7.3, 7.5.1).

Every residual generator that uses the command runs twice over the same samples: with the duty cycle, and with the
share in which the actuator was on of the sample period that ends when the predicted signal was sampled. (Up to the
tick, which is some 50 ms later, the ripple of model and sensor are out of step, and the pulses often do harm.) In the
mode that holds where no other does the residuals of a fault-free recording are errors: the input that leaves the
smaller variance is the better one.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from faultline.analysis.graph.bank import Bank
from faultline.analysis.recordings.pulse import Pulse, PulseError
from faultline.analysis.recordings.track import Mask, Track
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import ticks_of

BLOCK = 50  # ticks, 10 s, which hardly know of each other
MATTERS = 0.02  # of the variance
CLEARLY = 2.0  # standard errors between the mean squares

Better = Literal["duty cycle", "pulses", "neither"]


class InputChoice(NamedTuple):
    """Of one test: RMS of its residual about its mean with either input, in the unit of `predicts`.

    `variance_ratio` is that with the pulses over that with the duty cycle; `better` is the input with the smaller
    variance, neither where the difference is small or within its scatter.
    """

    test: str
    predicts: str
    rms_duty: float
    rms_pulses: float
    variance_ratio: float
    better: Better


def choose_input(
    bank: Bank, ticks: Sequence[Tick], pulse: Pulse, tracks: Mapping[str, Track], signal: str
) -> list[InputChoice]:
    """The better input of every test of the bank that uses `signal`, by the fault-free `ticks` of one recording.

    `tracks` (of `tracks_of`) has that signal and those that tests predict, as they were sampled; the bank has the
    parameters that belong to the vehicle.

    Raises:
        PulseError: there are not two blocks of that mode in which all signals are known.
    """
    column = [channel.signal for channel in bank.inputs].index(signal)
    some = bank.only([k for k, generator in enumerate(bank.generators) if signal in generator.inputs])
    usable = np.array([tick.usable.all() for tick in ticks])
    model = bank.model
    rest, warm_up = model.modes.names.index(model.modes.rest.name), ticks_of(model.warm_up_s, model.period_s)
    counted = _counted(ticks, usable, rest, warm_up)
    if counted.sum() < 2 * BLOCK:
        raise PulseError(
            f"the inputs cannot be compared: {counted.sum() * model.period_s:.0f} s of mode "
            f"{model.modes.rest.name} with all signals known, {2 * BLOCK * model.period_s:g} s are needed"
        )
    first = int(np.argmax(usable))
    latest = np.maximum.accumulate(np.where(usable[first:], np.arange(first, len(ticks)), first))
    z = np.array([ticks[k].z for k in latest])
    t = np.array([tick.t_s for tick in ticks[first:]])

    def residuals(inputs: FloatArray) -> FloatArray:
        return np.asarray(some.simulate([{}], inputs, some.start(z[0]))[counted[first:], 0])

    with_duty, with_pulses = residuals(z), {}
    for predicted in {generator.predicts for generator in some.generators}:
        pulsed, at = z.copy(), tracks[predicted].t
        sampled = at[np.maximum(np.searchsorted(at, t, side="right") - 1, 0)]
        pulsed[:, column] = pulse.share(tracks[signal], sampled, model.period_s)
        with_pulses[predicted] = residuals(pulsed)
    return [
        _choice(generator.test, generator.predicts, with_duty[:, k], with_pulses[generator.predicts][:, k])
        for k, generator in enumerate(some.generators)
    ]


def _counted(ticks: Sequence[Tick], usable: Mask, mode: int, warm_up: int) -> Mask:
    """Ticks of a mode that are a warm-up away from whatever could not be used."""
    counted = np.array([tick.mode == mode for tick in ticks]) & usable
    last = -1
    for k in range(len(ticks)):
        last = k if not usable[k] else last
        counted[k] &= k - last > warm_up
    return np.asarray(counted)


def _choice(test: str, predicts: str, duty: FloatArray, pulses: FloatArray) -> InputChoice:
    square_duty, square_pulses = ((r - r.mean()) ** 2 for r in (duty, pulses))
    difference = square_pulses - square_duty
    blocks = np.array([block.mean() for block in np.array_split(difference, len(difference) // BLOCK)])
    error = float(blocks.std(ddof=1)) / len(blocks) ** 0.5
    ratio = float(square_pulses.mean() / max(square_duty.mean(), 1e-12))
    better: Better = "neither"
    if abs(ratio - 1.0) > MATTERS and abs(float(blocks.mean())) > CLEARLY * error:
        better = "duty cycle" if blocks.mean() > 0 else "pulses"
    return InputChoice(
        test,
        predicts,
        float(square_duty.mean() ** 0.5),
        float(square_pulses.mean() ** 0.5),
        ratio,
        better,
    )
