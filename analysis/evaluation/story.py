"""A recording through the whole core, with everything that happened inside kept for the picture."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.bundle import Bundle
from service.core.decision import Decision
from service.core.errors import InputError
from service.core.events import Event
from service.core.monitor import Monitor
from service.core.observer import Tick
from service.logs import Log

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Story:
    """K ticks: samples z (K, nz), residuals and predictions (K, T), whether usable (K, T), CUSUM in parts of J (K, T).

    `t_s` (K,) is log time after the first frame, `origin_s` that of tick 0, `end_s` that of the last one.
    """

    bundle: Bundle
    events: list[Event]
    t_s: Array
    z: Array
    r: Array
    y_hat: Array
    usable: npt.NDArray[np.bool_]
    sums: Array
    origin_s: float
    end_s: float


def tell(bundle: Bundle, log: Log) -> Story:
    """Runs the log through a fresh monitor, as fast as it goes.

    Raises:
        InputError: the log is shorter than the wait for its signals.
    """
    ticks: list[Tick] = []
    sums: list[Array] = []

    def watch(tick: Tick, decision: Decision) -> None:
        ticks.append(tick)
        sums.append(decision.sums)

    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id, watch)
    events = list(monitor.log(log.relative()))
    if not ticks:
        raise InputError(f"{log.id}: ends before its first tick; evaluate on a longer recording")
    return Story(
        bundle=bundle,
        events=events,
        t_s=np.array([tick.t_s for tick in ticks]),
        z=np.array([tick.z for tick in ticks]),
        r=np.array([tick.residuals.r for tick in ticks]),
        y_hat=np.array([tick.residuals.y_hat for tick in ticks]),
        usable=np.array([tick.residuals.usable for tick in ticks]),
        sums=np.array(sums),
        origin_s=ticks[0].t_s,
        end_s=ticks[-1].t_s,
    )
