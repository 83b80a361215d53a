"""What is known of the fault memory, and for how long, whatever becomes of the service."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from j1939_service import FakeService, fault

from faultline.service.core.j1939.dm1 import Code
from faultline.service.j1939.dtcs import Known
from faultline.service.j1939.memory import ASK_BLIND_S, ASK_S, KEEP_S, OLDEST_S, PATIENCE_S, RETRY_S, Memory

PUMP = fault(1, (4374, 0))
NONE = Known((), (), amber=False)


class Asker:
    """A memory in a time that stands still but for `later`."""

    def __init__(self, service: FakeService) -> None:
        self.said: list[str] = []
        self.memory = Memory(service.control, service.events, self.said.append)
        self.now = 0.0

    def until(self, condition: Callable[[], bool], step: float = 0.0) -> None:
        """Takes what comes, at this one moment, or each time so much later, until that holds."""
        end = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.001)
            self.later(step)

    def later(self, seconds: float) -> None:
        self.now += seconds
        self.memory.take(self.now)

    def known(self) -> Known | None:
        return self.memory.known

    @property
    def active(self) -> tuple[Code, ...] | None:
        return None if self.memory.known is None else self.memory.known.active


@pytest.fixture
def service(tmp_path: Path) -> Iterator[FakeService]:
    with FakeService(tmp_path) as made:
        yield made


@pytest.fixture
def asker(service: FakeService) -> Iterator[Asker]:
    made = Asker(service)
    yield made
    made.memory.close()


def test_asks_at_once_and_again_when_anything_is_told(service: FakeService, asker: Asker) -> None:
    service.start()
    asker.until(lambda: asker.known() == NONE)
    asker.until(lambda: bool(service._subscribers))
    asker.until(lambda: service.asked >= 1)
    service.tell(PUMP)
    asker.until(lambda: asker.active == (Code(4374, 0, 1),))
    service.tell()
    asker.until(lambda: asker.known() == NONE)
    assert asker.said == []


def test_asks_now_and_then_though_nothing_is_told(service: FakeService, asker: Asker) -> None:
    service.start()
    asker.until(lambda: asker.known() == NONE and len(asker.memory.filenos()) == 2)
    asker.later(0.0)
    service.faults = [PUMP]
    asked = service.asked
    asker.later(ASK_S - 0.01)
    time.sleep(0.02)
    asker.later(0.0)
    assert (service.asked, asker.active) == (asked, ())
    assert asker.memory.due <= ASK_S
    asker.later(0.02)
    asker.until(lambda: asker.active == (Code(4374, 0, 1),))


def test_asks_more_often_while_nobody_tells(service: FakeService, asker: Asker) -> None:
    service.start(events=False)
    asker.until(lambda: asker.known() == NONE)
    service.faults = [PUMP]
    asker.later(ASK_BLIND_S)
    asker.until(lambda: asker.active == (Code(4374, 0, 1),))


def test_asks_once_it_can_hear_again_what_is_told(service: FakeService, asker: Asker) -> None:
    """What was told meanwhile went past it."""
    service.start(events=False)
    asker.until(lambda: asker.known() == NONE)
    service.faults = [PUMP]
    service.start(control=False)
    asker.later(RETRY_S)
    assert asker.now < ASK_BLIND_S
    asker.until(lambda: asker.active == (Code(4374, 0, 1),))


def test_an_answer_to_nothing_is_none(service: FakeService, asker: Asker) -> None:
    service.start()
    asker.until(lambda: asker.known() == NONE and asker.memory._asked is None and len(asker.memory.filenos()) == 2)
    asker.later(0.0)
    asker.until(lambda: asker.memory._asked is None)
    service.askers[-1].sendall(b'{"faults":null}\n')
    service.tell(PUMP)
    asker.until(lambda: asker.active == (Code(4374, 0, 1),))
    assert asker.said == []


def test_a_change_that_is_told_while_it_is_asked_is_asked_again(service: FakeService, asker: Asker) -> None:
    service.start()
    asker.until(lambda: asker.known() == NONE and bool(service._subscribers))
    asker.later(0.0)
    service.answer = None
    asked = service.asked
    service.tell()
    asker.until(lambda: service.asked == asked + 1)
    service.answer = ...
    service.tell(PUMP)
    asker.until(lambda: asker.memory._due == asker.now)
    service.askers[-1].sendall(b'{"faults":[]}\n')  # the late answer to the first question
    asker.until(lambda: asker.active == (Code(4374, 0, 1),))


def test_what_was_known_last_is_good_for_a_while_after_the_service_is_gone(service: FakeService, asker: Asker) -> None:
    service.start()
    service.faults = [PUMP]
    asker.until(lambda: asker.active == (Code(4374, 0, 1),))
    service.stop()
    asker.until(lambda: not asker.memory.filenos())
    asker.later(KEEP_S - 0.01)
    assert asker.active == (Code(4374, 0, 1),)
    assert asker.memory.due <= asker.now + 0.01
    asker.later(0.01)
    assert asker.known() is None
    for _ in range(20):
        asker.later(1.0)
    assert len(asker.said) == 1
    assert asker.said[0].endswith("control.sock: the service is not there: without an answer for 5 s DM1 is not sent")
    service.start()
    asker.later(RETRY_S)
    asker.until(lambda: asker.active == (Code(4374, 0, 1),))
    assert asker.said[1:] == [f"{service.control}: the service answers"]


def test_a_short_absence_changes_nothing(service: FakeService, asker: Asker) -> None:
    service.start()
    asker.until(lambda: asker.known() == NONE)
    service.stop()
    asker.until(lambda: not asker.memory.filenos())
    asker.later(KEEP_S / 2)
    service.start()
    asker.later(RETRY_S)
    asker.until(lambda: asker.memory._failing is None)
    asker.later(KEEP_S)
    assert asker.known() == NONE


def test_a_service_that_hangs_is_as_one_that_is_gone(service: FakeService, asker: Asker) -> None:
    service.start()
    asker.until(lambda: asker.known() == NONE and bool(service._subscribers))
    asker.later(0.0)
    asked = service.asked
    service.answer = None
    asker.later(ASK_S)
    asker.until(lambda: service.asked > asked)
    begun = asker.now
    asker.later(PATIENCE_S)
    assert asker.known() == NONE
    while asker.now < begun + KEEP_S:
        asker.later(0.25)
    assert asker.known() is None
    assert len(asker.said) == 1
    assert "the service does not answer within 2 s" in asker.said[0]
    service.answer = ...
    asker.until(lambda: asker.known() == NONE, step=0.01)


def test_nothing_old_is_known_after_this_process_was_stopped(service: FakeService, asker: Asker) -> None:
    service.start()
    asker.until(lambda: asker.known() == NONE)
    asker.later(OLDEST_S)
    assert asker.known() is None
    asker.until(lambda: asker.known() == NONE)


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ({"error": {"code": "busy", "message": "too many connections"}}, "refused (too many connections)"),
        ({"error": {}}, "refused (it did not say why)"),
        (b"hello\n", "gave no answer that is understood (JSON is malformed"),
        ({"faults": [{"number": 1}]}, "gave no answer that is understood (Object missing required field"),
        (b"\xff\n", "gave no answer that is understood ("),
    ],
)
def test_an_answer_that_is_none_is_told_and_asked_for_again(
    service: FakeService, asker: Asker, answer: object, told: str
) -> None:
    service.start()
    service.answer = answer
    asker.until(lambda: bool(asker.said) and "is not there" not in asker.said[-1])
    assert told in asker.said[-1]
    assert asker.known() is None
    service.answer = ...
    asker.until(lambda: asker.known() == NONE, step=0.01)
    assert asker.now < 2 * ASK_BLIND_S


def test_what_is_not_on_the_bus_is_said_once(service: FakeService, asker: Asker) -> None:
    service.start()
    service.faults = [fault(1), fault(2, *((spn, 1) for spn in range(1, 500)))]
    asker.until(lambda: asker.known() is not None)
    for _ in range(3):
        asker.later(ASK_S)  # asks
        asker.until(lambda: asker.memory._asked is None)
    assert asker.said == [
        "fault 1 (pump) has no SPN and FMI: no code of it is sent",
        "54 codes are more than a message has room for; the oldest faults' are sent",
    ]
