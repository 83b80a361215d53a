"""What confirms and ranks faults: the hypotheses, and how far fault-free means stray.

A hypothesis (fault and size) is the model with that fault. Fed with the samples of the moment, it predicts another
output than the fault-free model; under the fault the residual shifts by that difference. No fault recording is needed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import msgspec
import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from faultline.analysis.graph.bank import FAULTS, Bank, Trial
from faultline.analysis.graph.independence import independent
from faultline.analysis.graph.runnable import trial_of
from faultline.analysis.tuning.assumed import biases_of, consequences_of, hypotheses_of, sizes_of
from faultline.analysis.tuning.thresholds import Seen
from faultline.service.core.decision.blocks import BLOCK
from faultline.service.core.decision.straying import MINIMUM_TICKS
from faultline.service.core.manifest import Evidence, Follower, Generator, Hypothesis, Twin
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import Span

Array = npt.NDArray[np.float64]

VISIT, SUPPOSED = Span(settlings=0.5, periods=50), 5.0
"""Before any visit is seen, its effect is supposed to be as large as the noise of a mean over `VISIT`, as surely as
from so many visits: pulses of an actuator and the sampling beat, at a level that tuning has not seen."""
LARGER = 0.01
"""One vehicle in so many has larger effects of a visit than is supposed after a few of them."""
ALLOWANCE = 0.3  # of the mode's spread: what a few recordings cannot show
ENOUGH = 8
"""Recordings from which the way in which all means stray together from drive to drive is seen, and not assumed."""
SEEN_PART = 0.9  # of that straying, in spreads: by a few directions, the rest is each mean's own
PER_DIRECTION = 3  # recordings, at least
STEPS = 100  # of expectation maximisation
USUAL = 0.95
"""The part of fault-free ticks in which a network's sigma is usual."""
LEAST_OWN = 0.01  # of the spread: what each mean strays by itself, so that there is something to divide by


def gather(
    bank: Bank,
    offset: Array,
    recordings: Sequence[Seen],
    stand_ins: Sequence[int],
    apart: Sequence[Seen] | None = None,
) -> tuple[Evidence, list[float]]:
    """Return the evidence of a bundle, and the sizes of the drifts that the model names, in parts of what it says.

    Mode m is described by the ticks of mode `stand_ins[m]`, as in `tune_detectors`.

    `offset` (T, modes) is where the residuals lie without a fault. `apart` are the same recordings, each centred by the
    others of its vehicle: how far a drive strays is seen in them, as a drive that has been centred by itself too
    strays less.
    """
    described = list(stand_ins)
    within = [_centred(s, offset) for s in recordings]
    spread = np.maximum(_spread(within, described), bank.sigma / 2)  # (modes, T)
    rows = independent(np.concatenate([_standard(s, spread) for s in within]))
    order = [*rows, *(row for row in range(len(bank.generators)) if row not in rows)]  # followers are behind
    K, everywhere, around = len(rows), spread[:, order], offset[order].T  # (modes, T)
    spread, offset = everywhere[:, :K], around[:, :K]
    noise = np.zeros((len(described), len(rows), len(rows)))
    visit = np.zeros_like(noise)
    for mode in set(described):
        noise[mode] = _noise(recordings, mode, rows, spread[mode])
    for mode, effect in _visit_effects(recordings, set(described), rows, noise).items():
        visit[mode] = effect
    strays = _strays(recordings, order, around)[:, described]
    own = np.abs(strays[..., :K]).max(axis=0)
    drifts = named_drifts(bank.only(order), recordings, described)
    sizes = np.ones(len(drifts))
    if not bank.has_equations and len(recordings) < ENOUGH:
        own = np.abs(strays - strays.mean(axis=1, keepdims=True))[..., :K].max(axis=0)
        drifts = np.concatenate([drifts, supposed_drifts(strays, everywhere)])
    if len(recordings) >= ENOUGH:
        own, drifts, sizes = as_seen(_strays(apart or recordings, order, around)[:, described], everywhere, drifts, K)
    assumed = hypotheses_of(bank.model) if bank.has_equations else biases_of(bank.model, _samples(recordings))
    hypotheses = with_usual(assumed, bank.only(rows), recordings, described)
    evidence = Evidence(
        generators=[bank.generators[row].name for row in rows],
        offset=offset.tolist(),
        spread=spread.tolist(),
        noise=noise[described].tolist(),
        visit=visit[described].tolist(),
        allowance=np.hypot(own, ALLOWANCE * spread).tolist(),
        drifts=drifts[..., :K].tolist(),
        operation=_operation(bank.only(rows), recordings, described).tolist(),
        followers=[
            Follower(
                generator=bank.generators[row].name,
                offset=around[:, column].tolist(),
                spread=everywhere[:, column].tolist(),
                drifts=drifts[..., column].tolist(),
            )
            for column, row in enumerate(order[K:], start=K)
        ],
        graph=FAULTS if hypotheses else None,
        hypotheses=hypotheses,
        consequences=consequences_of(bank.model) if hypotheses else [],
        sizes=sizes_of(bank.model) if hypotheses else [],
    )
    return evidence, sizes.tolist()


def _samples(recordings: Sequence[Seen]) -> Array:
    """The samples (K, nz) of all recordings."""
    return np.concatenate([s.z for s in recordings])


def supposed_drifts(strays: Array, spread: Array) -> Array:
    """Return how far (T, modes, T) the means of each test stray together, where no model says what makes them stray.

    `strays` (R, modes, T) are those of R drives, `spread` (modes, T) is that of their ticks. Before any drive is seen,
    a test's means are supposed to stray from drive to drive as far as its residual does within one, as surely as from
    so many drives as `SUPPOSED` says; a few show a variance badly, so that it is an upper bound.
    """
    R, T = len(strays), spread.shape[1]
    seen = (strays.mean(axis=1) ** 2).sum(axis=0)  # (T,)
    size = np.sqrt((SUPPOSED * np.median(spread, axis=0) ** 2 + seen) / chdtri(SUPPOSED + R - 1, 1.0 - LARGER))
    return np.asarray(np.eye(T)[:, None] * np.ones((len(spread), 1)) * size)


def with_usual(
    hypotheses: Sequence[Hypothesis], bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int]
) -> list[Hypothesis]:
    """Return the hypotheses, the smallest of each form of a fault with its mean shifts in these recordings."""
    smallest: dict[tuple[str, str | None], int] = {}
    for row, h in enumerate(hypotheses):
        if h.brought is None and abs(h.size) < abs(hypotheses[smallest.setdefault((h.fault, h.share_of), row)].size):
            smallest[h.fault, h.share_of] = row
    if not smallest:
        return []
    trials = [trial_of(hypotheses[row], bank.model) for row in smallest.values()]
    steps = np.zeros((len(trials), len(bank.model.known)))
    shifts = -_shifts(bank, recordings, trials, stand_ins, steps)  # under the fault it is the measured that moves
    usual = dict(zip(smallest.values(), shifts.tolist(), strict=True))
    return [msgspec.structs.replace(h, usual=usual.get(row)) for row, h in enumerate(hypotheses)]


def with_networks(
    evidence: Evidence,
    generators: Sequence[Generator],
    recordings: Sequence[Seen],
    offset: Array,
    floor: Array,
    stand_ins: Sequence[int],
) -> Evidence:
    """Return the evidence with those networks whose test has a generator of the equations, its twin.

    How far the two stray apart is bounded as a mean's own straying is, by the largest that the recordings show.
    `offset` (T, modes) and `floor` (T,) are of all generators.
    """
    described, names = list(stand_ins), [each.name for each in generators]
    twins = {generators[names.index(name)].test: name for name in _of_equations(evidence)}
    spread = np.maximum(_spread([_centred(s, offset) for s in recordings], described), floor / 2)  # (modes, T)
    networks = []
    for row, each in enumerate(generators):
        twin = twins.get(each.test, each.name)
        if twin == each.name:
            continue
        strays = _strays(recordings, [row, names.index(twin)], offset[[row, names.index(twin)]].T)  # (R, modes, 2)
        apart = np.abs(strays[..., 0] - strays[..., 1]).max(axis=0)[described]
        networks.append(
            Twin(
                generator=each.name,
                twin=twin,
                offset=offset[row].tolist(),
                spread=spread[:, row].tolist(),
                allowance=np.hypot(apart, ALLOWANCE * spread[:, row]).tolist(),
            )
        )
    return msgspec.structs.replace(evidence, networks=networks)


def with_sigma(
    evidence: Evidence,
    generators: Sequence[Generator],
    trained: Sequence[str],
    recordings: Sequence[Seen],
    stand_ins: Sequence[int],
) -> Evidence:
    """Return the evidence with the largest usual sigma of the generators that were trained."""
    names = [each.name for each in generators]
    found = {name: [_usual_sigma(recordings, names.index(name), mode) for mode in stand_ins] for name in trained}
    return msgspec.structs.replace(evidence, sigma=found)


def _usual_sigma(recordings: Sequence[Seen], row: int, mode: int) -> float:
    """Return the sigma below which nearly all ticks of a mode lie."""
    inside = [s.sigma[s.inside(row, mode), row] for s in recordings if s.sigma is not None]
    return float(np.quantile(np.concatenate(inside), USUAL))


def _of_equations(evidence: Evidence) -> list[str]:
    """Return the names of the generators whose baseline is followed."""
    return [*evidence.generators, *(each.generator for each in evidence.followers)]


def with_drifts(
    evidence: Evidence, sizes: Sequence[float], bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int]
) -> Evidence:
    """Return the evidence with the drifts that this bank's model names, `sizes` times as large as it says.

    The other drifts, which no model names, stay: only many drives show them.
    """
    names = [generator.name for generator in bank.generators]
    order = [names.index(name) for name in (*evidence.generators, *(f.generator for f in evidence.followers))]
    K, own = len(evidence.generators), named_drifts(bank.only(order), recordings, stand_ins)
    own *= np.array(sizes).reshape(-1, 1, 1)
    followers = [
        msgspec.structs.replace(f, drifts=[*own[..., column].tolist(), *f.drifts[len(own) :]])
        for column, f in enumerate(evidence.followers, start=K)
    ]
    drifts = [*own[..., :K].tolist(), *evidence.drifts[len(own) :]]
    hypotheses = with_usual(evidence.hypotheses, bank.only(order[:K]), recordings, stand_ins)
    return msgspec.structs.replace(evidence, drifts=drifts, followers=followers, hypotheses=hypotheses)


def no_surer(evidence: Evidence, bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int]) -> Evidence:
    """Evidence whose ticks and visits stray as much as they do in these recordings, in every direction."""
    described = list(stand_ins)
    names = [generator.name for generator in bank.generators]
    rows = [names.index(name) for name in evidence.generators]
    noise, visit = np.array(evidence.noise), np.array(evidence.visit)
    spread = np.array(evidence.spread)
    own = np.zeros_like(noise)
    for mode in set(described):
        own[mode] = _noise(recordings, mode, rows, spread[mode])
        noise[mode] += _positive(own[mode] - noise[mode])
    for mode, effect in _visit_effects(recordings, set(described), rows, own).items():
        visit[mode] += _positive(effect - visit[mode])
    return msgspec.structs.replace(evidence, noise=noise[described].tolist(), visit=visit[described].tolist())


def _positive(V: Array) -> Array:
    """The part of a symmetric matrix that has no negative eigenvalue."""
    size, direction = np.linalg.eigh(V)
    return np.asarray((direction * np.maximum(size, 0.0)) @ direction.T)


def _centred(s: Seen, offset: Array) -> Seen:
    """The recording with its residuals around zero: in every mode its own median, where it shows the mode."""
    r = s.r.copy()
    for row, mode in np.ndindex(offset.shape):
        inside = s.inside(row, mode)
        own = np.median(s.r[inside, row]) if inside.sum() >= MINIMUM_TICKS else offset[row, mode]
        r[s.mode == mode, row] -= own
    return replace(s, r=r)


def _spread(recordings: Sequence[Seen], stand_ins: Sequence[int]) -> Array:
    """The robust spread (modes, T) of recordings that lie around zero."""
    found = np.zeros((len(stand_ins), recordings[0].r.shape[1]))
    for row in range(found.shape[1]):
        for mode in set(stand_ins):
            r = np.concatenate([s.r[s.inside(row, mode), row] for s in recordings])
            found[mode, row] = 1.4826 * np.median(np.abs(r)) if len(r) else 0.0
    return found[list(stand_ins)]


def _standard(s: Seen, spread: Array) -> Array:
    """Residuals (n, T) of the steady ticks in parts of their mode's spread."""
    steady = s.usable.all(axis=1) & (s.mode != EDGE)
    standard: Array = s.r[steady] / spread[s.mode[steady]]
    return standard


def visits(recordings: Sequence[Seen], mode: int, rows: list[int]) -> Iterator[Array]:
    """The residuals (n, rows) of every stay in a mode."""
    return (s.r[visit][:, rows] for s in recordings for visit in s.visits(mode))


def _noise(recordings: Sequence[Seen], mode: int, rows: list[int], spread: Array) -> Array:
    """The covariance of the noise, per tick (K, K): what makes a visit's successive blocks differ.

    Half the mean square of their differences; what is slower is the visit's effect. The `spread` (K,) of single ticks
    counts as much as K differences do, so that the covariance is of full rank however few there are.
    """
    K, block = len(rows), recordings[0].time.ticks(BLOCK)
    total, differences = K * np.diag(spread**2), K
    for r in visits(recordings, mode, rows):
        blocks = len(r) // block
        if blocks > 1:
            steps = np.diff(r[: blocks * block].reshape(blocks, block, K).mean(axis=1), axis=0)
            total += block * steps.T @ steps / 2.0
            differences += len(steps)
    return np.asarray(total / differences)


def _visit_effects(recordings: Sequence[Seen], modes: set[int], rows: list[int], noise: Array) -> dict[int, Array]:
    """The covariance (K, K) of a visit's effect by mode: how visits' means differ within a drive.

    It is a posterior mean of what was supposed and what was seen, times what makes it an upper bound: a few visits show
    variances badly, and what was not seen in them would be a fault. The noise of the means is in it, which is little.
    Nor is a mode supposed to be quieter than the quietest of the others: backlash of a sensor, which a few short visits
    may not show, is the same in all of them.
    """
    seen = {mode: _between_visits(recordings, mode, rows) for mode in modes}
    usual = {mode: noise[mode] / recordings[0].time.ticks(VISIT) for mode in modes}
    mean = {mode: (SUPPOSED * usual[mode] + total) / (SUPPOSED + count) for mode, (total, count) in seen.items()}
    found = {}
    for mode, (total, count) in seen.items():
        supposed = usual[mode]
        if others := [mean[other] for other in modes if other not in (mode, EDGE)]:
            supposed = supposed + _positive(min(others, key=np.trace) - supposed)
        total = total + SUPPOSED * supposed
        # where each drive is one visit, its effect is the drive's
        found[mode] = total / chdtri(SUPPOSED + count, 1.0 - LARGER) if count else total / SUPPOSED
    return found


def _between_visits(recordings: Sequence[Seen], mode: int, rows: list[int]) -> tuple[Array, int]:
    """The sum of the squares (K, K) of visits' means around their drive's, and its degrees of freedom."""
    total, count = np.zeros((len(rows), len(rows))), 0
    for s in recordings:
        means = [r.mean(axis=0) for r in visits([s], mode, rows) if len(r) >= MINIMUM_TICKS]
        if len(means) > 1:
            away = np.array(means) - np.mean(means, axis=0)
            total += away.T @ away
            count += len(means) - 1
    return total, count


def _operation(bank: Bank, recordings: Sequence[Seen], described: Sequence[int]) -> Array:
    """The mean (modes, K) of the signal that each generator predicts, over all steady ticks of a mode."""
    signals = [channel.signal for channel in bank.inputs]
    columns = [signals.index(generator.predicts) for generator in bank.generators]
    z, mode = (np.concatenate([getattr(s, name) for s in recordings]) for name in ("z", "mode"))
    usable = np.concatenate([s.usable.all(axis=1) for s in recordings])
    return np.array([z[usable & (mode == k)][:, columns].mean(axis=0) for k in described])


def _strays(recordings: Sequence[Seen], rows: list[int], offset: Array) -> Array:
    """How far the mean of every recording lies from the offset (R, modes, rows).

    One that hardly shows a mode says nothing of it: the others' deviations are that much larger, so that the mean
    square over all R is the one over those that do.
    """
    modes = range(len(recordings[0].modes))
    means = np.array([[_mean(s, mode, rows) for mode in modes] for s in recordings]) - offset
    shown = np.isfinite(means)
    return np.asarray(np.where(shown, means, 0.0) * np.sqrt(len(means) / np.maximum(shown.sum(axis=0), 1)))


def _mean(s: Seen, mode: int, rows: list[int]) -> Array:
    inside = s.usable.all(axis=1) & (s.mode == mode)
    return s.r[inside][:, rows].mean(axis=0) if inside.sum() >= MINIMUM_TICKS else np.full(len(rows), np.nan)


def as_seen(means: Array, spread: Array, drifts: Array, K: int) -> tuple[Array, Array, Array]:
    """What each mean strays by itself (modes, K), the drifts (n, modes, T), as large as R drives show them, and sizes.

    `means` are the deviations of the drives (R, modes, T), `drifts` those that the model names, at the sizes that it
    gives. First their sizes are found, by expectation maximisation: x of a drive is normal with the sizes' variances,

        mean = sum_k x_k drift_k + own,

    then the directions in which what is left strays together. The edge, which is no evidence, is left as it is. Sizes
    and directions are those of the first K generators, and say how far the others move with them.
    """
    R, T, C = len(means), means.shape[2], means.shape[1] - 1
    all_y, all_W = (means / spread)[:, 1:], (drifts / spread)[:, 1:]
    y, W = all_y[..., :K].reshape(R, -1), all_W[..., :K].reshape(len(drifts), C * K)
    size, own = np.ones(len(W)), np.maximum(np.sqrt((y**2).mean(axis=0)), LEAST_OWN)
    x = np.zeros((R, len(W)))
    for _ in range(STEPS):
        gain = (size**2 * W.T).T @ np.linalg.inv((size**2 * W.T) @ W + np.diag(own**2))  # (drifts, means)
        x = y @ gain.T
        V = _positive(np.diag(size**2) - gain @ (size**2 * W.T))
        size = np.sqrt((x**2).mean(axis=0) + V.diagonal())
        own = np.sqrt(((y - x @ W) ** 2).mean(axis=0) + np.einsum("kd,kl,ld->d", W, V, W))
        own = np.maximum(own, LEAST_OWN)
    u = _directions(y - x @ W)
    left = (y - x @ W) - u @ (u.T @ (y - x @ W))
    alone = np.abs(means[..., :K]).max(axis=0) / spread[:, :K]
    alone[1:] = np.sqrt(np.maximum((left**2).mean(axis=0) + own**2 - ((y - x @ W) ** 2).mean(axis=0), 0.0)).reshape(
        C, K
    )
    more = np.tensordot(u.T, all_y - np.tensordot(x, all_W, axes=1), axes=1) / np.sqrt(R)  # (n, modes, T)
    found = np.zeros((len(W) + len(more), len(means[0]), T))
    found[:, 1:] = np.concatenate([size[:, None, None] * all_W, more])
    found[: len(W), EDGE] = size[:, None] * (drifts / spread)[:, EDGE]
    return alone * spread[:, :K], found * spread, size


def _directions(y: Array) -> Array:
    """How much each drive has of n directions in which deviations (R, means) stray together: unit vectors (R, n)."""
    R = len(y)
    drives, size, _ = np.linalg.svd(y, full_matrices=False)
    told = np.cumsum(size**2) / max(float((size**2).sum()), 1e-300)
    kept = min(int(np.searchsorted(told, SEEN_PART)) + 1, R // PER_DIRECTION)
    return np.asarray(drives[:, :kept])


def named_drifts(bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int]) -> Array:
    """Return the shifts (n, modes, T) of the mean residuals by a standard deviation of each drift of the model."""
    model = bank.model
    trials: list[Trial] = [{name: p.value * (1.0 + p.drift)} for name, p in model.parameters.items() if p.drift]
    signals = np.diag([known.drift for known in model.known.values()])
    signals = signals[signals.any(axis=1)]
    steps = np.concatenate([np.zeros((len(trials), len(model.known))), signals])  # (n, nz)
    trials += [{}] * len(signals)
    if not trials:
        return np.zeros((0, len(stand_ins), len(bank.tests)))
    return _shifts(bank, recordings, trials, stand_ins, steps)


def _shifts(
    bank: Bank, recordings: Sequence[Seen], trials: Sequence[Trial], stand_ins: Sequence[int], steps: Array
) -> Array:
    """Return how far (n, modes, rows) the mean residuals move with each of n trials, its samples `steps` (n, nz) on."""
    total = np.zeros((len(stand_ins), len(trials), len(bank.tests)))
    count = np.zeros(len(stand_ins))
    off = np.concatenate([np.zeros((1, steps.shape[1])), steps])
    for s in recordings:
        z = s.z[:, None] + off  # (K, 1 + n, nz)
        r = bank.simulate([{}, *trials], z, np.array([bank.start(first) for first in z[0]]))
        moved = r[:, 1:] - r[:, :1]
        usable = s.usable.all(axis=1)
        for mode in set(stand_ins):
            inside = usable & (s.mode == mode)
            total[mode] += moved[inside].sum(axis=0)
            count[mode] += inside.sum()
    mean = total[list(stand_ins)] / count[list(stand_ins), None, None]
    return np.moveaxis(mean, 1, 0)
