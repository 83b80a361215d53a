"""The pure core as one object: frames and the clock in, events out.

Live, in replay and offline the same frames at the same times give the same events.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from faultline.service.core.decision.decision import Decision
from faultline.service.core.decision.parts import PARTS, Parts
from faultline.service.core.decision.relearning import Relearning
from faultline.service.core.decision.telling import Teller
from faultline.service.core.manifest import Manifest
from faultline.service.core.records.event import Event
from faultline.service.core.residuals.evaluator import Evaluator, TickByTick
from faultline.service.core.residuals.generators import GeneratorBank
from faultline.service.core.residuals.observer import Observer, Tick, Ticks
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.received import Received, Signals
from faultline.service.core.signals.sampling import Sampler
from faultline.service.core.signals.values import Qualities

MOST_AT_ONCE = 64
"""More are not looked at together: the decision takes no more than a block of ticks."""


class Monitor:
    """One vehicle's diagnosis. `source` names the recording or the vehicle, `bundle_id` is the manifest's SHA-256.

    `watch`, where given, is called after each tick with what was seen and decided: for freeze frames and pictures,
    never for decisions. `parts` are those of the decision.
    """

    def __init__(
        self,
        manifest: Manifest,
        bank: GeneratorBank | Evaluator,
        table: DecodeTable,
        source: str,
        bundle_id: str,
        watch: Callable[[Tick, Decision], None] | None = None,
        parts: Parts = PARTS,
    ) -> None:
        self._sampler = Sampler(manifest.inputs)
        modes = ModeTracker(manifest.modes, manifest.inputs, manifest.period_s)
        evaluator = TickByTick(bank, modes) if isinstance(bank, GeneratorBank) else bank
        self._observer = Observer(
            table,
            self._sampler,
            evaluator,
            manifest.period_s,
            manifest.start_within_s,
        )
        self._decision = Decision(manifest, parts)
        self._teller = Teller(source, bundle_id, manifest.time)
        self.watch = watch
        self.relearning: Relearning | None = None
        """While the vehicle's baseline is learnt, no test can tell."""
        self._quality: Qualities | None = None

    def frame(self, t_s: float, can_id: int, is_extended: bool, data: bytes, bus: str = "") -> list[Event]:
        """Take a frame received at log time `t_s` [s] on a bus; return the events of the ticks that lie before it."""
        return self._decide(self._observer.frame(t_s, can_id, is_extended, data, bus))

    def advance(self, t_s: float) -> list[Event]:
        """Advance to log time `t_s` [s]; return the events of every tick up to and at it, frames or no frames."""
        return self._decide(self._observer.advance(t_s))

    def log(self, frames: Iterable[tuple[float, int, bool, bytes]]) -> Iterator[Event]:
        """The events of a whole log of (log time [s], identifier, whether it has 29 bits, data), without waiting."""
        t_s = None
        for t_s, can_id, is_extended, data in frames:
            yield from self.frame(t_s, can_id, is_extended, data)
        if t_s is not None:
            yield from self.advance(t_s)

    def signals(self, signals: Signals) -> Iterator[Event]:
        """Yield the events of a whole log by its signals, the same as `log` gives of its frames."""
        t_s = None
        for piece in signals.pieces():
            t_s = piece.last_s
            yield from self.piece(piece)
        if t_s is not None:
            yield from self.advance(t_s)

    def piece(self, piece: Received) -> Iterator[Event]:
        """Yield the events of the next piece of a log's signals, but for what its last instant may still hold."""
        for row in self._observer.take(piece):
            yield from self._decide([row])

    def rename(self, bundle_id: str) -> None:
        """Go on under another compatible bundle (`core.compatibility`)."""
        self._teller.bundle = bundle_id

    def doubt(self, ages: Mapping[str, float]) -> None:
        """Stop believing these signals, and no others: for so long [s of log time] they may have had two senders."""
        self._sampler.doubt({signal: self._observer.now - age for signal, age in ages.items()})

    @property
    def quality(self) -> Qualities | None:
        """Return the quality of each signal (nz,) at the last tick; None before the first."""
        return self._quality

    @property
    def decision(self) -> Decision:
        """Return the present decision, published or not yet."""
        return self._decision

    @property
    def origin_s(self) -> float | None:
        """Log time of tick 0 [s]; None before it is known."""
        return self._observer.origin_s

    @property
    def next_tick_s(self) -> float | None:
        """Log time of the next tick [s], None before the first frame."""
        return self._observer.next_tick_s

    def _decide(self, rows: Iterable[Ticks]) -> list[Event]:
        events: list[Event] = []
        for row in rows:
            done = 0
            while done < len(row):
                ticks = row.part(done, done + self._most_at_once)
                done += self._decide_first(ticks, events)
        return events

    @property
    def _most_at_once(self) -> int:
        """Ticks that may be decided together: where each is watched, or an event waits for some more, one."""
        return 1 if self.watch is not None or self.relearning is not None or self._teller.waits else MOST_AT_ONCE

    def _decide_first(self, ticks: Ticks, events: list[Event]) -> int:
        """Decide the first of these ticks, as many as the decision takes at once; add their events, return how many."""
        for signal, since in self._sampler.new_doubts().items():
            self._decision.withdraw(self._observer.tick_at(since), signal)
        if self.relearning is not None:
            self.relearning.add(int(ticks.modes[0]), ticks.residuals.at(0))
            mute = np.zeros_like(ticks.residuals.usable)  # for who watches too: silence now heals no fault
            ticks = replace(ticks, residuals=ticks.residuals._replace(usable=mute))
        count = self._decision.extend(ticks.first, ticks.modes, ticks.residuals)
        self._quality = ticks.quality[count - 1]
        events += self._teller.update(ticks.first + count - 1, self._decision)
        if self.watch is not None:
            self.watch(ticks.at(0), self._decision)
        return count
