"""The decision's native parts give what those of the vehicle give, to within rounding."""

from pathlib import Path

import numpy as np
import pytest

from faultline.analysis.compiled.decision import NativeChangeDetector, NativeCusums, NativeLook
from faultline.service.bundle.load import load_bundle
from faultline.service.core.decision.baseline import BaselineModel
from faultline.service.core.decision.blocks import Block
from faultline.service.core.decision.change_detector import ONSETS, ChangeDetector
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.look import Look
from faultline.service.core.decision.straying import History, Means
from faultline.service.core.detectors.cusum import Cusum, Cusums
from faultline.service.core.manifest import CusumDetector

MANIFEST = load_bundle(Path(__file__).parents[2] / "golden" / "bundle").manifest
EVIDENCE, TIME = MANIFEST.evidence, MANIFEST.time
OFFSET = np.array(EVIDENCE.offset)
MODES, K = OFFSET.shape
NOISE = np.sqrt(np.array(EVIDENCE.noise).diagonal(axis1=1, axis2=2))


def settings(nu: float, J: float, side: str) -> CusumDetector:
    zeros = [0.0] * MODES
    return CusumDetector(generator="t", offset=zeros, scale=zeros, nu=nu, J=J, side=side)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", [Cusums, NativeCusums])
def test_cusums_are_those_of_each_bit_for_bit(kind: type[Cusums], seed: int) -> None:
    rng = np.random.default_rng(seed)
    sides = ["both", "above", "below", "both"]
    of = [
        settings(float(nu), float(J), side)
        for nu, J, side in zip(rng.uniform(0, 1, 4), rng.uniform(2, 9, 4), sides, strict=True)
    ]
    many, each, tick = kind(of), [Cusum(one.nu, one.J, one.side) for one in of], 0
    for _ in range(60):
        n = int(rng.integers(1, 20))
        s = rng.normal(rng.normal(0.0, 1.0, 4), 1.0, (n, 4))
        counted = rng.random((n, 4)) < 0.9
        s[~counted] = rng.choice([np.nan, np.inf])
        ahead = many.ahead(s, counted)
        taken = int(rng.integers(1, n + 1))
        for k in range(taken):
            for one, value, counts in zip(each, s[k], counted[k], strict=True):
                if counts:
                    one.update(tick + k, float(value))
            assert ahead.alarm[k].tolist() == [one.alarm for one in each]
        many.go(tick, ahead, taken)
        tick += taken
        assert many.signed.tolist() == [one.sign * one.value for one in each]
        assert many.since.tolist() == [-1 if one.since is None else one.since for one in each]


def a_block(rng: np.random.Generator, end_s: float, mode: int, *, begins: bool) -> Block:
    """A block of a drive with a small fault, some of which was not seen."""
    count = EVIDENCE.simple
    shift = np.array([h.usual[mode] if h.usual else rng.normal(0.0, 300.0, K) for h in EVIDENCE.hypotheses[:count]])
    ticks = np.where(rng.random(K) < 0.9, 15.0, 0.0)
    ticks[0] = 15.0
    part = np.full((K, K), 1.0 / 15.0)
    mean = OFFSET[mode] + NOISE[mode] * rng.standard_normal(K) + 0.5 * shift[3]
    excess = rng.uniform(0.0, 100.0, K)
    arrays = (np.array(each)[None] for each in (ticks, mean, part, shift, excess))
    return Block(np.array([end_s]), np.array([mode]), np.array([begins]), *arrays)


@pytest.mark.parametrize("seed", range(3))
def test_ratios_of_all_faults_since_all_onsets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model, segments = BaselineModel(EVIDENCE, TIME), Hypotheses(EVIDENCE).segments
    ours, theirs = (kind(model, segments, EVIDENCE.simple) for kind in (NativeChangeDetector, ChangeDetector))
    mode, largest = 1, 0.0
    for k in range(3 * ONSETS):
        begins = k == 0 or rng.random() < 0.2
        mode = int(rng.integers(1, MODES)) if begins else mode
        block = a_block(rng, 3.0 * (k + 1), mode, begins=begins)
        ratio, fault, onset = ours.step(block)
        expected = theirs.step(block)
        np.testing.assert_allclose(ratio, expected.log_ratio, rtol=1e-7, atol=1e-7)
        assert (fault, onset) == (expected.fault, expected.onset)
        for mine, reference in zip(ours.filter.state, theirs.filter.state, strict=True):
            np.testing.assert_allclose(mine, reference, rtol=1e-7, atol=1e-7 * np.abs(reference).max())
        largest = max(largest, float(ratio[0]))
        if k == 2 * ONSETS:
            for each in (ours, theirs):
                each.forget_onsets(theirs.filter.state)
    assert largest > 1.0


@pytest.mark.parametrize("seed", range(5))
def test_looks_at_a_window(seed: int) -> None:
    rng = np.random.default_rng(seed)
    C, H, N = MODES - 1, len(EVIDENCE.hypotheses), 7
    ticks = np.repeat(rng.integers(0, 200, (C, 1)), K, axis=1).astype(float)
    ticks[0] = 150.0
    shift = rng.normal(0.0, 500.0, (H, C, K)) * ticks
    zeros = np.zeros((C, K))
    total = ticks * (OFFSET[1:] + 300.0 * rng.standard_normal((C, K)))
    brought = np.zeros((len(EVIDENCE.consequences), C, K)) + ticks
    means = Means(ticks, 5.0 * ticks, total, ticks * np.array(EVIDENCE.operation)[1:], shift, brought, zeros)
    parts = rng.dirichlet(np.ones(N))[:, None, None]
    history = History(ticks * parts, np.linspace(900.0, 5.0, N), shift * parts[..., None])
    ours, theirs = (Hypotheses(EVIDENCE, look=kind).look(means, history=history) for kind in (NativeLook, Look))
    assert ours is not None
    assert theirs is not None
    for name in ("faults", "growing_or_not", "pairs"):
        expected = getattr(theirs, name)
        assert getattr(ours, name) == pytest.approx(expected, rel=1e-7, abs=1e-7), name
    for fault in theirs.faults:
        np.testing.assert_allclose(ours.profile(fault).misfits, theirs.profile(fault).misfits, rtol=1e-7)
