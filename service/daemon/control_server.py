"""Control server (docs/control.md): the fault memory, the state, what names mean, live values."""

from collections.abc import Callable, Iterable

import msgspec

from faultline.service.core.records.health import Standing
from faultline.service.daemon.fault_recorder import FaultRecorder, SystemState
from faultline.service.daemon.sequencer import now
from faultline.service.daemon.views import baseline_status, bus_status, description, live_tick, system_status
from faultline.service.distribution import installed_version
from faultline.service.outputs.control import Asker, Live, Then, refusal
from faultline.service.protocol.answers import (
    Begun,
    Erased,
    FaultDetail,
    FaultList,
    FreezeFrames,
    RecordPage,
    ServiceState,
    StoreStatus,
)
from faultline.service.protocol.errors import RefusedError
from faultline.service.protocol.questions import Question
from faultline.service.store.file import Record
from faultline.service.store.journal import Journal, Page

VERSION = installed_version()
LARGEST_PAGE = 500


class ControlServer:
    """Answers from the loop's thread. `state` gives what the loop knows: source, since, seq, conditions."""

    is_recording = False

    def __init__(
        self,
        fault_recorder: FaultRecorder,
        journal: Journal,
        state: Callable[[], tuple[str, str | None, int, list[Standing]]],
    ) -> None:
        self._fault_recorder, self._journal, self._state = fault_recorder, journal, state
        self._waiting: list[tuple[int, Erased, Then]] = []  # erased, and not told yet

    def answer(self, question: Question, asker: Asker, then: Then) -> None:
        """Call `then` with the answer, now or later; raises `RefusedError`."""
        match question.ask:
            case "faults":
                then(self._faults())
            case "fault":
                then(self._fault(question.number))
            case "clear":
                self._clear(question.number, asker, then)
            case "relearn":
                then(self._relearn(question.name, asker))
            case "state":
                then(self._service_state())
            case "records":
                self._records(question, then)
            case "system":
                then(description(self._system(question.name)))
            case "history":
                raise RefusedError("unknown", "a service on the vehicle keeps no history; a recording has one")
            case "live":
                raise AssertionError("is served by the socket")

    def live(self, name: str | None) -> Live:
        """Return the source of a system's newest tick; raises `RefusedError`."""
        here = self._system(name)
        before = here.recorder.latest  # however old it is: who asks now is told what comes from now on
        return lambda sent: None if here.recorder.latest is before else live_tick(here, sent)

    def told(self, record: Record) -> None:
        """Answer who erased faults with this record: whether that is on the disk."""
        for seq, answer, then in [each for each in self._waiting if each[0] == record.seq]:
            if self._journal.path is None or self._journal.has(seq):
                then(answer)
            else:
                message = "erased, but the disk has not taken that: after a restart it may be there again"
                then(refusal("not-kept", message))
        self._waiting = [each for each in self._waiting if each[0] != record.seq]

    def _faults(self) -> FaultList:
        memory = self._fault_recorder.memory
        return FaultList(faults=[*memory.faults.values()], overflow=memory.remembered.overflow, seq=self._state()[2])

    def _fault(self, number: int | None) -> FaultDetail:
        faults = self._fault_recorder.memory.faults
        if number is None:
            raise RefusedError("bad-request", "name the fault by its `number`")
        if number not in faults:
            raise RefusedError("unknown", f"no fault {number} is remembered")
        return FaultDetail(fault=faults[number], frames=FreezeFrames(**self._fault_recorder.frames(number)))

    def _clear(self, number: int | None, asker: Asker, then: Then) -> None:
        if not asker.may_clear:
            raise RefusedError("not-allowed", f"{asker.user} may not erase faults: see [control] clear")
        if number is not None and number not in self._fault_recorder.memory.faults:
            raise RefusedError("unknown", f"no fault {number} is remembered")
        cleared = self._fault_recorder.clear(number, asker.user)
        if cleared is None:
            raise RefusedError("not-kept", "the fault memory failed, and nothing was erased: see the service's log")
        self._waiting.append((cleared.seq, Erased(cleared=cleared.numbers, id=cleared.id), then))

    def _relearn(self, name: str | None, asker: Asker) -> Begun:
        if not asker.may_clear:
            raise RefusedError("not-allowed", f"{asker.user} may not let it relearn: see [control] clear")
        here = self._system(name)
        self._fault_recorder.relearn(here, asker.user)
        baseline = baseline_status(here)
        assert baseline is not None
        return Begun(system=here.name, baseline=baseline)

    def _service_state(self) -> ServiceState:
        source, since, seq, conditions = self._state()
        journal = self._journal
        return ServiceState(
            source=source,
            version=VERSION,
            since=since,
            wall=now(),
            is_recording=self.is_recording,
            cycle=self._fault_recorder.cycle,
            seq=seq,
            conditions=conditions,
            store=StoreStatus(
                path=None if journal.path is None else str(journal.path),
                kept=journal.kept_up_to,
                failing=any(each.kind == "store-failed" for each in journal.conditions),
            ),
            buses=[bus_status(line) for line in self._fault_recorder.lines],
            systems=[system_status(each) for each in self._fault_recorder.systems.values()],
        )

    def _records(self, question: Question, then: Then) -> None:
        def found(records: list[Record] | None) -> None:
            none = refusal("busy", "there is no store, or it cannot be read now")
            then(none if records is None else page_with(records))

        self._journal.read(page_of(question), found)

    def _system(self, name: str | None) -> SystemState:
        systems = self._fault_recorder.systems
        if name is None and len(systems) == 1:
            return next(iter(systems.values()))
        if name not in systems:
            raise RefusedError("unknown", f"there is no system {name!r}; those are {', '.join(systems)}")
        return systems[name]


def page_of(question: Question) -> Page:
    """Return the page that is asked for; raises `RefusedError` where that makes no sense."""
    most = 100 if question.count is None else question.count
    if not 1 <= most <= LARGEST_PAGE:
        raise RefusedError("bad-request", f"`count` must be 1 to {LARGEST_PAGE}")
    if question.after is not None and question.before is not None:
        raise RefusedError("bad-request", "ask for what came `after` a number, or `before` one")
    for number in (question.after, question.before):
        if number is not None and not 0 <= number < 2**63:
            raise RefusedError("bad-request", f"{number} is no number of a record")
    return Page(most, question.after, question.before)


def page_with(records: Iterable[Record]) -> RecordPage:
    """Return the answer with these records."""
    return RecordPage(records=[msgspec.Raw(record.line.rstrip()) for record in records])
