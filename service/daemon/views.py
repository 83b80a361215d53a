"""Messages made of the service's state: buses, systems, what their names mean, and the newest tick."""

import msgspec
import numpy as np

from faultline.service.core.records.discrimination import separations
from faultline.service.core.records.line import encode
from faultline.service.core.signals.values import FloatArray, Quality
from faultline.service.daemon.fault_recorder import SystemState
from faultline.service.daemon.pipeline import BusChannel
from faultline.service.protocol.answers import BaselineStatus, BusStatus, SystemStatus
from faultline.service.protocol.live import (
    DisturbanceMeaning,
    EquationMeaning,
    FaultMeaning,
    GeneratorMeaning,
    LiveTick,
    Signal,
    SystemDescription,
)


def bus_status(line: BusChannel) -> BusStatus:
    """Return the status of a bus, with its counts."""
    counts = line.bus.counts
    return BusStatus(
        name=line.name,
        interface=line.interface,
        frames=counts.frames,
        dropped=line.bus.dropped,
        errors=counts.errors,
        trouble=line.bus.trouble,
    )


def system_status(here: SystemState) -> SystemStatus:
    """Return the status of a system and of its tests."""
    latest = here.recorder.latest
    named = SystemStatus(
        baseline=baseline_status(here),
        name=here.name,
        bundle=here.bundle.id,
        bus=here.line.name,
        cannot_tell=[generator.test for generator in here.bundle.manifest.generators],
    )
    if latest is None:
        return named
    return msgspec.structs.replace(
        named,
        tick=latest.tick,
        alarm=latest.alarm,
        cannot_tell=latest.cannot_tell,
        suspected=latest.suspected,
        anomaly=latest.suspicious,
        diagnoses=latest.diagnoses,
    )


def baseline_status(here: SystemState) -> BaselineStatus | None:
    """Return what replaces the bundle's baseline; None where nothing does."""
    baseline = here.watched.baseline
    if baseline is None:
        return None
    return BaselineStatus(
        since=baseline.begun, by=baseline.by, learnt=baseline.moved is not None, wanting=here.watched.wanting
    )


def description(here: SystemState) -> SystemDescription:
    """Return what the names of a bundle mean."""
    manifest = here.bundle.manifest
    return SystemDescription(
        name=here.name,
        bundle=here.bundle.id,
        version=manifest.version,
        sensor_set=manifest.sensor_set,
        period_s=manifest.period_s,
        settling_s=manifest.settling_s,
        modes=[*manifest.modes.names],
        instructions={mode.name: mode.instruction for mode in manifest.modes.steady if mode.instruction},
        inputs=msgspec.convert(manifest.inputs, list[Signal], from_attributes=True),
        generators=msgspec.convert(manifest.generators, list[GeneratorMeaning], from_attributes=True),
        detectors=msgspec.to_builtins(manifest.detectors),
        faults=msgspec.convert(manifest.faults, list[FaultMeaning], from_attributes=True),
        disturbances=msgspec.convert(manifest.disturbances, list[DisturbanceMeaning], from_attributes=True),
        equations=msgspec.convert(manifest.equations, list[EquationMeaning], from_attributes=True),
    )


def live_tick(here: SystemState, sent: int) -> tuple[int, bytes] | None:
    """Return the newest tick of a system, by its number, as a line; None if that was `sent`, or there is none."""
    latest = here.recorder.latest
    if latest is None or latest.tick == sent:
        return None
    manifest = here.bundle.manifest
    tick = LiveTick(
        system=here.name,
        bundle=here.bundle.id,
        tick=latest.tick,
        t_s=round(latest.tick * manifest.period_s, 3),
        mode=manifest.modes.names[latest.mode],
        z=_numbers(latest.z),
        quality=[Quality(each).name.lower() for each in latest.quality],
        y_hat=_numbers(latest.y_hat),
        r=_numbers(latest.r),
        sigma=_numbers(latest.sigma),
        sums=_numbers(latest.sums),
        usable=latest.usable.tolist(),
        alarm=latest.alarm,
        cannot_tell=latest.cannot_tell,
        suspected=latest.suspected,
        anomaly=latest.suspicious,
        diagnoses=latest.diagnoses,
        separating=separations(manifest.generators, latest.diagnoses, latest.cannot_tell),
    )
    return latest.tick, encode(tick)


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values]
