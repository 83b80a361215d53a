"""A bank that holds samples back: outliers leave nothing behind, a step is computed as if it had passed at once."""

from pathlib import Path

import msgspec
import numpy as np

from faultline.service.bundle.load import load_bundle
from faultline.service.core.residuals.generators import GeneratorBank, Residuals
from faultline.service.core.signals.gate import SAMPLES
from faultline.service.core.signals.values import FloatArray

BUNDLE = load_bundle(Path(__file__).parents[2] / "golden" / "bundle")
NAMES = [each.signal for each in BUNDLE.manifest.inputs]
SPEED = NAMES.index("n_p")
TICKS, AT = 80, 40
STEPS_FROM = AT + SAMPLES // 2
"""The tick at which a step at `AT` is one."""


def run(speed: FloatArray, *, gated: bool = True) -> list[Residuals]:
    """The residuals at an operating point, with this speed."""
    manifest = BUNDLE.manifest
    inputs = manifest.inputs if gated else [msgspec.structs.replace(each, outlier=None) for each in manifest.inputs]
    bank = GeneratorBank(BUNDLE.graphs, manifest.generators, inputs, manifest.period_s, manifest.evidence)
    z = np.tile(BUNDLE.golden.z[0], (len(speed), 1))
    z[:, SPEED] = speed
    return [bank.step(sample, np.ones(len(NAMES), dtype=np.bool_)) for sample in z]


def test_the_speed_of_the_pump_is_gated_and_the_dose_is_not() -> None:
    outlier = {each.signal: each.outlier for each in BUNDLE.manifest.inputs}
    assert outlier["n_p"] == 1.0
    assert outlier["dc_dose"] is None


def test_a_step_is_computed_in_hindsight() -> None:
    speed = np.full(TICKS, 20.0)
    speed[AT:] = 26.0
    gated, direct = run(speed), run(speed, gated=False)
    for k, (one, other) in enumerate(zip(gated, direct, strict=True)):
        if not AT <= k < STEPS_FROM:
            np.testing.assert_array_equal(one.r, other.r)
            np.testing.assert_array_equal(one.shift, other.shift)
            assert not one.held.any()
        else:
            assert one.held.any()
    assert any((a.r != b.r).any() for a, b in zip(gated[AT:], direct[AT:], strict=True))


def test_outliers_leave_nothing_behind() -> None:
    clean, speed = np.full(TICKS, 20.0), np.full(TICKS, 20.0)
    speed[[20, 40, 41, 42, 43, 44, 60]] = 60.0
    for one, other in zip(run(speed), run(clean), strict=True):
        np.testing.assert_array_equal(one.r, other.r)
    counted = [one.counted for one in run(speed)]
    assert all((a <= ~b.held).all() for a, b in zip(counted, run(speed), strict=True))
