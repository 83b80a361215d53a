"""The last ticks of a system, from which freeze frames are cut."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from faultline.service.core.decision.decision import Decision
from faultline.service.core.manifest import Manifest
from faultline.service.core.records.event import Diagnosis, Event
from faultline.service.core.records.freeze_frame import SCHEMA, Excerpt, FreezeFrame, Input, Verdict
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.values import FloatArray, Mask, Qualities, Quality, are_good


class Sample(NamedTuple):
    """Tick with signals (nz,), results of each generator (T,), and the decision.

    `sums` are the generators' detectors in parts of their thresholds, with the residual's sign; `showing` are the modes
    that have shown what is wrong; `suspicious` is true while anything alarms, confirmed or not. The rest as in
    `core.records.event.Event`.
    """

    tick: int
    mode: int
    z: FloatArray
    quality: Qualities
    r: FloatArray
    y_hat: FloatArray
    sigma: FloatArray
    usable: Mask
    sums: FloatArray
    alarm: list[str]
    cannot_tell: list[str]
    diagnoses: list[Diagnosis]
    suspected: bool
    suspicious: bool
    showing: list[str]

    @classmethod
    def of(cls, tick: Tick, decision: Decision) -> "Sample":
        """Return the sample of a tick and its decision."""
        seen = tick.residuals
        return cls(
            *(tick.number, tick.mode, tick.z, tick.quality, seen.r, seen.y_hat, seen.sigma, seen.usable),
            decision.sums,
            decision.alarm,
            decision.cannot_tell,
            decision.diagnoses,
            decision.suspected,
            decision.suspicious,
            decision.showing,
        )


class Recorder:
    """The last ticks of a system. State: so many `seconds` of them, and when each signal was good last."""

    def __init__(self, manifest: Manifest, seconds: float) -> None:
        self._manifest = manifest
        self.ticks = max(1, round(seconds / manifest.period_s))
        self._samples: deque[Sample] = deque(maxlen=3 * self.ticks)  # completed within a third of that
        self._good = np.full(len(manifest.inputs), -1)

    def add(self, sample: Sample) -> None:
        """Takes a tick; one that does not follow the last is of another time."""
        if self._samples and sample.tick != self._samples[-1].tick + 1:
            self._samples.clear()
            self._good[:] = -1
        self._good[are_good(sample.quality)] = sample.tick
        self._samples.append(sample)

    @property
    def latest(self) -> Sample | None:
        """The last tick, None before the first."""
        return self._samples[-1] if self._samples else None

    def frame(self, event: Event, conditions: Sequence[str], counters: Mapping[str, int]) -> FreezeFrame:
        """Return the freeze frame of an event; the excerpt ends with it."""
        last = self._samples[-1]
        manifest, period = self._manifest, self._manifest.period_s
        return FreezeFrame(
            schema=SCHEMA,
            event=event.id,
            wall=event.wall,
            bundle=event.bundle,
            tick=event.tick,
            t_s=event.t_s,
            mode=manifest.modes.names[last.mode],
            inputs=[
                Input(
                    signal=channel.signal,
                    unit=channel.unit,
                    value=_number(last.z[k]),
                    age_s=None if self._good[k] < 0 else round(float(last.tick - self._good[k]) * period, 3),
                    quality=Quality(last.quality[k]).name.lower(),
                )
                for k, channel in enumerate(manifest.inputs)
            ],
            tests=[
                Verdict(
                    generator=generator.name,
                    test=generator.test,
                    predicts=generator.predicts,
                    residual=_short(last.r[k]),
                    predicted=_short(last.y_hat[k]),
                    sigma=_short(last.sigma[k]),
                    sum=_short(last.sums[k]),
                    verdict="cannot tell"
                    if not last.usable[k]
                    else "alarm"
                    if generator.test in last.alarm
                    else "quiet",
                )
                for k, generator in enumerate(manifest.generators)
            ],
            diagnoses=event.diagnoses,
            alarm=event.alarm,
            cannot_tell=event.cannot_tell,
            conditions=[*conditions],
            counters={**counters},
            complete=False,
            excerpt=self._excerpt(event.tick),
        )

    def holds(self, tick: int) -> bool:
        """True if the samples around this tick are recorded still."""
        return bool(self._samples) and self._samples[0].tick <= tick <= self._samples[-1].tick

    def completed(self, frame: FreezeFrame) -> FreezeFrame | None:
        """The frame with what has come since, once that is as long as what was before; None until then.

        It stays as it is where what was recorded has begun anew meanwhile.
        """
        last = self.latest
        if last is None or not self.holds(frame.tick):
            return frame
        if last.tick < frame.tick + self.ticks:
            return None
        return msgspec.structs.replace(frame, complete=True, excerpt=self._excerpt(frame.tick))

    def _excerpt(self, tick: int) -> Excerpt:
        """The ticks around this one."""
        samples = [each for each in self._samples if abs(each.tick - tick) <= self.ticks]
        usable = [are_good(each.quality) for each in samples]
        return Excerpt(
            first_tick=samples[0].tick,
            period_s=self._manifest.period_s,
            mode=[self._manifest.modes.names[each.mode] for each in samples],
            signals={
                channel.signal: [
                    _number(each.z[k]) if good[k] else None for each, good in zip(samples, usable, strict=True)
                ]
                for k, channel in enumerate(self._manifest.inputs)
            },
            residuals={
                generator.name: [_short(each.r[k]) if each.usable[k] else None for each in samples]
                for k, generator in enumerate(self._manifest.generators)
            },
            sums={
                generator.name: [_short(each.sums[k]) for each in samples]
                for k, generator in enumerate(self._manifest.generators)
            },
        )


def _short(value: float) -> float:
    """Six digits, which is more than any sensor has; 0 where it is no number."""
    return float(f"{value:.6g}") if np.isfinite(value) else 0.0


def _number(value: float) -> float | None:
    return _short(value) if np.isfinite(value) else None
