"""A recording through the whole core, with everything that happened inside kept for the picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.service.bundle.load import Bundle
from faultline.service.core.decision.blocks import Block, BlockMeans
from faultline.service.core.decision.decision import Decision
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Event
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.values import Mask
from faultline.service.logs import Log

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Story:
    """K ticks: samples z (K, nz); residuals, predictions, whether usable and whether the detector alarms, each (K, T).

    `source` says where the recording comes from, None of a bare log. `level` (K, T) are the residuals without the day,
    which detectors test; `sums` (K, T) the detectors' in parts of their thresholds, with sign. `t_s` (K,) is log time
    after the first frame, `mode` (K,) indices of `MODES`, `origin_s` the time of tick 0, `end_s` that of the last one.
    Columns are generators, in the manifest's order. `blocks` are the means that the decision goes by.
    """

    bundle: Bundle
    recording: str
    source: str | None
    events: list[Event]
    t_s: Array
    z: Array
    r: Array
    level: Array
    y_hat: Array
    usable: Mask
    sums: Array
    fired: Mask
    mode: npt.NDArray[np.intp]
    origin_s: float
    end_s: float
    blocks: Sequence[Block] = ()

    @property
    def standardised(self) -> Array:
        """The residuals as detectors see them (K, T): off their fault-free offset, in spreads of their mode."""
        detectors = self.bundle.manifest.detectors[: self.r.shape[1]]  # more may follow, which test no level
        offset = np.array([detector.offset for detector in detectors])  # (T, modes)
        scale = np.array([detector.scale for detector in detectors])
        return np.asarray((self.level - offset[:, self.mode].T) / scale[:, self.mode].T)

    @property
    def alarm(self) -> Mask:
        """Whether each generator's detector alarms and can tell (K, T)."""
        return self.fired & self.usable


def tell(bundle: Bundle, log: Log) -> Story:
    """Runs the log through a fresh monitor, as fast as it goes.

    Raises:
        InputError: the log is shorter than the wait for its signals.
    """
    ticks: list[Tick] = []
    levels: list[Array] = []
    sums: list[Array] = []
    fired: list[Mask] = []
    blocks: list[Block] = []
    manifest = bundle.manifest
    cut = BlockMeans(manifest.evidence, [generator.name for generator in manifest.generators], manifest.time)

    def watch(tick: Tick, decision: Decision) -> None:
        ticks.append(tick)
        levels.append(decision.level)
        sums.append(decision.sums)
        fired.append(decision.fired)
        if (block := cut.add(tick.number, tick.mode, tick.residuals)) is not None:
            blocks.append(block)

    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id, watch)
    events = list(monitor.signals(log.signals(bundle.table)))
    if not ticks:
        raise InputError(f"{log.id}: ends before its first tick; evaluate on a longer recording")
    return Story(
        bundle=bundle,
        recording=log.id,
        source=log.recording.source if log.recording else None,
        events=events,
        t_s=np.array([tick.t_s for tick in ticks]),
        z=np.array([tick.z for tick in ticks]),
        r=np.array([tick.residuals.r for tick in ticks]),
        level=np.array(levels),
        y_hat=np.array([tick.residuals.y_hat for tick in ticks]),
        usable=np.array([tick.residuals.usable for tick in ticks]),
        sums=np.array(sums),
        fired=np.array(fired),
        mode=np.array([tick.mode for tick in ticks]),
        origin_s=ticks[0].t_s,
        end_s=ticks[-1].t_s,
        blocks=blocks,
    )
