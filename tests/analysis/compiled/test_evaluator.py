"""Native code of a bundle: ticks as the vehicle has them to within rounding, and events equal to its in every byte."""

from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import NamedTuple

import numpy as np
import pytest

from faultline.analysis.compiled import apart
from faultline.analysis.compiled.apart import kernels_apart
from faultline.analysis.compiled.decision import NATIVE
from faultline.analysis.compiled.evaluator import CompiledEvaluator
from faultline.analysis.compiled.kernels import Kernels, ToCompileError
from faultline.service.bundle.load import Bundle, load_bundle, load_with_log
from faultline.service.core.decision.parts import PARTS
from faultline.service.core.manifest import Evidence, Generator, Input, Modes
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.line import encode
from faultline.service.core.residuals.evaluator import Evaluator, TickByTick
from faultline.service.core.residuals.generators import GeneratorBank, Residuals
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.values import FloatArray

GOLDEN = Path(__file__).parents[2] / "golden"
BUNDLE = load_bundle(GOLDEN / "bundle")
MANIFEST = BUNDLE.manifest
LINES = (GOLDEN / "log" / "can.log").read_text().splitlines()
WEIGHED = [[each.name for each in MANIFEST.generators].index(name) for name in MANIFEST.evidence.generators]
TICKS = 1500
APART_PA = 1.0
"""How far residuals may lie apart, where pressures jump by 1e6 Pa: sums are formed in another order. In drives it is
2e-5 Pa, and noise is hundreds."""


class Alone(NamedTuple):
    """Stands in for a manifest, with hypotheses or without."""

    generators: list[Generator]
    inputs: list[Input]
    modes: Modes
    period_s: float
    evidence: Evidence | None


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Kernels]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield kernels_apart(BUNDLE, GOLDEN / "bundle", GOLDEN / "log")


def test_another_process_compiled_them(kernels: Kernels) -> None:
    for function in (kernels.tests, kernels.hypotheses):
        stats = function.stats  # type: ignore[attr-defined]
        assert stats.cache_hits
        assert not sum(stats.cache_misses.values())


def test_what_another_process_could_not_compile_is_compiled_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    asked = []

    def compiled(bundle: Bundle, *, compiling: bool = True) -> str:
        asked.append(compiling)
        if not compiling:
            raise ToCompileError("this was never compiled")
        return "kernels"

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(apart, "kernels_of_bundle", compiled)
    found: object = kernels_apart(BUNDLE, tmp_path / "no bundle", GOLDEN / "log")
    assert found == "kernels"
    assert asked == [False, False, True]
    assert "no bundle" in caplog.text


def events(path: Path, evaluator: GeneratorBank | Evaluator) -> bytes:
    bundle, log = load_with_log(GOLDEN / "bundle", path, None)
    parts = NATIVE if isinstance(evaluator, CompiledEvaluator) else PARTS
    monitor = Monitor(MANIFEST, evaluator, bundle.table, log.id, bundle.id, parts=parts)
    return b"".join(map(encode, monitor.signals(log.signals(bundle.table))))


def test_events_of_the_golden_log(kernels: Kernels) -> None:
    assert events(GOLDEN / "log", CompiledEvaluator(MANIFEST, kernels)) == (GOLDEN / "events.jsonl").read_bytes()


def damaged(seed: int) -> list[str]:
    """The golden log with a few kinds of damage: each concerns one identifier for some seconds."""
    rng, lines = Random(seed), list(LINES)  # noqa: S311 - it decides where damage is
    names = sorted({line.split(" ")[2].partition("#")[0] for line in lines})
    for _ in range(6):
        begin, count = rng.randrange(len(lines)), rng.choice([1, 20, 400, 3000])
        name, kind, last = rng.choice(names), rng.choice(["gone", "frozen", "not available", "bits", "off"]), ""
        for k in range(begin, min(begin + count, len(lines))):
            head, mark, data = lines[k].partition("#")
            if not head.endswith(name):
                continue
            last = last or data
            number = int(data, 16)
            changed = {
                "gone": "",
                "frozen": last,
                "not available": "F" * len(data),
                "bits": f"{number ^ 1 << rng.randrange(4 * len(data)):0{len(data)}X}",
                "off": f"{min(number + (5 << 4 * len(data) - 12), 16 ** len(data) - 1):0{len(data)}X}",
            }[kind]
            lines[k] = f"{head}{mark}{changed}" if changed else ""
    return [line for line in lines if line]


@pytest.mark.parametrize("seed", range(8))
def test_events_of_damaged_logs(seed: int, kernels: Kernels, tmp_path: Path) -> None:
    path = tmp_path / "can.log"
    path.write_text("\n".join(damaged(seed)) + "\n")
    assert events(path, CompiledEvaluator(MANIFEST, kernels)) == events(path, BUNDLE.bank())


def values(residuals: Residuals) -> Iterator[FloatArray]:
    """Those of the tests that can tell: outside the operating region others are anything."""
    yield from (each[residuals.usable] for each in (residuals.r, residuals.y_hat, residuals.sigma))
    yield residuals.shift[:, residuals.usable[WEIGHED]]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("evidence", [MANIFEST.evidence, None], ids=["hypotheses", "none"])
def test_ticks_of_samples_that_jump_go_missing_and_leave_the_operating_region(
    seed: int, evidence: Evidence | None, kernels: Kernels
) -> None:
    rng = np.random.default_rng(seed)
    lower, upper = (np.array([getattr(each, bound) for each in MANIFEST.inputs]) for bound in ("lower", "upper"))
    shape = TICKS, len(MANIFEST.inputs)
    operations = np.array(BUNDLE.golden.z)  # what no system has makes pressures of 1e10 Pa
    z = np.repeat(operations[rng.integers(len(operations), size=TICKS // 50)], 50, axis=0)
    z[600:650] = upper + (upper - lower)
    z += (upper - lower) * rng.normal(0.0, 0.002, shape)
    z += np.where(rng.random(shape) < 0.01, rng.normal(0.0, 1e6, shape), 0.0)
    usable = np.repeat(rng.random((TICKS // 10, shape[1])) < 0.97, 10, axis=0) & (rng.random(shape) < 0.99)
    z[~usable] = np.nan
    ages = np.where(rng.random(shape) < 0.03, 1.0, 0.05)
    what = Alone(MANIFEST.generators, MANIFEST.inputs, MANIFEST.modes, MANIFEST.period_s, evidence)
    bank = GeneratorBank(BUNDLE.graphs, what.generators, what.inputs, what.period_s, evidence)
    reference = TickByTick(bank, ModeTracker(MANIFEST.modes, MANIFEST.inputs, MANIFEST.period_s))
    held = counted = 0
    found, expected = (
        [(mode, residuals.at(k)) for modes, residuals in each.evaluate(z, usable, ages) for k, mode in enumerate(modes)]
        for each in (CompiledEvaluator(what, kernels), reference)
    )
    for (mode, ours), (of_reference, theirs) in zip(found, expected, strict=True):
        assert mode == of_reference
        for flags in ("usable", "held", "brought"):
            np.testing.assert_array_equal(getattr(ours, flags), getattr(theirs, flags), flags)
        for values in ("r", "y_hat", "sigma", "shift"):
            np.testing.assert_allclose(getattr(ours, values), getattr(theirs, values), rtol=1e-6, atol=APART_PA)
        held, counted = held + int(ours.held.sum()), counted + int(ours.counted.sum())
    assert held > 100
    assert counted > 1000
