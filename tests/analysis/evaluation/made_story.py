"""A story whose every figure is known: two generators of the golden bundle, made residuals, no graph run."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from faultline.analysis.evaluation.given import Given
from faultline.analysis.evaluation.judge import judge
from faultline.analysis.evaluation.measure.facts import Facts, facts
from faultline.analysis.evaluation.story import Array, Story
from faultline.analysis.evaluation.truth import TrueFault, Truth
from faultline.service.bundle.load import Bundle, load_bundle
from faultline.service.core.records.event import SCHEMA, Diagnosis, Event
from faultline.service.core.signals.values import Mask
from faultline.service.logs import load_recording

IDLE, PARTIAL, MAXIMUM = 1, 2, 3  # indices of the dosing system's modes, behind the edge


GOLDEN = Path(__file__).resolve().parents[2] / "golden"
PERIOD_S = 0.2
NAMES = ("t02.ode", "t08.ode")


def bundle() -> Bundle:
    """The golden one, cut to two generators whose spreads are 1 Pa and whose thresholds are 10."""
    whole = load_bundle(GOLDEN / "bundle")
    replace = msgspec.structs.replace
    rows = [row for row, generator in enumerate(whole.manifest.generators) if generator.name in NAMES]
    detectors = [
        replace(whole.manifest.detectors[row], offset=[0.0] * 4, scale=[1.0] * 4, nu=0.0, J=10.0) for row in rows
    ]
    generators = [whole.manifest.generators[row] for row in rows]
    return whole._replace(manifest=replace(whole.manifest, generators=generators, detectors=detectors))


def story(r: Array, sums: Array, usable: Mask | None = None, mode: Array | None = None) -> Story:
    """K ticks of two generators from residuals and sums (K, 2); else all can tell, under partial dose."""
    K, parts = len(r), sums / 10.0
    return Story(
        bundle=bundle(),
        source="simulated",
        recording="golden",
        events=[],
        t_s=np.array([PERIOD_S * tick for tick in range(K)], dtype=np.float64),
        z=np.zeros((K, 5)),
        r=r,
        level=r,
        y_hat=np.zeros_like(r),
        usable=np.ones(r.shape, dtype=np.bool_) if usable is None else usable,
        sums=parts,
        fired=latched(abs(parts)),
        mode=np.full(K, PARTIAL) if mode is None else mode.astype(np.intp),
        origin_s=0.0,
        end_s=PERIOD_S * (K - 1),
    )


def latched(parts: Array) -> Mask:
    """From reaching 1 until back at 0, for every column (K, T)."""
    fired = np.zeros(parts.shape, dtype=np.bool_)
    standing = np.zeros(parts.shape[1], dtype=np.bool_)
    for k, row in enumerate(parts):
        standing = (standing & (row > 0.0)) | (row >= 1.0)
        fired[k] = standing
    return fired


def event(tick: int, *told: tuple[str, int] | tuple[str, int, float]) -> Event:
    """What is told at a tick: ("fA+fB", rank) or ("fA", rank, p); "" is the unknown."""
    diagnoses = [
        Diagnosis(faults=[n for n in names.split("+") if n], rank=rank, p=p[0] if p else None)
        for names, rank, *p in told
    ]
    return Event(
        schema=SCHEMA,
        id="golden-1",
        seq=1,
        tick=tick,
        t_s=tick * PERIOD_S,
        wall=None,
        transition="occurred" if told else "healed",
        diagnoses=diagnoses,
        alarm=[],
        cannot_tell=[],
        since_tick=None,
        bundle="b",
    )


def known(made: Story, faults: Sequence[str] = (), onset_s: float = 60.0, events: Sequence[Event] = ()) -> Facts:
    """The facts of a story with these faults from `onset_s` on."""
    true = [TrueFault(name=name, size=0.5, onset_s=onset_s, profile="abrupt") for name in faults]
    truth = Truth(schema=1, recording="golden", fault=true)
    verdict = judge(truth, events, ["t02", "t08"], made.origin_s, made.end_s)
    given = Given(GOLDEN / "log", load_recording(GOLDEN / "log"), truth)
    return facts(given, verdict, list(events), made)
