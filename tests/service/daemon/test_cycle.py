"""Operation cycles from traffic: the key is on while frames come."""

import pytest

from faultline.service.daemon.cycle import SILENT_S, Cycle, OperationCycle


def test_a_cycle_begins_with_frames_and_ends_with_their_absence() -> None:
    key = OperationCycle(Cycle(), "boot-1", 0.0)
    assert key.look(0, 100.0) == []
    assert key.look(5, 101.0) == ["begun"]
    assert key.cycle == Cycle(number=1, boot="boot-1", lasts=True)
    assert key.look(9, 130.0) == []
    assert key.look(9, 130.0 + SILENT_S) == [], "a loose plug is no key"
    assert key.look(9, 131.0 + SILENT_S) == ["ended"]
    assert key.look(9, 5000.0) == []
    assert key.look(10, 5001.0) == ["begun"]
    assert key.cycle.number == 2


def test_a_service_that_is_started_again_goes_on_with_the_cycle() -> None:
    key = OperationCycle(Cycle(number=7, boot="boot-1", lasts=True), "boot-1", 0.0)
    assert key.look(3, 1.0) == []
    assert key.cycle.number == 7


@pytest.mark.parametrize(("frames", "steps"), [(0, ["ended"]), (3, ["ended", "begun"])])
def test_a_machine_that_was_off_ends_it(frames: int, steps: list[str]) -> None:
    key = OperationCycle(Cycle(number=7, boot="boot-1", lasts=True), "boot-2", 0.0)
    assert key.look(frames, 1.0) == steps
    assert key.cycle.number == 7 + (frames > 0)


def test_a_machine_that_slept_ends_it() -> None:
    key = OperationCycle(Cycle(), "boot-1", 0.0)
    assert key.end() == []
    key.look(1, 1.0)
    assert key.end() == ["ended"]
    assert key.look(2, 2.0) == ["begun"]
