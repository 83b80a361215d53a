"""Which tests are not as before, when effects have been added to a model.

Numbers of tests follow from the equations, so a test is known again by its equations: those of before that it has now,
or, where no test has them all, the largest share of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from faultline.analysis.structure import Support, Test

ALIKE = 0.5
"""Of the equations that either test has, those that both must have to be one test."""


@dataclass(frozen=True)
class ChangedTest:
    """A test, by its `name` before and `now`; None where there was or is none.

    `gained` and `lost` are faults that it is sensitive to; `ran` and `runs` whether it could and can be run forward in
    time, `obstacle` why it cannot now.
    """

    name: str | None
    now: str | None
    gained: tuple[str, ...]
    lost: tuple[str, ...]
    ran: bool
    runs: bool
    obstacle: str | None


def changed_tests(before: Sequence[Support], after: Sequence[Support], own: Sequence[str]) -> Iterator[ChangedTest]:
    """The tests that are not as before, those of before first; `own` are the equations that the model had."""
    pairs = dict(_matched(before, after, own))
    for old in before:
        ran, new = isinstance(old, Test), pairs.get(old.name)
        if new is None:
            yield ChangedTest(old.name, None, (), (), ran, runs=False, obstacle="there is no such test now")
            continue
        gained = tuple(fault for fault in new.faults if fault not in old.faults)
        lost = tuple(fault for fault in old.faults if fault not in new.faults)
        runs = isinstance(new, Test)
        if gained or lost or ran != runs:
            yield ChangedTest(old.name, new.name, gained, lost, ran, runs, new.obstacle)
    known = {new.name for new in pairs.values()}
    for new in after:
        if new.name not in known:
            yield ChangedTest(None, new.name, (), (), False, isinstance(new, Test), new.obstacle)


def _matched(before: Sequence[Support], after: Sequence[Support], own: Sequence[str]) -> Iterator[tuple[str, Support]]:
    """The tests of before, by name, with what each is now: the most alike first, every test once."""
    left, new = {test.name: test for test in before}, {test.name: test for test in after}
    likeness = {
        (one.name, other.name): _likeness(set(one.equations), set(other.equations) & set(own))
        for one in before
        for other in after
    }
    for one, other in sorted(likeness, key=lambda pair: -likeness[pair]):
        if likeness[one, other] >= ALIKE and one in left and other in new:
            del left[one]
            yield one, new.pop(other)


def _likeness(one: set[str], other: set[str]) -> float:
    return len(one & other) / len(one | other)
