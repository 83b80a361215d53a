"""A sealed manifest that cannot be meant is refused with the path of the bad value."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_bundle import GOLDEN, Change, copied, edit, refused, write

from faultline.service.bundle.load import load_bundle


def spread(detector: dict[str, Any]) -> dict[str, Any]:
    """A test of the variance in the place of one of the level."""
    kept = {name: detector[name] for name in ("generator", "offset", "scale")}
    return {**kept, "kind": "spread", "J": 1.0, "hold_s": 1.0, "memory_s": 10.0}


ABOVE = {"above": 1.0}

SINGLE_VALUES: list[tuple[Change, str]] = [
    (lambda m: m.update({"a\nb" * 1000: 1}), "top level: Object contains unknown field `a b"),
    (lambda m: m.update(extra=1), "top level: Object contains unknown field `extra`"),
    (lambda m: m.pop("period_s"), "top level: .* `period_s`"),
    (lambda m: m.update(period_s=0), r"period_s: Expected `float` >= 0\.001"),
    (lambda m: m.update(period_s=1e-12), r"period_s: Expected `float` >= 0\.001"),
    (lambda m: m.update(start_within_s=-1), r"start_within_s: Expected `float` >= 0"),
    (lambda m: m.update(name="a\nb"), "name: Expected `str` matching"),
    (lambda m: m.update(sensor_set="other"), "sensor_set: Invalid enum value 'other'"),
    (lambda m: m["files"]["uds.dbc"].update(size=-1), r"files\[\.\.\.\]\.size: Expected `int` >= 0"),
    (lambda m: m["files"]["uds.dbc"].update(sha256="A" * 64), r"files\[\.\.\.\]\.sha256: Expected `str` matching"),
    (lambda m: m["origin"].update(model_sha256="0" * 63), r"origin\.model_sha256: Expected `str` matching"),
    (lambda m: m["origin"]["calibrate"].append("x"), r"origin\.calibrate\[1\]: Expected `str` matching"),
    (lambda m: m["origin"].update(tune=[]), r"origin\.tune: Expected `array` of length >= 1"),
    (lambda m: m.update(inputs=[]), "inputs: Expected `array` of length >= 1"),
    (lambda m: m["inputs"][0].update(unit=5), r"inputs\[0\]\.unit: Expected `str`"),
    (lambda m: m["inputs"][2].update(maximum_age_s=0), r"inputs\[2\]\.maximum_age_s: Expected `float` > 0"),
    (lambda m: m["inputs"][0].update(signal="y" * 99), r"inputs\[0\]\.signal: Expected `str` of length <= 80"),
    (lambda m: m.update(generators=[]), "generators: Expected `array` of length >= 1"),
    (lambda m: m["generators"][2].update(warm_up_s="many"), r"generators\[2\]\.warm_up_s: Expected `float`"),
    (lambda m: m["generators"][2].update(warm_up_s=-1), r"generators\[2\]\.warm_up_s: Expected `float` >= 0"),
    (lambda m: m["generators"][2].update(warm_up_s=1e30), r"generators\[2\]\.warm_up_s: Expected `float` <="),
    (lambda m: m["generators"][2].update(inputs=[]), r"generators\[2\]\.inputs: Expected `array` of length >= 1"),
    (lambda m: m["generators"][0]["states"][0]["gain"].update({"": 1}), r"key in generators\[0\]\.states\[0\]\.gain: "),
    (lambda m: m["modes"].update(settle_s=-1), r"modes\.settle_s: Expected `float` >= 0"),
    (lambda m: m["modes"]["edges"].update(n_p=0), r"modes\.edges\[\.\.\.\]: Expected `float` > 0"),
    (lambda m: m["detectors"][3]["scale"].__setitem__(2, 0), r"detectors\[3\]\.scale\[2\]: Expected `float` > 0"),
    (lambda m: m["detectors"][3]["scale"].pop(), r"detectors\[3\]\.scale: has length 3, but there are 4 modes"),
    (lambda m: m["detectors"][3]["offset"].append(0), r"detectors\[3\]\.offset: has length 5, but there are 4 modes"),
    (lambda m: m["detectors"][3].update(nu=-0.1), r"detectors\[3\]\.nu: Expected `float` >= 0"),
    (lambda m: m["detectors"][3].pop("kind"), r"detectors\[3\]: Object missing required field `kind`"),
    (lambda m: m["detectors"][3].update(kind="glr"), r"detectors\[3\]\.kind: Invalid value 'glr'"),
    (lambda m: m["detectors"][3].update(J=0), r"detectors\[3\]\.J: Expected `float` > 0"),
    (lambda m: m["evidence"].update(generators=[]), r"evidence\.generators: Expected `array` of length >= 1"),
    (lambda m: m["evidence"].update(sigma={"t99.rnn": [1.0] * 4}), r"evidence\.sigma: unknown generator 't99\.rnn'"),
    (lambda m: m["evidence"].update(sigma={"t02.ode": [1.0] * 3}), r"evidence\.sigma\.t02\.ode: has length 3"),
    (lambda m: m["evidence"]["offset"].pop(), r"evidence\.offset: has length 3, but there are 4 modes"),
    (lambda m: m["evidence"]["noise"].pop(), r"evidence\.noise: has length 3, but there are 4 modes"),
    (lambda m: m["evidence"]["spread"][1].__setitem__(2, 0), r"evidence\.spread\[1\]\[2\]: Expected `float` > 0"),
    (lambda m: m["evidence"]["allowance"].pop(), r"evidence\.allowance: has length 3, but there are 4 modes"),
    (lambda m: m["evidence"]["allowance"][1].__setitem__(2, -1), r"evidence\.allowance\[1\]\[2\]: Expected `float` >="),
]

EVIDENCE = load_bundle(GOLDEN).manifest.evidence
K, HYPOTHESES = len(EVIDENCE.generators), len(EVIDENCE.hypotheses)

TOGETHER: list[tuple[Change, str]] = [
    (lambda m: m["files"].update({"../x": {"sha256": "0" * 64, "size": 1}}), r"files: '\.\./x' is not a plain file"),
    (lambda m: m["files"].update({".x": {"sha256": "0" * 64, "size": 1}}), r"files: '\.x' is not a plain file name"),
    (lambda m: m["files"].update({"x" * 5000: {"sha256": "0" * 64, "size": 1}}), "files: 'xx.*' is not a plain file"),
    (lambda m: m.update(dbc="other.dbc"), r"dbc: 'other\.dbc' is not in files"),
    (lambda m: m["graphs"][0].update(file="other.onnx"), r"graphs\[0\]\.file: 'other\.onnx' is not in files"),
    (lambda m: m["generators"][1].update(graph="other.onnx"), r"generators: not one graph's after the other's"),
    (lambda m: m.update(golden=""), "golden: Expected `str` matching"),
    (lambda m: m["origin"]["tune"].extend(m["origin"]["calibrate"]), "origin: data set .* used to calibrate and to"),
    (lambda m: m["inputs"].append(m["inputs"][1]), r"inputs\[5\]\.signal: 'y_p_ap' is there twice"),
    (lambda m: m["inputs"][1].update(lower=2e6), r"inputs\[1\]\.lower: 2e\+06 is not below upper, 1\.6e\+06"),
    (lambda m: m["inputs"][1].update(lower=1.6e6), r"inputs\[1\]\.lower: 1\.6e\+06 is not below upper, 1\.6e\+06"),
    (lambda m: m["faults"].append(m["faults"][0]), r"faults\[9\]\.name: 'fq_pump' is there twice"),
    (lambda m: m["generators"][1].update(name="t02.ode"), r"generators\[1\]\.name: 't02\.ode' is there twice"),
    (lambda m: m["generators"][1].update(test="t02"), r"generators\[1\]\.test: 't02' is there twice"),
    (lambda m: m["generators"][1]["inputs"].append("y_x"), r"generators\[1\]\.inputs: unknown signal 'y_x'"),
    (lambda m: m["generators"][1].update(predicts="y_x"), r"generators\[1\]\.predicts: unknown signal 'y_x'"),
    (
        lambda m: m["generators"][0].update(predicts="y_p_tp"),
        r"generators\[0\]\.predicts: 'y_p_tp' is not one of its inputs",
    ),
    (lambda m: m["generators"][0]["faults"].append("fX"), r"generators\[0\]\.faults: unknown fault 'fX'"),
    (
        lambda m: m["generators"][1]["states"][1].update(name="p_bp"),
        r"generators\[1\]\.states\[1\]\.name: 'p_bp' is there twice",
    ),
    (
        lambda m: m["generators"][0]["states"][0]["gain"].update(y_x=1.0),
        r"generators\[0\]\.states\[0\]\.gain: unknown signal 'y_x'",
    ),
    (
        lambda m: m["generators"][0]["states"][0]["gain"].update(y_p_tp=1.0),
        r"generators\[0\]\.states\[0\]\.gain: 'y_p_tp' is not one of the generator's inputs",
    ),
    (lambda m: m["detectors"].reverse(), "detectors: not one for each generator, in the same order"),
    (lambda m: m["detectors"].pop(), "detectors: not one for each generator, in the same order"),
    (lambda m: m["detectors"].append(m["detectors"][2]), r"detectors\[10\]: of 't08\.ode', its kind is there twice"),
    (
        lambda m: m["detectors"].append({**m["detectors"][2], "side": "above", "generator": "t99.ode"}),
        r"detectors\[10\]\.generator: unknown generator 't99\.ode'",
    ),
    (
        lambda m: m["detectors"].__setitem__(2, spread(m["detectors"][2])),
        r"detectors\[2\]\.kind: 'spread' does not test the level of 't08\.ode'",
    ),
    (
        lambda m: m["modes"]["steady"][0]["where"].update(y_x=ABOVE),
        r"modes\.steady\[0\]\.where: unknown signal 'y_x'",
    ),
    (
        lambda m: m["modes"]["steady"][1].update(where={"n_p": ABOVE}),
        r"modes\.steady: not exactly one mode without",
    ),
    (lambda m: m["modes"]["steady"][1].update(name="idle"), r"modes \(edge is the first\)\[2\]: 'idle' is there twice"),
    (
        lambda m: m["modes"]["steady"].append({"name": "more", "where": {"n_p": ABOVE}}),
        r"evidence\.offset: has length 4, but there are 5 modes",
    ),
    (lambda m: m["modes"]["edges"].update(y_x=1.0), r"modes\.edges: unknown signal 'y_x'"),
    (lambda m: m["evidence"]["generators"].append("t99"), r"evidence\.generators: unknown generator 't99'"),
    (
        lambda m: m["evidence"]["generators"].append("t02.ode"),
        rf"evidence\.generators\[{K}\]: 't02\.ode' is there twice",
    ),
    (
        lambda m: m["evidence"]["generators"].append("t09.ode"),
        rf"evidence\.offset\[0\]: has length {K}, but there are {K + 1} evidence generators",
    ),
    (lambda m: m["evidence"]["offset"][2].pop(), rf"evidence\.offset\[2\]: has length {K - 1}, but there are {K}"),
    (
        lambda m: m["evidence"]["allowance"][2].append(0),
        rf"evidence\.allowance\[2\]: has length {K + 1}, but there are {K}",
    ),
    (
        lambda m: m["evidence"]["hypotheses"][0].update(usual=[[0.0]] * 4),
        rf"evidence\.hypotheses\[0\]\.usual\[0\]: has length 1, but there are {K}",
    ),
    (
        lambda m: m["evidence"]["hypotheses"][0].update(usual=[[1e60] * K] * 4),
        r"evidence\.hypotheses\[0\]\.usual: a value beyond 1e\+50",
    ),
    (
        lambda m: m["evidence"]["hypotheses"][-1].update(usual=[[0.0] * K] * 4),
        r"evidence\.hypotheses: one with a consequence has a usual shift",
    ),
    (
        lambda m: m["evidence"]["operation"][2].pop(),
        rf"evidence\.operation\[2\]: has length {K - 1}, but there are {K}",
    ),
    (lambda m: m["evidence"]["noise"][1].pop(), rf"evidence\.noise\[1\]: has length {K - 1}, but there are {K}"),
    (
        lambda m: m["evidence"]["noise"][1][2].pop(),
        rf"evidence\.noise\[1\]\[2\]: has length {K - 1}, but there are {K}",
    ),
    (lambda m: m["evidence"].update(graph=None), rf"evidence\.graph: None for {HYPOTHESES} hypotheses"),
    (
        lambda m: m["evidence"].update(hypotheses=[], consequences=[], sizes=[]),
        r"evidence\.graph: 'faults\.onnx' for 0 hypotheses",
    ),
    (lambda m: m["evidence"].update(graph="x.onnx"), r"evidence\.graph: 'x\.onnx' is not in files"),
    (lambda m: m["generators"][3]["equations"].append("e99"), r"generators\[3\]\.equations: unknown equation 'e99'"),
    (lambda m: m["equations"].append(m["equations"][0]), r"equations\[\d+\]\.name: 'e\d+' is there twice"),
    (
        lambda m: m["evidence"]["hypotheses"][0].update(brought=-0.5),
        r"evidence\.hypotheses: one with a consequence is before one without",
    ),
    (
        lambda m: m["evidence"].update(consequences=[]),
        r"evidence\.hypotheses: unknown consequence of 'fA_t'",
    ),
    (
        lambda m: m["evidence"]["hypotheses"][-1].update(size=-0.5),
        r"evidence\.consequences\[\d\]: not assumed with the two or more largest sizes of 'fy_p_du'",
    ),
    (
        lambda m: m["evidence"]["consequences"][0].update(brings="fX"),
        r"evidence\.consequences\[0\]: unknown hypothesis 'fX'",
    ),
    (
        lambda m: m["evidence"]["consequences"][0]["where"].update(nowhere={"above": 1.0}),
        r"evidence\.consequences\[0\]\.where: unknown signal 'nowhere'",
    ),
    (
        lambda m: m["evidence"]["hypotheses"][7].update(fault="fX"),
        r"evidence\.hypotheses\[7\]\.fault: unknown fault 'fX'",
    ),
    (lambda m: m["disturbances"][0].update(equation="e99"), r"disturbances\[0\]\.equation: unknown equation 'e99'"),
    (lambda m: m["disturbances"][0].update(name="fA_t"), r"faults and disturbances\[9\]: 'fA_t' is there twice"),
    (
        lambda m: m["evidence"]["followers"][0].update(generator="t99.ode"),
        r"evidence\.followers: unknown generator 't99\.ode'",
    ),
    (
        lambda m: m["evidence"]["followers"][1].update(generator="t02.ode"),
        rf"evidence\.generators, followers and networks\[{K + 1}\]: 't02\.ode' is there twice",
    ),
    (
        lambda m: m["evidence"]["followers"][2]["drifts"].pop(),
        r"evidence\.followers\[2\]\.drifts: \d, but evidence has",
    ),
    (
        lambda m: m["evidence"].update(networks=[network_of(m, twin="t99.ode")]),
        r"evidence\.networks\[0\]\.twin: unknown generator of the equations 't99\.ode'",
    ),
    (
        lambda m: m["evidence"].update(networks=[network_of(m, allowance=[0.0] * 3)]),
        r"evidence\.networks\[0\]\.allowance: has length 3, but there are 4 modes",
    ),
]


def network_of(m: dict[str, Any], **other: Any) -> dict[str, Any]:
    """One of the followers as a network."""
    follower = m["evidence"]["followers"].pop()
    given = {name: follower[name] for name in ("generator", "offset", "spread")}
    return {**given, "twin": m["evidence"]["generators"][0], "allowance": [1.0] * 4, **other}


def of_first_two(a: float, b: float, c: float, d: float) -> list[list[float]]:
    """A covariance of the evidence generators, of which all but the first two are sound."""
    covariance = np.eye(K)
    covariance[:2, :2] = [[a, b], [c, d]]
    return [list(row) for row in covariance.tolist()]


SINGULAR = of_first_two(1.0, 1.0, 1.0, 1.0)
SKEW = of_first_two(1.0, 0.5, 0.0, 1.0)
HUGE = of_first_two(1e-300, 1e300, 1e300, 1e-300)
NEGATIVE = of_first_two(-1.0, 0.0, 0.0, 1.0)
NOTHING = [[0.0] * K] * K


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return copied(tmp_path)


@pytest.mark.parametrize(("change", "message"), SINGLE_VALUES + TOGETHER)
def test_what_the_manifest_cannot_mean_is_named_by_its_path(bundle: Path, change: Change, message: str) -> None:
    edit(bundle, change)
    refused(bundle, rf"manifest\.json: {message}.*; export the bundle again")


@pytest.mark.parametrize("noise", [SINGULAR, SKEW, HUGE, NEGATIVE, NOTHING])
def test_noise_that_ranking_could_not_divide_by_is_refused(bundle: Path, noise: list[list[float]]) -> None:
    edit(bundle, lambda m: m["evidence"]["noise"].__setitem__(2, noise))
    refused(bundle, r"evidence\.noise\[2\]: mode partial: not symmetric and positive definite")


@pytest.mark.parametrize("visit", [SKEW, HUGE, NEGATIVE, of_first_two(0.0, 1.0, 1.0, 0.0)])
def test_a_spread_of_visits_that_is_none_is_refused(bundle: Path, visit: list[list[float]]) -> None:
    edit(bundle, lambda m: m["evidence"]["visit"].__setitem__(2, visit))
    refused(bundle, r"evidence\.visit\[2\]: mode partial: not symmetric and positive semidefinite")


def test_visits_may_not_stray_at_all(bundle: Path) -> None:
    edit(bundle, lambda m: m["evidence"]["visit"].__setitem__(2, NOTHING))
    assert load_bundle(bundle).manifest.evidence.visit[2] == NOTHING


def test_evidence_whose_squares_are_no_numbers_is_refused(bundle: Path) -> None:
    edit(bundle, lambda m: m["evidence"]["offset"][1].__setitem__(0, 1e200))
    refused(bundle, r"evidence\.offset: a value beyond 1e\+50")


@pytest.mark.parametrize("number", [b"1e999", b"-1e999", b"1" + b"0" * 400])
def test_a_number_beyond_the_finite_ones_is_refused(bundle: Path, number: bytes) -> None:
    raw = (bundle / "manifest.json").read_bytes()
    assert b'"lower": 2000.0' in raw
    write(bundle, raw.replace(b'"lower": 2000.0', b'"lower": ' + number, 1))
    refused(bundle, r"inputs\[0\]\.lower: Number out of range")


@pytest.mark.parametrize("number", [b"NaN", b"Infinity", b"-Infinity"])
def test_what_json_does_not_know_is_refused(bundle: Path, number: bytes) -> None:
    raw = (bundle / "manifest.json").read_bytes()
    write(bundle, raw.replace(b'"lower": 2000.0', b'"lower": ' + number, 1))
    refused(bundle, "not JSON: ")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m["generators"][1]["states"].pop(), r"input x .* \['B', 29\], .* a tensor\(double\) .* \['B', 28\]"),
        (
            lambda m: m["inputs"].reverse() or m["inputs"].append({**m["inputs"][0], "signal": "P"}),
            r"no message carries P",
        ),
    ],
)
def test_a_manifest_of_another_graph_is_refused(bundle: Path, change: Change, message: str) -> None:
    edit(bundle, change)
    refused(bundle, message)
