"""Intervals by the profile likelihood: of a time constant that is the point, and of one that no recording shows."""

import dataclasses
from functools import cache

import numpy as np
from made_runs import tanks

from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.library import effect_of
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.discrepancy.name.attempt import Attempt, Begin, Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.profile import Ends
from faultline.analysis.discrepancy.show.sizes import sizes
from faultline.analysis.model import load_model
from faultline.analysis.model.display import units_of

TANKS = load_model("three-tank")
RECORDED_S = 600.0
DRIFT = {
    "name": "drift",
    "statement": "the pump delivers more and more, and settles",
    "component": "pump",
    "source": "made",
    "signature": "",
    "parameter": {
        "k": {"unit": "1", "description": "part in the end", "null": 0.0, "spread": 0.3},
        "T": {"unit": "s", "description": "time constant", "value": 600.0, "prior": 0.5, "min": 20.0, "max": 1e5},
    },
    "unknown": {
        "x": {"unit": "1", "description": "share that is done", "initial": ["0"]},
        "dx": {"unit": "1/s"},
    },
    "change": [{"where": ["k_pump", "u"], "replace": "u -> u*(1 + k*x)"}],
    "equation": [{"name": "settles", "description": "the drift settles", "expr": "dx - (1 - x)/T"}],
    "differential": [{"name": "d", "state": "x", "derivative": "dx"}],
}


@cache
def searched(time_s: float, seed: int = 1) -> tuple[Effect, Attempt, dict[str, Ends], float]:
    """The effect, the best attempt with it and its intervals; and its true part, from where the recording begins."""
    effect, whole = effect_of(DRIFT, "here"), 1.0
    done = 1.0 - 0.7 * np.exp(-RECORDED_S / time_s)  # while the rig ran in, from 0.3 on
    true = rewritten(TANKS, effect)
    begin = TANKS.parameters["k_pump"].value / (1.0 + whole * done)  # so that the recording begins as is expected
    values = {"drift_k": whole, "drift_T": time_s, "k_pump": begin}
    parameters = {n: dataclasses.replace(p, value=values.get(n, p.value)) for n, p in true.parameters.items()}
    true = dataclasses.replace(true, parameters=parameters)
    training, held = (tuple(tanks(TANKS, {}, s, true).sections) for s in (seed, seed + 1000))
    study = Study("made", TANKS, {"drift": effect}, training, held)
    baseline = baseline_of(study)
    judge = Judge(study, baseline)
    nominal = judge.attempt(())
    begins = (Begin(nominal.unknowns, nominal.x), Begin(nominal.unknowns, np.zeros_like(nominal.x), typical=True))
    best = min((judge.attempt(("drift",), begin) for begin in begins), key=lambda attempt: attempt.cost)
    assert best.evidence > nominal.evidence + 10.0
    return effect, best, judge.intervals(best), whole * (1.0 - done) / (1.0 + whole * done)


def test_a_time_constant_that_the_recording_shows_is_within_two_ends() -> None:
    _, _, found, part = searched(400.0)
    low, high = found["drift_T"]
    assert low is not None
    assert high is not None
    assert low < 400.0 < high < 2000.0
    low, high = found["drift_k"]
    assert low is not None
    assert high is not None
    assert low < part < high


def test_one_of_seven_times_the_recording_is_known_from_below_only() -> None:
    """The wound: by the curvature, with what is usual in it, the interval left the truth far outside."""
    effect, best, found, part = searched(4000.0)
    usual = {size.parameter: size.interval for size in sizes(best, {"drift": effect}, units_of(TANKS))}
    for name, true in (("drift_T", 4000.0), ("drift_k", part)):
        _, high = usual[name] or (None, None)
        assert high is not None
        assert high < true
    low, high = found["drift_T"]
    assert low is not None
    assert low < 4000.0
    assert high is None
    low, high = found["drift_k"]
    assert low is not None
    assert low < part
    assert high is None or high > part
    words = {s.parameter: s.words for s in sizes(best, {"drift": effect}, units_of(TANKS), found)}
    assert "(95 %: at least " in words["drift_T"]
    assert words["drift_T"].endswith("; beyond, they do not say)")
