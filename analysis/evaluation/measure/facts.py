"""What is kept of a recording once it was run: counts, and a row a minute, but no samples.

So it is the longest recording that memory grows with, and not all of them: while one is run, its story is all there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from faultline.analysis.evaluation.blocks import Blocks, blocks
from faultline.analysis.evaluation.given import Given
from faultline.analysis.evaluation.judge import Verdict
from faultline.analysis.evaluation.measure.cases import Case, cases_of
from faultline.analysis.evaluation.measure.metrics import Told, told
from faultline.analysis.evaluation.measure.sizes import SizeTold, size_told
from faultline.analysis.evaluation.story import Story
from faultline.analysis.limit.drive import FEWEST
from faultline.analysis.limit.limits import DriveLimits, of_drive
from faultline.analysis.model.display import Units
from faultline.service.core.records.event import Event
from faultline.service.core.signals.values import Mask

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

EVERY_H, WITHIN_S = 500.0, 120.0
"""Hours from alarm to alarm that the limit is for, and how long it looks after an onset: short drives have no more."""
BINS = 60
LARGEST = 100.0
EDGES: Array = np.sinh(np.linspace(-np.arcsinh(LARGEST), np.arcsinh(LARGEST), BINS + 1))
"""Of all histograms of standardised residuals: fine around zero, coarse far away, where large faults are."""


@dataclass(frozen=True)
class Facts:
    """One recording. Arrays have a first row for its fault-free part and a second for the faulty one, then T columns.

    `ticks` (2,) and `modes` (2, modes) count ticks, `usable` (2, T) those in which each generator could tell, `square`
    (2, T) sums their squared residuals, `histogram` (2, T, BINS) counts the standardised ones, and `products` (2, T, T)
    sums these times each other, over the ticks in which all could tell. `episodes` (T,) are the alarms of each detector
    that began in the fault-free part, `delays_s` (T,) from the onset to the first that began after it (NaN: none),
    `standing` (T,) whether one stood at the onset. `size` was told of its fault; `limits` are what a fault-free
    recording says of the smallest faults (`faultline.analysis.limit`).
    """

    given: Given
    case: Case
    verdict: Verdict
    told: Told
    blocks: Blocks
    ticks: Counts
    modes: Counts
    usable: Counts
    square: Array
    histogram: Counts
    products: Array
    episodes: Counts
    delays_s: Array
    standing: Mask
    period_s: float
    size: SizeTold | None = None
    limits: DriveLimits | None = None

    @property
    def hours(self) -> Array:
        """Of the fault-free part and of the faulty one (2,)."""
        return np.asarray(self.ticks * self.period_s / 3600.0)

    @property
    def free_hours(self) -> float:
        """Of the fault-free part, in which some test could tell [h]: the silence of others is no peace."""
        return self.told.free_ticks * self.period_s / 3600.0


def labelled(of: Sequence[Facts], units: Units) -> list[Facts]:
    """All recordings with their cases, whose labels say sizes where another recording has another one."""
    cases = cases_of([one.given.truth for one in of], units)
    return [replace(one, case=cases[one.given.recording.id]) for one in of]


def facts(given: Given, verdict: Verdict, events: list[Event], story: Story) -> Facts:
    """Counts what is in a story, with what the `events` told; its case says no size yet (`labelled`)."""
    K, manifest = len(story.t_s), story.bundle.manifest
    onset = K if verdict.onset_s is None else int(np.searchsorted(story.t_s, verdict.onset_s))
    parts, s, rising = (slice(0, onset), slice(onset, K)), story.standardised, _rising(story.fired)
    known = [fault.name for fault in manifest.faults]
    return Facts(
        given=given,
        case=Case(tuple(sorted(fault.name for fault in given.truth.fault)), ""),
        verdict=verdict,
        told=told(events, np.asarray(story.usable.any(axis=1)), onset, manifest.period_s, verdict.faults, known),
        blocks=blocks(story, onset),
        ticks=np.array([onset, K - onset]),
        modes=np.array([np.bincount(story.mode[part], minlength=len(manifest.modes.names)) for part in parts]),
        usable=np.array([story.usable[part].sum(axis=0) for part in parts]),
        square=np.array([(np.where(story.usable[part], story.r[part], 0.0) ** 2).sum(axis=0) for part in parts]),
        histogram=np.array([_histogram(s[part], story.usable[part]) for part in parts]),
        products=np.array([_products(s[part], story.usable[part]) for part in parts]),
        episodes=rising[:onset].sum(axis=0),
        delays_s=_delays(rising[onset:], manifest.period_s),
        standing=story.fired[onset - 1] & (0 < onset < K),
        period_s=manifest.period_s,
        size=size_told(given.truth, events, story.end_s - story.origin_s),
        limits=_limits(story) if not given.truth.fault else None,
    )


def _limits(story: Story) -> DriveLimits | None:
    """Return the limits of a fault-free story; None where its blocks are too few, or the bundle assumes no sizes."""
    manifest = story.bundle.manifest
    if not manifest.evidence.hypotheses or len(story.blocks) < FEWEST:
        return None
    return of_drive(manifest, story.blocks, EVERY_H, WITHIN_S)


def _rising(alarm: Mask) -> Mask:
    """Where each column (K, T) becomes true."""
    before = np.vstack([np.zeros((1, alarm.shape[1]), dtype=np.bool_), alarm[:-1]])
    return np.asarray(alarm & ~before)


def _delays(rising: Mask, period_s: float) -> Array:
    if not len(rising):
        return np.full(rising.shape[1], np.nan)
    return np.where(rising.any(axis=0), rising.argmax(axis=0) * period_s, np.nan)


def _histogram(s: Array, usable: Mask) -> Counts:
    """Counts (T, BINS); what is beyond is in the outermost bin."""
    clipped = np.clip(s, EDGES[0], EDGES[-1])
    return np.array([np.histogram(clipped[usable[:, row], row], EDGES)[0] for row in range(s.shape[1])])


def _products(s: Array, usable: Mask) -> Array:
    told = s[usable.all(axis=1)]
    return np.asarray(told.T @ told)
