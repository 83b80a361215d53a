"""A log of hours needs the memory of one of minutes: it is read, decoded and sampled by pieces."""

import tracemalloc
from pathlib import Path

import numpy as np

from faultline.service.bundle.load import load_bundle
from faultline.service.core.j1939.log_context import LogContext
from faultline.service.core.residuals.evaluator import TickByTick
from faultline.service.core.residuals.generators import FRESH, Residuals
from faultline.service.core.residuals.observer import Observer
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.sampling import Sampler
from faultline.service.core.signals.values import FloatArray, Mask
from faultline.service.logs import open_log
from faultline.service.logs.reading import KEPT

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
BETWEEN = 1 << 20
"""Bytes by which the peaks of two logs may differ, as their pieces do."""


def repeated(path: Path, times: int) -> Path:
    """The golden log so many times in a row, as candump's text."""
    parts = [line.split(" ", 1) for line in (GOLDEN / "log" / "can.log").read_text().splitlines()]
    seconds = [float(stamp[1:-1]) for stamp, _ in parts]
    span = seconds[-1] - seconds[0] + 0.1
    with path.open("w") as file:
        for k in range(times):
            file.writelines(f"({t + k * span:.6f}) {rest}\n" for t, (_, rest) in zip(seconds, parts, strict=True))
    return path


class Quiet:
    """Generators that compute nothing: the samples are what is looked at."""

    def step(self, z: FloatArray, usable: Mask, ages: FloatArray = FRESH) -> Residuals:
        none = np.zeros(0)
        return Residuals(none, none, none, np.zeros(0, dtype=np.bool_))


def peak_bytes(path: Path) -> tuple[int, int]:
    """The peak of what Python and numpy hold while a log is read and sampled, and its ticks."""
    bundle = load_bundle(GOLDEN / "bundle")
    manifest = bundle.manifest
    modes = ModeTracker(manifest.modes, manifest.inputs, manifest.period_s)
    observer = Observer(bundle.table, Sampler(manifest.inputs), TickByTick(Quiet(), modes), manifest.period_s, 5.0)
    tracemalloc.start()
    log = open_log(path)
    signals = log.signals(bundle.table, LogContext(log.id).passing)
    ticks = sum(len(row) for piece in signals.pieces() for row in observer.take(piece))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak, ticks


def test_an_hour_needs_no_more_memory_than_ten_minutes(tmp_path: Path) -> None:
    """But for the batches of a short log, which are kept from the first time that it is read."""
    (short, some), (long, many) = (peak_bytes(repeated(tmp_path / f"{n}.log", n)) for n in (5, 30))
    assert many > 5 * some > 10_000
    assert long < short + KEPT + BETWEEN
