"""The decision of a tick, in two stages: something is suspected, a fresh window confirms; conflicts, ranked diagnoses.

The change detection suspects (`core.decision.drive_change`); and detectors do whose residuals are no evidence, or while
some of the evidence cannot tell. That opens a window. A sure change confirms a fault, or what is seen in the window
once some hypothesis fits it better than no fault does by more than chance makes; until then nothing is named. Names are
hitting sets of the conflicts: of the tests that alarm, and of those that the window shows to deviate. Networks beside
equations open the window and are no conflicts: they may alarm where a fault that their test decouples brings operation
that was rare in training, and while the pressure is built up. So what they alone suspect is told once it has lasted. In
a bundle of networks alone they are the evidence.

Hypotheses say where residuals end; how they get there lasts as long as the tests' warm-up. So the window is cleared
once after that time, and until then candidates are not ranked. From then on conflicts are what deviates in it, as
sensitive tests alarm by chance too, and a fault has to fit what is seen to be named (`core.decision.explaining`).

A fault may come and go (`core.decision.intermittence`): seconds in which it was not there are left out of the window,
and from then on explanations are not ranked, as that hangs on which modes have seen how much of it. If the evidence had
said before that it may be none of the declared ones, it still may.
"""

from functools import partial

import numpy as np

from faultline.service.core.decision.blocks import BLOCK as BLOCK_OF_MEANS
from faultline.service.core.decision.drive_change import DriveChange
from faultline.service.core.decision.explaining import Explainer, Explanations
from faultline.service.core.decision.hypotheses import Hypotheses, without_sizes
from faultline.service.core.decision.intermittence import BLOCK, CLEAR, Intermittence
from faultline.service.core.decision.look import Fitted, Look
from faultline.service.core.decision.model_error import ModelError
from faultline.service.core.decision.parts import PARTS, Parts
from faultline.service.core.decision.window import Blocks, Window
from faultline.service.core.detectors.bank import NONE, DetectorBank
from faultline.service.core.manifest import Manifest
from faultline.service.core.records.event import Diagnosis, candidates
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import FloatArray, Indices, Mask
from faultline.service.core.time_scale import Span, ticks_of

RANKING = Span(periods=15)
"""The window is looked at at every tick that this divides: the same ticks whatever the episode's first.

Less often than it takes for a change to be told (`core.decision.telling.SETTLE`): what alternates is told too. A
bus delivers the same recording with a little jitter each time; misfits compared at every tick would cross at another
one each time.
"""

SURE = 100.0
"""A misfit of no fault from which something is wrong even if no hypothesis points there."""

CONFIRMED = 30.0
"""How much better than no fault a hypothesis must fit. Fault-free windows of eight vehicles had up to 26."""

VAIN = Span(settlings=30, seconds=600)
"""A suspicion that was not confirmed until then is taken for the baseline's."""

DOUBTED, DOUBTS = 10.0, 20
"""A fault is withdrawn where, once residuals have settled, no fault at all fits too in so many looks in a row, and the
best one fits better by less than this: what confirmed it was on its way to somewhere usual."""

UNSEEN = Span(settlings=3, seconds=60)
"""An alarm of this length during which some test of the evidence cannot tell is confirmed by its length: a
filter that is all but shut takes its own pressure out of the operating range. Who it is remains open among those
that alarms allow."""

ALONE = Span(settlings=1, seconds=20)
"""An alarm of networks alone, beside equations, is a suspicion once it has lasted so long. Those that were dismissed
lasted 5 to 13 s, at the end of a start-up (trucks 903 to 905)."""

GONE_BLOCKS = 60
"""A fault that no block of so many in a row has shown is gone."""

DEVIATING = 5.0
"""Standard deviations from which a mean of the window is a conflict."""

LINGER = Span(settlings=3, seconds=60)
"""Without an alarm until a confirmed episode ends: a fault near a threshold is one fault, not many."""

HEALED = Span(settlings=0.75, seconds=15)
"""And so long in each mode that showed the fault: a clogged nozzle does not heal at idle."""


class Decision:
    """Detectors and isolation: residuals in; alarmed tests, tests that cannot tell and ranked diagnoses out."""

    def __init__(self, manifest: Manifest, parts: Parts = PARTS) -> None:
        self._tests = [generator.test for generator in manifest.generators]
        names = [generator.name for generator in manifest.generators]
        self._fresh_detectors = partial(DetectorBank, manifest.detectors, names, manifest.time, parts.cusums)
        self._detectors = self._fresh_detectors()
        self._inputs = [frozenset(generator.inputs) for generator in manifest.generators]
        of_equations = {g.graph for g in manifest.generators if g.name in manifest.evidence.generators}
        self._trusted = frozenset(row for row, g in enumerate(manifest.generators) if g.graph in of_equations)
        time = manifest.time
        self._ranking, self._block, self._vain = map(time.ticks, (RANKING, BLOCK, VAIN))
        self._quick = time.ticks(BLOCK_OF_MEANS) <= self._ranking
        self._unseen_most, self._linger, self._healed = map(time.ticks, (UNSEEN, LINGER, HEALED))
        self._alone, self._longest = time.ticks(ALONE), time.ticks(BLOCK_OF_MEANS)
        self._settle_ticks = ticks_of(
            max(g.warm_up_s for g in manifest.generators if g.name in manifest.evidence.generators), time.period_s
        )
        self._looked_at = [names.index(name) for name in manifest.evidence.generators]
        alone = {each.name for each in manifest.disturbances}
        self._spread = np.full((len(manifest.evidence.spread), len(names)), np.inf)
        self._spread[:, self._looked_at] = manifest.evidence.spread
        self._hypotheses = Hypotheses(manifest.evidence, alone, without_sizes(manifest), parts.look)
        self._explainer = Explainer(manifest)
        covered = [*manifest.evidence.generators, *(each.generator for each in manifest.evidence.followers)]
        self._covered = frozenset(map(names.index, covered))
        self._networks = frozenset(range(len(names))) - self._trusted
        self._model_error = ModelError(manifest.evidence, names)
        self._change = DriveChange(manifest.evidence, names, self._hypotheses, time, parts.changes)
        self._window, self._quiet = Blocks(manifest.evidence, names, time), Window(manifest.evidence, names, time)
        self._intermittence = Intermittence(self._hypotheses)
        self._latest: int | None = None  # tick at which a test alarmed last, in this episode
        self._first = 0  # tick at which one did first
        self._alarmed: frozenset[int] = frozenset()  # those that did, the last time that any did
        self._deviating: frozenset[int] = frozenset()  # tests that deviate in the window
        self._names = manifest.modes.names[1:]
        self._showing = np.zeros(len(self._names), dtype=np.bool_)  # modes in which they do
        self._calm = np.zeros(len(self._names))  # ticks of every mode since anything was suspicious
        self._look: Look | None = None
        self._fitting: list[Fitted] = []  # the faults that the window could not tell apart, the last time it showed one
        self._settled = self._cleared = self._by_evidence = self._ranked = False
        self._is_backed = False  # whether more than networks suspects something, or they have for long
        self._unseen = 0  # ticks of an alarm since all tests of the evidence could tell
        self._doubts = 0  # looks in a row at which nothing is wrong after all
        self._doubted: frozenset[int] | None = None  # generators that alarm though nothing is wrong, once that is seen
        self._undeclared = False  # whether the evidence said last that the fault may be none of the declared ones
        self._explanations = Explanations()
        self._seen: list[Diagnosis] = []  # what the last look said
        self.confirmed = self.withdrawn = False
        self.level = np.zeros(len(self._tests))  # residuals without the baseline, as detectors see them
        self._mode, self._usable = EDGE, np.zeros(len(self._tests), dtype=np.bool_)  # of the last tick
        self._blind: tuple[tuple[bytes, frozenset[int]], list[str]] = (b"", frozenset()), []  # of which state, and who

    def update(self, tick: int, mode: int, residuals: Residuals) -> None:
        """Takes the residuals of a tick. The detector of a test that cannot tell is frozen, its alarm stands."""
        self.extend(tick, np.array([mode]), residuals.in_a_row)

    def extend(self, first: int, modes: Indices, residuals: Residuals) -> int:
        """Take ticks in a row from the `first` on, with their modes (n,), as `update` does one by one; return how many.

        They end before one at which something may change that an event says, or with it where that is the first; only
        a suspicion may begin at the last of several.
        """
        mode = int(modes[0])
        most = min(self._room(first, mode), len(modes))
        residuals = self._model_error.beside(mode, residuals.part(0, most))
        if most > 1:
            residuals = residuals.part(0, self._alike(modes[:most], residuals.usable))
        level = self._change.without_baseline(mode, residuals)
        ticks = self._detectors.extend(first, mode, residuals._replace(level=level))
        residuals = residuals.part(0, ticks)
        self._mode, self._usable, self.level = mode, residuals.usable[-1], level[ticks - 1]
        suspected = self._latest is not None and self._doubted is None
        self._change.extend(first, mode, residuals, suspected=suspected)
        self._judge(first + ticks - 1, mode, residuals)
        return ticks

    def _room(self, tick: int, mode: int) -> int:
        """Return for how many ticks from this one on nothing is due but at the last."""
        if not self._detectors.takes_rows:
            return 1
        room = self._change.room(mode)
        if self._latest is not None:
            if not self.suspicious:  # it waits for the episode's end
                return 1
            dues = [self._first + self._settle_ticks, self._first + self._alone]
            until = [-tick % self._ranking, -tick % self._block, *(due - tick for due in dues if due >= tick)]
            room = min(room if self._change.is_held else room - 1, *until)
        return int(max(1, min(room, self._longest)))

    def _alike(self, modes: Indices, usable: Mask) -> int:
        """Return how many of the ticks are as the one before them, or 1: in the same mode, with the same tests."""
        alike = (modes == self._mode) & (usable == self._usable).all(axis=1)
        return len(alike) if alike.all() else max(1, int(alike.argmin()))

    def _judge(self, tick: int, mode: int, residuals: Residuals) -> None:
        """Decide after ticks in a row, of which this is the last."""
        if tick % self._ranking == 0:
            self._change.look()
        if self.suspicious:
            if self._latest is None or self._is_news():
                self._open(tick)
                residuals = residuals.part(-1, len(residuals.r))
            self._latest, self._alarmed = tick, self._detectors.alarmed or self._alarmed
            self._is_backed |= self._suspects_but(self._networks) or tick - self._first >= self._alone
            self._calm[:] = 0.0
            self._quiet.clear()
        if self._latest is None:
            return
        settled = tick - self._first >= self._settle_ticks
        if settled and not self._cleared:
            self._window.clear()
            self._cleared = True
        self._window.extend(mode, residuals)
        self._quiet.extend(mode, residuals.part(-1, len(residuals.r)))
        if tick % self._ranking == 0 and self._doubted is None and (self.suspicious or not self._settled):
            self._weigh(settled)  # but not what is healing
            self._doubt(tick)
        if tick % self._block == 0:
            self._close_block()
        if self.suspicious:
            self._count_unseen(len(residuals.r))
        else:
            self._wait(tick, mode, residuals)

    def withdraw(self, tick: int, signal: str) -> None:
        """Discard an episode that began at `tick` or later and rests on `signal`, whose samples since then are doubted.

        What its tests have seen of that signal is no evidence: detectors begin anew. An older fault stands.
        """
        rests = any(signal in self._inputs[row] for row in self._deviating | self._alarmed | self._detectors.firing)
        if self._latest is None or self._first < tick or not rests:
            return
        self._detectors = self._fresh_detectors()
        self._change.rest()
        self._latest, self._doubted, self._explanations = None, None, Explanations()
        self.withdrawn, self.confirmed = self.confirmed, False

    def _open(self, tick: int) -> None:
        """An episode begins: what is seen from now on is looked at apart."""
        self.withdrawn = False
        self._look, self._deviating, self._settled = None, frozenset(), False
        self._fitting, self._undeclared, self._is_backed = [], False, False
        self._showing[:], self._alarmed = False, frozenset()
        self._first, self._cleared, self._unseen = tick, False, 0
        self._doubts, self._doubted = 0, None
        self._window.clear()
        self._intermittence.rest()
        self._change.suspect(tick)

    def _count_unseen(self, ticks: int) -> None:
        """Counts while a test of the equations alarms and can tell, and one that the window looks at cannot."""
        alarmed = self._detectors.alarmed & self._trusted
        if self._usable[self._looked_at].all() or not alarmed:
            self._unseen = 0
        elif any(self._usable[row] for row in alarmed):
            self._unseen += ticks

    def _wait(self, tick: int, mode: int, residuals: Residuals) -> None:
        """A tick without alarm: the episode ends in time. Ticks that could not show the fault do not count."""
        assert self._latest is not None
        if not self._could_show(mode, residuals):
            self._latest += 1
        elif mode != EDGE:
            self._calm[mode - 1] += 1
        over = (self._calm[self._showing] >= self._healed).all() and tick - self._latest >= self._linger
        if (over and self._is_gone()) or not self.confirmed:
            if self.confirmed:
                self._change.rest()
            self._latest, self._doubted, self.confirmed = None, None, False
            self._explanations = Explanations()

    def _could_show(self, mode: int, residuals: Residuals) -> bool:
        """Return whether the tests that deviated can tell now, and their networks' errors are not beyond the spread."""
        rows = sorted(self._deviating) or self._looked_at
        known = not residuals.excess.ndim or (residuals.excess[-1, rows] <= self._spread[mode, rows] ** 2).all()
        return bool(known and self._usable[rows].all())

    def _is_gone(self) -> bool:
        """Whether all that the window could not tell apart fits what is seen since then far worse than no fault."""
        quiet = self._hypotheses.look(self._quiet.means, self._change.level)
        return quiet is None or all(quiet.misfit_at(each) > quiet.nothing + CLEAR for each in self._fitting)

    def _weigh(self, settled: bool) -> None:
        """Looks at the window; what the one before it said stands until it has seen enough."""
        if self._unseen >= self._unseen_most:  # the window cannot confirm what keeps its tests from telling
            if not (self.confirmed and self._settled):
                self.confirmed, self._settled = True, False
                self._explain()
            return
        look = self._hypotheses.look(self._window.means, self._change.level, self._window.history)
        if look is None:  # the system may hunt, and never come to a mode in which residuals can be weighed
            could = settled and self._usable[self._looked_at].any()
            if could and self._change.sure and self._alarmed & self._trusted:
                self._confirm()
            return
        self._look, self._settled = look, settled
        far = look.sigmas.max(axis=0) > DEVIATING
        self._deviating = frozenset(row for row, beyond in zip(self._looked_at, far, strict=True) if beyond)
        self._showing |= look.sigmas.max(axis=1) >= min(DEVIATING, look.sigmas.max())
        doubtful = settled and look.gain < DOUBTED and look.nothing <= look.limit and not self._change.alarm
        self._doubts = self._doubts + 1 if doubtful else 0
        if look.gain >= DOUBTED:
            self._fitting = look.fitting
        if self.confirmed or self._change.sure or look.gain > CONFIRMED or look.nothing > SURE:
            self._confirm()

    def _confirm(self) -> None:
        self.confirmed = True
        self._change.hold()
        self._explain()

    def _close_block(self) -> None:
        """What the last seconds have shown is kept, unless the fault comes and goes."""
        if not (self.confirmed and self._settled):
            self._window.keep()
            return
        self._intermittence.judge(self._window, self._change.level)
        if self._intermittence.gone == GONE_BLOCKS:
            self._change.rest()

    def _doubt(self, tick: int) -> None:
        """Whether nothing is wrong after all, or what is wrong cannot be confirmed: then it is the baseline's."""
        if self._doubts >= DOUBTS or (not self.confirmed and tick - self._first >= self._vain):
            self.confirmed, self._explanations = False, Explanations()
            self._doubted = self._detectors.firing
            self._change.accept()

    def _is_news(self) -> bool:
        """Whether something else is suspected than what was doubted."""
        if self._doubted is None:
            return False
        self._doubted &= self._detectors.firing
        return self._change.alarm or self._detectors.firing != self._doubted

    @property
    def suspicious(self) -> bool:
        """Whether a change of the baseline is suspected, or a detector alarms that says more than the change does.

        So does any where the change has not all of the evidence, or comes late, as blocks last longer than looks are
        apart.
        """
        return self._suspects_but(NONE)

    def _suspects_but(self, rows: frozenset[int]) -> bool:
        """Return whether something is suspicious without the level detectors of these generators."""
        covers = self._quick and not self._change.blind
        return self._change.alarm or self._detectors.beside(rows | self._covered if covers else rows)

    @property
    def sums(self) -> FloatArray:
        """Each generator's largest level detector in parts of its threshold, with the residual's sign (T,)."""
        return self._detectors.sums

    @property
    def fired(self) -> Mask:
        """The generators (T,) whose level alarms, whether they can tell now or not; not of those frozen for long."""
        return np.isin(np.arange(len(self._tests)), [*self._detectors.alarmed])

    @property
    def showing(self) -> list[str]:
        """The operating modes that have shown what is wrong, since it was suspected."""
        return [self._names[mode] for mode in np.flatnonzero(self._showing)]

    @property
    def alarm(self) -> list[str]:
        """Tests that alarm and can tell now: one of their generators does."""
        firing = self._detectors.firing
        return list(dict.fromkeys(test for row, test in enumerate(self._tests) if row in firing and self._usable[row]))

    @property
    def cannot_tell(self) -> list[str]:
        """Tests that cannot tell now: none of their generators can, or one that alarms cannot and no other alarms."""
        key = self._usable.tobytes(), self._detectors.firing
        if key != self._blind[0]:
            self._blind = key, self._unable()
        return self._blind[1]

    def _unable(self) -> list[str]:
        telling = {test for test, usable in zip(self._tests, self._usable, strict=True) if usable}
        frozen = {self._tests[row] for row in self._detectors.firing if not self._usable[row]} - {*self.alarm}
        return [test for test in dict.fromkeys(self._tests) if test not in telling or test in frozen]

    @property
    def since(self) -> int | None:
        """The tick at which the evidence of the alarmed tests began, or the suspicion where none alarms."""
        since = self._detectors.since
        return self._first if since is None and self._latest is not None else since

    @property
    def suspected(self) -> bool:
        """Return True if an open episode is a suspicion: by more than networks alone, or theirs has lasted."""
        return self.is_open and self._is_backed

    @property
    def is_open(self) -> bool:
        """Return True if an episode is neither confirmed nor taken for the baseline's, whether it is told or not."""
        return self._latest is not None and not self.confirmed and self._doubted is None

    @property
    def intermittent(self) -> bool:
        """Whether a confirmed fault comes and goes: neither its size nor its modes are sure, so nothing is ranked."""
        return self.confirmed and self._intermittence.found

    @property
    def settled(self) -> bool:
        """Return True if what is confirmed is ranked by what the window shows, and not named by conflicts alone."""
        return bool(self.named) and self._ranked

    @property
    def diagnoses(self) -> list[Diagnosis]:
        """What explains a confirmed fault, best first. An alarm whose test has become unable to tell still counts."""
        return self._explanations.diagnoses

    @property
    def named(self) -> list[Diagnosis]:
        """Return the diagnoses; their sizes may be missing."""
        return self._explanations.named

    def _explain(self) -> None:
        """What a look says stands once the next one says the same: near a limit they alternate."""
        seen = self._explained()
        if candidates(seen.named) == candidates(self._seen) or not self.named:
            self._explanations, self._ranked = seen, self._by_evidence
        else:
            self._explanations.compute_sizes()
        self._seen = seen.named

    def _explained(self) -> Explanations:
        alarmed = self._alarmed & self._trusted
        look = self._look if self._settled and not self.intermittent else None
        self._by_evidence = look is not None and bool(look.faults)
        if look is not None and self._by_evidence:
            seen = self._explainer.by_evidence(sorted(self._deviating or alarmed), look)
            self._undeclared = any(not each.faults and each.rank == 1 for each in seen.named)
            return seen
        rows = (self._deviating or alarmed) if self._settled else self._deviating | alarmed
        return self._explainer.by_conflicts(sorted(rows), self._look, self.intermittent and self._undeclared)
