"""The debounce counter, against the rules that it cites."""

import pytest

from faultline.service.core.memory.debounce import Debounce


def test_the_detection_counter_is_a_linear_map() -> None:
    counter = Debounce(failed=4, passed=2)
    assert counter.fdc == 0
    seen = []
    for _ in range(6):
        counter.seen(True)
        seen.append(counter.fdc)
    assert seen == [32, 64, 95, 127, 127, 127]
    seen = []
    for _ in range(3):
        counter.seen(False)
        seen.append(counter.fdc)
    assert seen == [-64, -128, -128]


def test_a_change_of_direction_begins_from_zero() -> None:
    counter = Debounce(failed=3, passed=3)
    assert [counter.seen(up) for up in (True, True, False, True, True, True)] == [
        None,
        None,
        None,
        None,
        None,
        "failed",
    ]


@pytest.mark.parametrize(("how", "left"), [("freeze", 2), ("reset", 0)])
def test_what_cannot_be_seen_stands_or_is_forgotten(how: str, left: int) -> None:
    counter = Debounce(failed=3, passed=3)
    counter.seen(True)
    counter.seen(True)
    counter.disable(how)  # type: ignore[arg-type]
    assert counter.counter == left
