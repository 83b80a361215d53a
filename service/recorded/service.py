"""Service of a finished recording: diagnosed as a whole, then served at the sockets of a live one."""

import os
import selectors
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby
from operator import itemgetter
from pathlib import Path

from faultline.service.bundle.load import Bundle
from faultline.service.core.records.event import Event
from faultline.service.core.signals.received import Signals
from faultline.service.daemon.config import MemoryConfig
from faultline.service.daemon.control_server import ControlServer, page_of, page_with
from faultline.service.daemon.fault_recorder import FaultRecorder
from faultline.service.daemon.pipeline import LAG_S, BusChannel, Pipeline, watched
from faultline.service.daemon.sequencer import Sequencer
from faultline.service.logs import Frame, Log
from faultline.service.outputs.control import Asker, ControlSocket, Then
from faultline.service.outputs.socket import EventSocket
from faultline.service.protocol.errors import RefusedError
from faultline.service.protocol.live import History
from faultline.service.protocol.questions import Question
from faultline.service.recorded.bus import LogBus
from faultline.service.recorded.history import Ticks
from faultline.service.store.file import Record
from faultline.service.store.journal import Journal

LARGEST = 2**53 - 1
MOST_TICKS = 5000  # of one answer
SHOWN_TICKS = 2000  # where the question does not say


class Recording:
    """Log, diagnosed with a bundle: its ticks, its records, and the fault memory at its end.

    `progress` is told the log time [s] that is done. Its records have no wall clock: a log knows none for certain.
    """

    def __init__(
        self, log: Log, path: Path, bundle: Bundle, say: Callable[[str], None], progress: Callable[[float], None]
    ) -> None:
        self.history = Ticks(bundle.manifest)
        self.records: list[Record] = []
        self._buses: deque[str] = deque()  # of the frames that the bus gives
        self._bus = LogBus(self._noted(log.by_bus(bundle.table)))
        self._line = BusChannel("log", self._bus, [watched(bundle, log.id, 1.0, self.history.add)], say, str(path))
        self._journal = Journal(None, say)
        sequencer = Sequencer(log.id, 0, run="", wall=lambda: None)
        memory = MemoryConfig()
        self._fault_recorder = FaultRecorder(
            sequencer, self._journal, [self._line], memory, memory.frame_s, "", 0.0, say, standing=list[str]
        )
        if log.values is None:
            self._diagnose(progress)
        else:
            self._diagnose_signals(log.signals(bundle.table), progress)
        self.answers = _Answers(self._fault_recorder, self._journal, log.id, self)

    def _diagnose(self, progress: Callable[[float], None]) -> None:
        [kept] = self._line.bundles
        while frames := self._bus.receive():
            tagged = zip([self._buses.popleft() for _ in frames], frames, strict=True)
            for bus, group in groupby(tagged, key=itemgetter(0)):
                self._take(kept, list(kept.hear([frame for _, frame in group], bus)))
            progress(self._bus.now)
        self._take(kept, kept.silence(self._bus.now + LAG_S))

    def _diagnose_signals(self, signals: Signals, progress: Callable[[float], None]) -> None:
        """The same of signals that are in a table, alone or beside frames."""
        [kept] = self._line.bundles
        for piece in signals.pieces():
            self._bus.now = piece.last_s
            self._take(kept, list(kept.take(piece)))
            progress(piece.last_s)
        self._take(kept, kept.silence(self._bus.now + LAG_S))

    def _noted(self, frames: Iterable[tuple[str, Frame]]) -> Iterator[Frame]:
        for bus, frame in frames:
            self._buses.append(bus)
            yield frame

    def _take(self, kept: Pipeline, events: list[Event]) -> None:
        self._fault_recorder.take(kept, events)
        self._fault_recorder.look(self._bus.now)
        self.records += self._journal.take()


class _Answers(ControlServer):
    """Control server of a recording, with the history of the whole drive; nothing can be erased."""

    is_recording = True

    def __init__(self, fault_recorder: FaultRecorder, journal: Journal, source: str, recording: Recording) -> None:
        super().__init__(fault_recorder, journal, lambda: (source, None, len(recording.records), []))
        self._recording = recording

    def answer(self, question: Question, asker: Asker, then: Then) -> None:
        """Calls `then` with the answer; raises `RefusedError`."""
        match question.ask:
            case "history":
                then(self._history(question))
            case "clear" | "relearn":
                raise RefusedError("not-allowed", "this is a recording: nothing of it can be erased or learnt anew")
            case _:
                super().answer(question, asker, then)

    def _history(self, question: Question) -> History:
        self._system(question.name)
        most = SHOWN_TICKS if question.count is None else question.count
        if not 1 <= most <= MOST_TICKS:
            raise RefusedError("bad-request", f"`count` must be 1 to {MOST_TICKS}")
        after = -1 if question.after is None else question.after
        before = LARGEST if question.before is None else question.before
        if not -1 <= after <= LARGEST or not 0 <= before <= LARGEST:
            raise RefusedError("bad-request", "a tick is a number from 0")
        return self._recording.history.part(question.name, after, before, most)

    def _records(self, question: Question, then: Then) -> None:
        """Answer from memory: there is no store."""
        page = page_of(question)
        records = self._recording.records
        if page.after is not None:
            found = [each for each in records if each.seq > page.after][: page.most]
        else:
            found = [each for each in records if page.before is None or each.seq < page.before][-page.most :]
        then(page_with(found))


class Serving:
    """Serves a recording at two sockets in the folder, from a thread of its own, as long as the context lasts.

    Raises:
        InputError: the folder cannot be used.
    """

    def __init__(self, folder: Path, recording: Recording) -> None:
        self.control, self.events = folder / "control.sock", folder / "events.sock"
        self._asked = ControlSocket(self.control)
        self._asked.answers = recording.answers
        self._heard = EventSocket(self.events, recording.records)
        self._selector = selectors.DefaultSelector()
        self._end = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)

    def __enter__(self) -> "Serving":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.eventfd_write(self._end, 1)
        self._thread.join()
        os.close(self._end)

    def _run(self) -> None:
        with self._selector, self._asked, self._heard:
            self._selector.register(self._end, selectors.EVENT_READ)
            self._asked.register(self._selector)
            self._heard.register(self._selector)
            while True:
                ready = self._selector.select()
                if any(key.fd == self._end for key, _ in ready):
                    return
                self._asked.serve(ready)
                self._heard.serve(ready)
