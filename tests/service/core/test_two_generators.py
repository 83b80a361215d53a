"""A test with two generators: equations and networks beside each other."""

from pathlib import Path

import msgspec
import numpy as np

from faultline.service.bundle.load import load_bundle
from faultline.service.core.decision.decision import ALONE, Decision
from faultline.service.core.manifest import Manifest
from faultline.service.core.residuals.generators import Residuals

GOLDEN = Path(__file__).parents[2] / "golden" / "bundle"


def doubled() -> Manifest:
    """The golden bundle's first test, twice."""
    manifest = load_bundle(GOLDEN).manifest
    first, detector = manifest.generators[0], manifest.detectors[0]
    second = msgspec.structs.replace(first, name=f"{first.test}.rnn", graph="rnn.onnx")
    return msgspec.structs.replace(
        manifest,
        generators=[*manifest.generators, second],
        detectors=[*manifest.detectors, msgspec.structs.replace(detector, generator=second.name)],
    )


def seen(manifest: Manifest, *, last: float, first: float = 0.0, mute: tuple[int, ...] = ()) -> Residuals:
    """All residuals where they are without a fault, two of them so many spreads away; those `mute` cannot tell."""
    offset, scale = (np.array([getattr(d, part)[1] for d in manifest.detectors]) for part in ("offset", "scale"))
    r = offset.copy()
    r[-1] += last * scale[-1]
    r[0] += first * scale[0]
    usable = np.ones(len(r), dtype=np.bool_)
    usable[list(mute)] = False
    shift = np.zeros((len(manifest.evidence.hypotheses), len(manifest.evidence.generators)))
    return Residuals(r, r, scale, usable, shift, np.zeros(len(manifest.evidence.consequences), dtype=np.bool_))


def test_a_test_alarms_with_one_and_cannot_tell_with_none() -> None:
    manifest = doubled()
    test, last = manifest.generators[-1].test, len(manifest.generators) - 1
    decision = Decision(manifest)
    decision.update(0, 1, seen(manifest, last=0.0, mute=(last,)))
    assert decision.cannot_tell == []
    decision.update(1, 1, seen(manifest, last=0.0, mute=(0, last)))
    assert decision.cannot_tell == [test]
    for tick in range(2, 60):
        decision.update(tick, 1, seen(manifest, last=30.0))
    assert decision.alarm == [test]
    assert decision.cannot_tell == []


def test_an_alarm_that_is_frozen_is_not_told_as_if_nothing_were_wrong() -> None:
    """The wound: a fault was named with no test that alarms, and none that could not tell."""
    manifest = doubled()
    test, last = manifest.generators[-1].test, len(manifest.generators) - 1
    decision = Decision(manifest)
    for tick in range(60):
        decision.update(tick, 1, seen(manifest, last=30.0, first=30.0))
    assert decision.diagnoses
    decision.update(60, 1, seen(manifest, last=0.0, mute=(0, last)))
    assert decision.alarm == []
    assert decision.cannot_tell == [test]
    assert decision.diagnoses


def test_a_deviation_where_no_hypothesis_points_is_told_in_the_end() -> None:
    manifest = doubled()
    nowhere = msgspec.structs.replace(manifest.evidence, hypotheses=[], graph=None)
    without = msgspec.structs.replace(manifest, evidence=nowhere)
    decision = Decision(without)
    for tick in range(200):
        decision.update(tick, 1, seen(without, last=0.0, first=60.0))
    assert decision.confirmed
    assert {name for d in decision.diagnoses for name in d.faults} == set(manifest.generators[0].faults)
    best = max(decision.diagnoses, key=lambda d: d.p or 0.0)
    of_evidence = [set(g.faults) for g in manifest.generators if g.name in manifest.evidence.generators]
    shown_by = {name: sum(name in faults for faults in of_evidence) for name in manifest.generators[0].faults}
    assert shown_by[best.faults[0]] == min(shown_by.values()), "the least other evidence is sensitive to it"


def test_what_networks_alone_suspect_is_told_once_it_has_lasted_and_is_not_confirmed() -> None:
    """Their residuals under a fault cannot be predicted: the equations' must show it too."""
    manifest = doubled()
    decision = Decision(manifest)
    told = []
    for tick in range(200):
        decision.update(tick, 1, seen(manifest, last=30.0))
        told.append((decision.is_open, decision.suspected))
    assert decision.alarm == [manifest.generators[-1].test]
    assert not decision.confirmed
    assert decision.diagnoses == []
    opened, suspected = (np.flatnonzero(each) for each in np.array(told).T)
    assert suspected[0] - opened[0] == manifest.time.ticks(ALONE)
    assert suspected[-1] == len(told) - 1


def test_what_networks_suspect_for_some_seconds_is_not_told() -> None:
    manifest = doubled()
    decision = Decision(manifest)
    told = []
    for tick in range(200):
        decision.update(tick, 1, seen(manifest, last=30.0 if tick < 5 else 0.0))
        told.append((decision.is_open, decision.suspected))
    opened, suspected = np.array(told).T
    assert opened.any()
    assert not suspected.any()
    assert not opened[-1]


def test_what_the_equations_suspect_too_is_told_at_once() -> None:
    manifest = doubled()
    decision = Decision(manifest)
    for tick in range(200):
        decision.update(tick, 1, seen(manifest, last=30.0, first=30.0 if tick >= 20 else 0.0))
        if decision.confirmed or decision.suspected:
            break
    assert 20 <= tick < manifest.time.ticks(ALONE)
