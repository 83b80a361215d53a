"""What the parts of a manifest must say of each other; each thing that cannot be is told with the path of its value."""

import re
from collections.abc import Container, Iterable, Iterator, Sequence, Sized
from itertools import chain, groupby
from typing import Any

import numpy as np

from faultline.service.core.manifest import (
    EDGE,
    AdaptiveDetector,
    CusumDetector,
    Detector,
    Evidence,
    Manifest,
    PerMode,
    SpreadDetector,
)
from faultline.service.core.signals.values import FloatArray

FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")  # no path, nothing hidden
ROUNDING = 1e-9  # of a correlation
LARGEST = 1e50  # of evidence: its squares and products must be numbers
WIDEST = 1e5  # of what strays, in spreads: a sum of covariances must stay one that can be divided by
MODES_OF = ("offset", "spread")  # of each generator that is no evidence, by mode
MOST_HYPOTHESES = 500  # two at a time are tried, so memory grows with the square


def inconsistencies(manifest: Manifest) -> Iterator[str]:
    """The contradictions, one after the other: only the first is sure, as each check relies on those before it."""
    yield from _files(manifest)
    yield from _names(manifest)
    yield from _generators(manifest)
    yield from _decision(manifest)
    yield from of_evidence(manifest.evidence, manifest.modes.names)
    yield from _by_mode(manifest)


def uneven(rows: Sequence[Sized], wanted: int, path: str, what: str) -> Iterator[str]:
    """Rows that do not have one entry for each of the `wanted` things called `what`.

    >>> list(uneven([[1.0, 2.0], [3.0]], 2, "z", "inputs"))
    ['z[1]: has length 1, but there are 2 inputs']
    """
    for index, row in enumerate(rows):
        if len(row) != wanted:
            yield f"{path}[{index}]: has length {len(row)}, but there are {wanted} {what}"


def _files(manifest: Manifest) -> Iterator[str]:
    for name in manifest.files:
        if FILE_NAME.fullmatch(name) is None:
            yield f"files: {name[:100]!r} is not a plain file name"
    named = [(f"graphs[{row}].file", graph.file) for row, graph in enumerate(manifest.graphs)]
    if manifest.dbc is not None:
        named.append(("dbc", manifest.dbc))
    if manifest.evidence.graph is not None:
        named.append(("evidence.graph", manifest.evidence.graph))
    for field, name in (*named, ("golden", manifest.golden)):
        if name not in manifest.files:
            yield f"{field}: {name!r} is not in files"
    origin = manifest.origin
    for used, other in (("calibrate", origin.calibrate), ("train", origin.train)):
        overlap = set(other) & set(origin.tune)
        if overlap:
            yield f"origin: data set {min(overlap)[:12]} was used to {used} and to tune"


def _names(manifest: Manifest) -> Iterator[str]:
    """One name, one thing: everything after this finds its parts by name."""
    generators = manifest.generators
    yield from _repeated([channel.signal for channel in manifest.inputs], "inputs", ".signal")
    yield from _repeated([generator.name for generator in generators], "generators", ".name")
    yield from _repeated([graph.file for graph in manifest.graphs], "graphs", ".file")
    for row, generator in enumerate(generators):
        if any((other.graph, other.test) == (generator.graph, generator.test) for other in generators[:row]):
            yield f"generators[{row}].test: {generator.test!r} is there twice"
    yield from _repeated([fault.name for fault in manifest.faults], "faults", ".name")
    codes: dict[tuple[int | None, int | None], str] = {}
    for row, fault in enumerate(manifest.faults):
        if (fault.spn is None) != (fault.fmi is None):
            yield f"faults[{row}].spn: SPN and FMI are one code: both, or none"
        if fault.spn is not None and codes.setdefault((fault.spn, fault.fmi), fault.component) != fault.component:
            yield f"faults[{row}].spn: {fault.spn} with FMI {fault.fmi} is {codes[fault.spn, fault.fmi]!r} already"
    named = [*(fault.name for fault in manifest.faults), *(each.name for each in manifest.disturbances)]
    yield from _repeated(named, "faults and disturbances")
    yield from _repeated([equation.name for equation in manifest.equations], "equations", ".name")
    yield from _repeated(manifest.evidence.generators, "evidence.generators")
    for row, generator in enumerate(generators):
        yield from _repeated([state.name for state in generator.states], f"generators[{row}].states", ".name")


def _generators(manifest: Manifest) -> Iterator[str]:
    signals = {channel.signal for channel in manifest.inputs}
    faults = {fault.name for fault in manifest.faults}
    equations = {equation.name for equation in manifest.equations}
    for column, channel in enumerate(manifest.inputs):
        if not channel.lower < channel.upper:
            yield f"inputs[{column}].lower: {channel.lower:g} is not below upper, {channel.upper:g}"
    files = [graph.file for graph in manifest.graphs]
    if [name for name, _ in groupby(generator.graph for generator in manifest.generators)] != files:
        yield f"generators: not one graph's after the other's, as {', '.join(files)}"
    for index, each in enumerate(manifest.disturbances):
        yield from _unknown([each.equation], equations, f"disturbances[{index}].equation", "equation")
    for row, generator in enumerate(manifest.generators):
        path = f"generators[{row}]"
        yield from _unknown(generator.inputs, signals, f"{path}.inputs", "signal")
        yield from _unknown(generator.faults, faults, f"{path}.faults", "fault")
        yield from _unknown(generator.equations, equations, f"{path}.equations", "equation")
        yield from _unknown([generator.predicts], signals, f"{path}.predicts", "signal")
        if generator.predicts not in generator.inputs:
            yield f"{path}.predicts: {generator.predicts!r} is not one of its inputs"
        for column, state in enumerate(generator.states):
            yield from _unknown(state.gain, signals, f"{path}.states[{column}].gain", "signal")
            for signal in state.gain:
                if signal not in generator.inputs:  # nobody would look whether its sensor can be used
                    yield f"{path}.states[{column}].gain: {signal!r} is not one of the generator's inputs"


def _decision(manifest: Manifest) -> Iterator[str]:
    signals = {channel.signal for channel in manifest.inputs}
    assumable = {*(fault.name for fault in manifest.faults), *(each.name for each in manifest.disturbances)}
    names = [generator.name for generator in manifest.generators]
    modes, evidence = manifest.modes, manifest.evidence
    yield from _repeated(modes.names, f"modes ({EDGE} is the first)")
    for index, mode in enumerate(modes.steady):
        yield from _unknown(mode.where, signals, f"modes.steady[{index}].where", "signal")
    if sum(not mode.where for mode in modes.steady) != 1:
        yield "modes.steady: not exactly one mode without `where`"
    yield from _unknown(modes.edges, signals, "modes.edges", "signal")
    yield from _detectors(manifest.detectors, names)
    yield from _unknown(evidence.generators, names, "evidence.generators", "generator")
    followers = [follower.generator for follower in evidence.followers]
    yield from _unknown(followers, names, "evidence.followers", "generator")
    yield from _unknown([each.generator for each in evidence.networks], names, "evidence.networks", "generator")
    yield from _unknown(evidence.sigma, names, "evidence.sigma", "generator")
    for index, hypothesis in enumerate(evidence.hypotheses):
        yield from _unknown([hypothesis.fault], assumable, f"evidence.hypotheses[{index}].fault", "fault")
    assumed = {hypothesis.fault for hypothesis in evidence.hypotheses}
    yield from _repeated([each.fault for each in evidence.consequences], "evidence.consequences", ".fault")
    if any(hypothesis.brought is not None for hypothesis in evidence.hypotheses[: evidence.simple]):
        yield "evidence.hypotheses: one with a consequence is before one without"
    if any(hypothesis.usual is not None for hypothesis in evidence.hypotheses[evidence.simple :]):
        yield "evidence.hypotheses: one with a consequence has a usual shift"
    brings = {each.fault for each in evidence.consequences}
    brought = [each.fault for each in evidence.hypotheses if each.brought is not None]
    yield from _unknown(brought, brings, "evidence.hypotheses", "consequence of")
    yield from _unknown((each.fault for each in evidence.sizes), assumed, "evidence.sizes", "hypothesis")
    yield from _grids(evidence)
    for index, each in enumerate(evidence.consequences):
        yield from _unknown([each.fault, each.brings], assumed, f"evidence.consequences[{index}]", "hypothesis")
        yield from _unknown(each.where, signals, f"evidence.consequences[{index}].where", "signal")


def _grids(evidence: Evidence) -> Iterator[str]:
    """Consequences that are not assumed with the two or more largest sizes of one sign, with each size alike."""
    for index, each in enumerate(evidence.consequences):
        own = [h for h in evidence.hypotheses if h.fault == each.fault and h.share_of is None]
        found = sorted((h.size, h.brought) for h in own if h.brought is not None)
        of = sorted({size for size, _ in found}, key=abs)
        brought = sorted({size for _, size in found})
        sizes = sorted((h.size for h in own if h.brought is None and of and h.size * of[0] > 0.0), key=abs)
        if len(of) < 2 or of != sizes[-len(of) :] or found != sorted((a, b) for a in of for b in brought):
            yield f"evidence.consequences[{index}]: not assumed with the two or more largest sizes of {each.fault!r}"


def _by_mode(manifest: Manifest) -> Iterator[str]:
    """Lists by mode that do not have an entry for each."""
    count = len(manifest.modes.names)
    for row, detector in enumerate(manifest.detectors):
        usual = {"usual": detector.usual} if isinstance(detector, AdaptiveDetector) else {}
        for name, values in {"offset": detector.offset, "scale": detector.scale, **usual}.items():
            if len(values) != count:
                yield f"detectors[{row}].{name}: has length {len(values)}, but there are {count} modes"


def _detectors(detectors: Sequence[Detector], names: Sequence[str]) -> Iterator[str]:
    """One of the level for each generator, in their order; then any others, none of them twice."""
    first = detectors[: len(names)]
    if [detector.generator for detector in first] != names:
        yield "detectors: not one for each generator, in the same order"
    for row, detector in enumerate(detectors):
        if row < len(names) and isinstance(detector, SpreadDetector):
            yield f"detectors[{row}].kind: 'spread' does not test the level of {detector.generator!r}"
        yield from _unknown([detector.generator], names, f"detectors[{row}].generator", "generator")
        if any(_same(detector, other) for other in detectors[:row]):
            yield f"detectors[{row}]: of {detector.generator!r}, its kind is there twice"


def _same(detector: Detector, other: Detector) -> bool:
    """Whether both do the same to the same generator."""
    sides = (d.side if isinstance(d, CusumDetector) else "both" for d in (detector, other))
    return type(detector) is type(other) and detector.generator == other.generator and len({*sides}) == 1


def of_evidence(evidence: Evidence, modes: Sequence[str]) -> Iterator[str]:
    """The contradictions within the evidence: shapes over modes and generators, and numbers that nothing can be."""
    K, C = len(evidence.generators), len(modes)
    lists: dict[str, Sized] = {
        name: getattr(evidence, name) for name in ("offset", "spread", "noise", "visit", "allowance", "operation")
    }
    lists |= {f"drifts[{index}]": drift for index, drift in enumerate(evidence.drifts)}
    lists |= (usual := _usual(evidence))
    lists |= _beside(evidence)
    for index, each in enumerate(evidence.followers):
        lists |= {f"followers[{index}].drifts[{k}]": drift for k, drift in enumerate(each.drifts)}
    for name, by_mode in lists.items():
        if len(by_mode) != C:
            yield f"evidence.{name}: has length {len(by_mode)}, but there are {C} modes"
    what = "evidence generators"
    yield from uneven(evidence.offset, K, "evidence.offset", what)
    yield from uneven(evidence.spread, K, "evidence.spread", what)
    yield from uneven(evidence.allowance, K, "evidence.allowance", what)
    yield from uneven(evidence.operation, K, "evidence.operation", what)
    yield from uneven(evidence.noise, K, "evidence.noise", what)
    for index, drift in enumerate(evidence.drifts):
        yield from uneven(drift, K, f"evidence.drifts[{index}]", what)
    yield from uneven(evidence.visit, K, "evidence.visit", what)
    yield from chain.from_iterable(uneven(shift, K, f"evidence.{name}", what) for name, shift in usual.items())
    yield from _levels(evidence)
    for name, matrices in (("noise", evidence.noise), ("visit", evidence.visit)):
        for mode, rows in enumerate(matrices):
            yield from uneven(rows, K, f"evidence.{name}[{mode}]", what)
    if (evidence.graph is None) != (not evidence.hypotheses):
        yield f"evidence.graph: {evidence.graph!r} for {len(evidence.hypotheses)} hypotheses"
    yield from _sizes(evidence, modes)


def _levels(evidence: Evidence) -> Iterator[str]:
    """The contradictions between generators whose baseline is followed, and those that it says something of."""
    followers = [follower.generator for follower in evidence.followers]
    networks = [each.generator for each in evidence.networks]
    yield from _repeated([*evidence.generators, *followers, *networks], "evidence.generators, followers and networks")
    for index, follower in enumerate(evidence.followers):
        if len(follower.drifts) != len(evidence.drifts):
            yield f"evidence.followers[{index}].drifts: {len(follower.drifts)}, but evidence has {len(evidence.drifts)}"
    for index, twin in enumerate(evidence.networks):
        known = [*evidence.generators, *followers]
        yield from _unknown([twin.twin], known, f"evidence.networks[{index}].twin", "generator of the equations")


def _beside(evidence: Evidence) -> dict[str, PerMode[float]]:
    """Return what followers, networks and generators that say how large their error is have by mode."""
    lists = {f"followers[{k}].{name}": getattr(f, name) for k, f in enumerate(evidence.followers) for name in MODES_OF}
    return (
        lists
        | {
            f"networks[{k}].{name}": getattr(twin, name)
            for k, twin in enumerate(evidence.networks)
            for name in (*MODES_OF, "allowance")
        }
        | {f"sigma.{name}": usual for name, usual in evidence.sigma.items()}
    )


def _usual(evidence: Evidence) -> dict[str, PerMode[list[float]]]:
    """The usual shifts of the hypotheses that have one, by their names."""
    return {f"hypotheses[{k}].usual": h.usual for k, h in enumerate(evidence.hypotheses) if h.usual is not None}


def _sizes(evidence: Evidence, modes: Sequence[str]) -> Iterator[str]:
    """Covariances that can be divided by, and numbers whose squares are numbers."""
    for mode, rows in enumerate(evidence.noise):
        if not _is_covariance(np.array(rows)):
            yield f"evidence.noise[{mode}]: mode {modes[mode]}: not symmetric and positive definite"
    for mode, rows in enumerate(evidence.visit):
        if not _is_semidefinite(np.array(rows)):
            yield f"evidence.visit[{mode}]: mode {modes[mode]}: not symmetric and positive semidefinite"
    if len(evidence.hypotheses) > MOST_HYPOTHESES:
        yield f"evidence.hypotheses: {len(evidence.hypotheses)}, more than {MOST_HYPOTHESES}"
    yield from _widths(evidence)
    parts: dict[str, Any] = {
        name: getattr(evidence, name)
        for name in ("offset", "spread", "noise", "visit", "allowance", "operation", "drifts")
    }
    parts |= {f"followers[{index}].drifts": follower.drifts for index, follower in enumerate(evidence.followers)}
    parts |= _beside(evidence) | _usual(evidence)
    for name, values in parts.items():
        if np.abs(np.array(values)).max(initial=0.0) > LARGEST:
            yield f"evidence.{name}: a value beyond {LARGEST:g}"


def _widths(evidence: Evidence) -> Iterator[str]:
    spread = np.sqrt(np.array([np.diag(noise) for noise in evidence.noise]))  # (modes, K)
    visit = np.sqrt(np.array([np.diag(rows) for rows in evidence.visit]))
    if (np.array(evidence.spread) ** 2 * WIDEST < spread**2).any():
        yield f"evidence.spread: a value below a {WIDEST**0.5:.0f}th of the spread of the noise"
    of = {"visit": visit, "allowance": np.array(evidence.allowance), "drifts": np.array(evidence.drifts)}
    for name, values in of.items():
        if values.size and (np.abs(values) > WIDEST * spread).any():
            yield f"evidence.{name}: a value beyond {WIDEST:g} times the spread of the noise"


def _is_covariance(V: FloatArray) -> bool:
    """Whether `V` (K, K) is symmetric and positive definite, judged by its correlations, which have no unit.

    >>> _is_covariance(np.array([[4e8, 1e4], [1e4, 1.0]])), _is_covariance(np.array([[1.0, 2.0], [2.0, 1.0]]))
    (True, False)
    """
    return bool((V.diagonal() > 0).all()) and _least_of(V) > ROUNDING


def _is_semidefinite(V: FloatArray) -> bool:
    """The same, where some combination may have no variance.

    >>> _is_semidefinite(np.array([[1.0, 1.0], [1.0, 1.0]])), _is_semidefinite(np.array([[0.0, 0.0], [0.0, 1.0]]))
    (True, True)
    >>> _is_semidefinite(np.array([[0.0, 1.0], [1.0, 1.0]])), _is_semidefinite(-np.eye(2))
    (False, False)
    """
    varies = V.diagonal() > 0
    nothing = V[~varies].any() or V[:, ~varies].any()
    return not nothing and (not varies.any() or _least_of(V[np.ix_(varies, varies)]) > -ROUNDING)


def _least_of(V: FloatArray) -> float:
    """The least eigenvalue of the correlations, minus infinity where they are none."""
    spread = np.sqrt(V.diagonal())
    with np.errstate(over="ignore"):
        correlation = V / spread / spread[:, None]
    if np.abs(correlation).max() > 1 + ROUNDING or np.abs(correlation - correlation.T).max() > ROUNDING:
        return -np.inf
    return float(np.linalg.eigvalsh(correlation)[0])


def _repeated(names: Sequence[str], path: str, field: str = "") -> Iterator[str]:
    for index, name in enumerate(names):
        if name in names[:index]:
            yield f"{path}[{index}]{field}: {name!r} is there twice"


def _unknown(names: Iterable[str], known: Container[str], path: str, kind: str) -> Iterator[str]:
    for name in names:
        if name not in known:
            yield f"{path}: unknown {kind} {name!r}"
