"""The faults that a bundle can size, as polygons of shifts; and which generators the others may shift."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from faultline.service.core.decision.look import SHOWING, Consequences, Look, Segments
from faultline.service.core.decision.straying import History, Level, Means, Straying
from faultline.service.core.manifest import Evidence, Manifest
from faultline.service.core.signals.values import Indices

NO_SIGNATURES: Mapping[str, Mapping[str, str]] = {}


class Hypotheses:
    """All faults of a bundle, as polygons of shifts that begin at none."""

    def __init__(
        self,
        evidence: Evidence,
        alone: Collection[str] = (),
        sensitive: Mapping[str, Mapping[str, str]] = NO_SIGNATURES,
        look: type[Look] = Look,
    ) -> None:
        """`sensitive` has what `without_sizes` returns; a `look` is of this class."""
        self._look = look
        self._straying = Straying(evidence)
        self.segments = _segments(evidence, alone)
        self._brought = {each.fault: _rows_of_consequence(evidence, each.fault) for each in evidence.consequences}
        signals = sorted({signal for predicted in sensitive.values() for signal in predicted.values()})
        self._signatures = {
            fault: np.array([signals.index(of[name]) if name in of else -1 for name in evidence.generators])
            for fault, of in sensitive.items()
        }

    def look(self, means: Means, level: Level | None = None, history: History | None = None) -> Look | None:
        """What the means say at this level, by default an unknown one; None while too little has been seen."""
        seen = means.seen  # (C, K)
        if not seen.any():
            return None
        level = (level or self._straying.unknown).in_operation(means)
        rows = np.flatnonzero(seen)
        d = (self._straying.deviation(means) - level.mean)[seen]
        S = (level.covariance + self._straying.scatter(means))[np.ix_(rows, rows)]
        shift = (means.shift / np.maximum(means.ticks, 1.0))[:, seen]
        shifts = np.concatenate([np.zeros((1, len(d))), shift])
        return self._look(d, S, seen, shifts, self.segments, self._signatures, self._shown(means), history)

    def _shown(self, means: Means) -> dict[str, Consequences]:
        """The consequences that show in some mode."""
        found = {}
        for (fault, rows), ticks in zip(self._brought.items(), means.brought, strict=True):
            shows = (means.seen & (ticks > SHOWING * means.ticks)).any(axis=1)
            if shows.any():
                found[fault] = Consequences(rows, shows)
        return found


def without_sizes(manifest: Manifest) -> dict[str, dict[str, str]]:
    """Return the generators that are sensitive to each fault of which no size is assumed, with what they predict.

    And those that a disturbance moves, of which none is assumed.
    """
    sized = {hypothesis.fault for hypothesis in manifest.evidence.hypotheses}
    free = [fault.name for fault in manifest.faults if fault.name not in sized]
    found = {fault: {g.name: g.predicts for g in manifest.generators if fault in g.faults} for fault in free}
    return found | {
        each.name: {g.name: g.predicts for g in manifest.generators if each.equation in g.equations}
        for each in manifest.disturbances
        if each.name not in sized
    }


def _rows_of_consequence(evidence: Evidence, fault: str) -> Indices:
    """The rows (I, J) of a fault with its consequence, those without it first."""
    row = {(h.fault, h.size, h.brought): k for k, h in enumerate(evidence.hypotheses, start=1) if h.share_of is None}
    sizes = sorted({size for name, size, brought in row if name == fault and brought is not None}, key=abs)
    sizes_brought = sorted({brought for name, _, brought in row if name == fault and brought is not None}, key=abs)
    return np.array([[row[fault, size, each] for each in (None, *sizes_brought)] for size in sizes])


def _segments(evidence: Evidence, alone: Collection[str]) -> Segments:
    """The chains of sizes: the positive and the negative ones of each form of a fault, from none on."""
    chains: dict[tuple[str, str | None, bool], list[tuple[float, int]]] = {}
    for row, h in enumerate(evidence.hypotheses[: evidence.simple], start=1):
        chains.setdefault((h.fault, h.share_of, h.size > 0), []).append((abs(h.size), row))
    faults: list[str] = []
    shares: list[str | None] = []
    number: list[int] = []
    ends: list[tuple[int, int]] = []
    for k, ((fault, share_of, _), chain) in enumerate(chains.items()):
        before = 0
        for _, row in sorted(chain):
            faults.append(fault)
            shares.append(share_of)
            number.append(k)
            ends.append((before, row))
            before = row
    begin, end = np.array(ends, dtype=np.intp).reshape(-1, 2).T
    return Segments(frozenset(alone), faults, shares, np.array(number, dtype=np.intp), begin, end)


def confined(
    conflicts: Sequence[frozenset[str]], misfits: Mapping[tuple[str, ...], float]
) -> dict[tuple[str, ...], float]:
    """The explanations of which every conflict has one fault, with their misfits."""
    return {faults: q for faults, q in misfits.items() if all(conflict.intersection(faults) for conflict in conflicts)}
