"""What confirms and ranks faults: the hypotheses, and how far fault-free means stray.

A hypothesis (fault and size) is the model with that fault. Fed with the samples of the moment, it predicts another
output than the fault-free model; under the fault the residual shifts by that difference. No fault recording is needed.
"""

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.bank import FAULTS, Bank, Trial
from faultline.analysis.graph.independence import independent
from faultline.analysis.graph.runnable import trial_of
from faultline.analysis.tuning.assumed import biases_of, consequences_of, hypotheses_of, sizes_of
from faultline.analysis.tuning.few import ranked_few
from faultline.analysis.tuning.moves import Moves
from faultline.analysis.tuning.prior import Known
from faultline.analysis.tuning.statistics import of_drive
from faultline.analysis.tuning.straying import (
    Supposed,
    as_seen,
    doubted,
    noise,
    positive,
    strays,
    supposed_drifts,
    supposed_visits,
    visit_effect,
)
from faultline.analysis.tuning.thresholds import Seen
from faultline.service.core.decision.straying import MINIMUM_TICKS
from faultline.service.core.manifest import Evidence, Follower, Generator, Hypothesis, Twin
from faultline.service.core.signals.modes import EDGE

Array = npt.NDArray[np.float64]

ALLOWANCE = 0.3
"""Means stray by this part of the mode's spread besides: a few recordings, or other vehicles, cannot show all."""
ENOUGH = 8
"""Recordings from which the way in which all means stray together from drive to drive is seen, and not assumed."""
USUAL = 0.95
"""The part of fault-free ticks in which a network's sigma is usual."""


def gather(
    bank: Bank,
    offset: Array,
    recordings: Sequence[Seen],
    stand_ins: Sequence[int],
    apart: Sequence[Seen] | None = None,
    known: Known | None = None,
    moves: Moves | None = None,
    *,
    few: bool = False,
) -> tuple[Evidence, list[float]]:
    """Return the evidence of a bundle, and the sizes of the drifts that the model names, in parts of what it says.

    Mode m is described by the ticks of mode `stand_ins[m]`, as in `tune_detectors`.

    `offset` (T, modes) is where the residuals lie without a fault. `apart` are the same recordings, each centred by the
    others of its vehicle: how far a drive strays is seen in them, as a drive that has been centred by itself too
    strays less. `known` is what a fleet teaches of the vehicle: then drives, visits and ticks stray by that and by
    what these recordings add. `moves` are those of the recordings, where they are needed again. `few`: ranking looks at
    no more tests without states than their equations have redundancy.
    """
    moves = moves or Moves()
    described = list(stand_ins)
    within = [_centred(s, offset) for s in recordings]
    spread = np.maximum(_spread(within, described), bank.sigma / 2)  # (modes, T)
    standard = np.concatenate([_standard(s, spread) for s in within])
    rows = ranked_few(bank, standard) if few else independent(standard)
    order = [*rows, *(row for row in range(len(bank.generators)) if row not in rows)]  # followers are behind
    K, everywhere, around = len(rows), spread[:, order], offset[order].T  # (modes, T)
    spread, offset = everywhere[:, :K], around[:, :K]
    ticks, visit = _within(recordings, described, rows, spread, known)
    away = strays(recordings, order, around)[:, described]
    if known is not None:
        of_fleet = known.posterior
        own, drifts = of_fleet.own[described][:, rows], of_fleet.drifts[:, described][..., order]
        sizes = of_fleet.sizes
    else:
        own = np.abs(away[..., :K]).max(axis=0)
        drifts = named_drifts(bank, recordings, described, moves)[..., order]
        sizes = np.ones(len(drifts))
        if not bank.has_equations and len(recordings) < ENOUGH:
            own = np.abs(away - away.mean(axis=1, keepdims=True))[..., :K].max(axis=0)
            drifts = np.concatenate([drifts, supposed_drifts(away, everywhere)])
        if len(recordings) >= ENOUGH:
            seen = strays(apart or recordings, order, around)[:, described]
            larger = doubted(len(recordings) - 1.0)
            own, drifts, sizes = (larger * each for each in as_seen(seen, everywhere, drifts, K))
    allowance = np.hypot(own, ALLOWANCE * spread)
    assumed = hypotheses_of(bank.model) if bank.has_equations else biases_of(bank.model, _samples(recordings))
    hypotheses = with_usual(assumed, bank.only(rows), recordings, described, moves)
    evidence = Evidence(
        generators=[bank.generators[row].name for row in rows],
        offset=offset.tolist(),
        spread=spread.tolist(),
        noise=ticks.tolist(),
        visit=visit.tolist(),
        allowance=allowance.tolist(),
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


def _within(
    recordings: Sequence[Seen], described: Sequence[int], rows: Sequence[int], spread: Array, known: Known | None
) -> tuple[Array, Array]:
    """The covariances (modes, K, K) of ticks and of visits, by what is supposed of them and what is seen."""
    modes, drives = {*described}, [of_drive(s) for s in recordings]
    if known is None:
        of_ticks = Supposed({mode: np.diag(spread[mode] ** 2) for mode in modes}, float(len(rows)))
    else:
        of_ticks = known.prior.noise.supposed(rows, modes)
    found = np.zeros((2, len(described), len(rows), len(rows)))
    for mode in modes:
        found[0, mode] = noise(drives, mode, rows, of_ticks)
    if known is None:
        of_visits = supposed_visits(drives, modes, rows, found[0], recordings[0].time)
    else:
        of_visits = known.prior.visit.supposed(rows, modes)
    for mode in modes:
        found[1, mode] = visit_effect(drives, mode, rows, of_visits)
    return found[0, [*described]], found[1, [*described]]


def _samples(recordings: Sequence[Seen]) -> Array:
    """The samples (K, nz) of all recordings."""
    return np.concatenate([s.z for s in recordings])


def with_usual(
    hypotheses: Sequence[Hypothesis], bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int], moves: Moves
) -> list[Hypothesis]:
    """Return the hypotheses, those that a drive without a fault may seem to have with their mean shifts in these."""
    rows = _apparent(hypotheses, linear=bank.has_equations)
    if not rows:
        return []
    trials = [trial_of(hypotheses[row], bank.model) for row in rows]
    steps = np.zeros((len(trials), len(bank.model.known)))
    # under the fault it is the measured that moves
    shifts = -_shifts(bank, recordings, trials, stand_ins, steps, moves)
    usual = dict(zip(rows, shifts.tolist(), strict=True))
    return [msgspec.structs.replace(h, usual=usual.get(row)) for row, h in enumerate(hypotheses)]


def _apparent(hypotheses: Sequence[Hypothesis], *, linear: bool) -> list[int]:
    """Return the rows of the apparent faults (`core.decision.baseline`).

    Where small shifts are linear in the size, as by equations, that is the smallest size of each form of a fault. What
    a network answers to a bias of its inputs is not: every size of it is one but the largest, in both directions.
    """
    forms: dict[tuple[str, str | None], list[int]] = {}
    for row, h in enumerate(hypotheses):
        if h.brought is None:
            forms.setdefault((h.fault, h.share_of), []).append(row)
    found: list[int] = []
    for rows in forms.values():
        by_size = sorted(rows, key=lambda row: abs(hypotheses[row].size))
        largest = abs(hypotheses[by_size[-1]].size)
        found += by_size[:1] if linear else [row for row in by_size if abs(hypotheses[row].size) < largest]
    return found


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
        away = strays(recordings, [row, names.index(twin)], offset[[row, names.index(twin)]].T)  # (R, modes, 2)
        apart = np.abs(away[..., 0] - away[..., 1]).max(axis=0)[described]
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
    moves, names = Moves(), [generator.name for generator in bank.generators]
    order = [names.index(name) for name in (*evidence.generators, *(f.generator for f in evidence.followers))]
    K, own = len(evidence.generators), named_drifts(bank, recordings, stand_ins, moves)[..., order]
    own *= np.array(sizes).reshape(-1, 1, 1)
    followers = [
        msgspec.structs.replace(f, drifts=[*own[..., column].tolist(), *f.drifts[len(own) :]])
        for column, f in enumerate(evidence.followers, start=K)
    ]
    drifts = [*own[..., :K].tolist(), *evidence.drifts[len(own) :]]
    hypotheses = with_usual(evidence.hypotheses, bank.only(order[:K]), recordings, stand_ins, moves)
    return msgspec.structs.replace(evidence, drifts=drifts, followers=followers, hypotheses=hypotheses)


def no_surer(evidence: Evidence, bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int]) -> Evidence:
    """Evidence whose ticks and visits stray as much as they do in these recordings, in every direction."""
    described = list(stand_ins)
    names = [generator.name for generator in bank.generators]
    rows = [names.index(name) for name in evidence.generators]
    ticks, visit = np.array(evidence.noise), np.array(evidence.visit)
    more_ticks, more_visit = _within(recordings, described, rows, np.array(evidence.spread), None)
    for mode in set(described):
        ticks[mode] += positive(more_ticks[mode] - ticks[mode])
        visit[mode] += positive(more_visit[mode] - visit[mode])
    return msgspec.structs.replace(evidence, noise=ticks[described].tolist(), visit=visit[described].tolist())


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


def _operation(bank: Bank, recordings: Sequence[Seen], described: Sequence[int]) -> Array:
    """The mean (modes, K) of the signal that each generator predicts, over all steady ticks of a mode."""
    signals = [channel.signal for channel in bank.inputs]
    columns = [signals.index(generator.predicts) for generator in bank.generators]
    z, mode = (np.concatenate([getattr(s, name) for s in recordings]) for name in ("z", "mode"))
    usable = np.concatenate([s.usable.all(axis=1) for s in recordings])
    return np.array([z[usable & (mode == k)][:, columns].mean(axis=0) for k in described])


def named_drifts(bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int], moves: Moves) -> Array:
    """Return the shifts (n, modes, T) of the mean residuals by a standard deviation of each drift of the model."""
    model = bank.model
    trials: list[Trial] = [{name: p.value * (1.0 + p.drift)} for name, p in model.parameters.items() if p.drift]
    signals = np.diag([known.drift for known in model.known.values()])
    signals = signals[signals.any(axis=1)]
    steps = np.concatenate([np.zeros((len(trials), len(model.known))), signals])  # (n, nz)
    trials += [{}] * len(signals)
    if not trials:
        return np.zeros((0, len(stand_ins), len(bank.tests)))
    return _shifts(bank, recordings, trials, stand_ins, steps, moves)


def _shifts(
    bank: Bank,
    recordings: Sequence[Seen],
    trials: Sequence[Trial],
    stand_ins: Sequence[int],
    steps: Array,
    moves: Moves,
) -> Array:
    """Return how far (n, modes, rows) the mean residuals move with each of n trials, its samples `steps` (n, nz) on."""
    total = np.zeros((len(stand_ins), len(trials), len(bank.tests)))
    count = np.zeros(len(stand_ins))
    for s, moved in zip(recordings, moves.of(bank, recordings, trials, steps), strict=True):
        usable = s.usable.all(axis=1)
        for mode in set(stand_ins):
            total[mode] += moved[mode]
            count[mode] += (usable & (s.mode == mode)).sum()
    mean = total[list(stand_ins)] / count[list(stand_ins), None, None]
    return np.moveaxis(mean, 1, 0)
