"""What added effects change in the structure: the tests, which of them can be run, and what they tell apart."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from faultline.analysis.calibration.identify import TELLS
from faultline.analysis.discrepancy.add.changed_tests import ChangedTest, changed_tests
from faultline.analysis.discrepancy.name.attempt import Attempt
from faultline.analysis.model import Model
from faultline.analysis.structure import (
    Structure,
    Support,
    Test,
    detectability,
    detectable,
    find_tests,
    isolability,
    isolability_of,
    mso_sets,
    structure_of,
)

KINDS = {
    "mixed": "mixed causality",
    "integral": "integral causality",
    "run": "the tests that can be run",
}

CAUSALITIES: tuple[Literal["mixed", "integral"], ...] = ("mixed", "integral")

Pair = tuple[str, str]


@dataclass(frozen=True)
class Diagnosed:
    """What tests of one kind find: detectable faults `gained` and `lost`; pairs `told` apart now, or `mixed_up`.

    The first of a pair could not be told from the second and now can, or the other way round.
    """

    gained: tuple[str, ...]
    lost: tuple[str, ...]
    told: tuple[Pair, ...]
    mixed_up: tuple[Pair, ...]


@dataclass(frozen=True)
class StructureChange:
    """Before and after: numbers of `msos` (minimal over-determined sets), of `tests` and of those that can be `run`.

    `changed` are the tests that are not as before. `diagnosed` is by *mixed* and *integral* causality of the structure,
    and by the tests that can be *run*. Of the `new` parameters, the recordings cannot tell the `untold`, and those
    `at_bound` are at the end of what is possible.
    """

    msos: tuple[int, int]
    tests: tuple[int, int]
    run: tuple[int, int]
    changed: tuple[ChangedTest, ...]
    diagnosed: Mapping[str, Diagnosed]
    new: tuple[str, ...]
    untold: tuple[str, ...]
    at_bound: tuple[str, ...]

    def sentences(self) -> list[str]:
        """The change in words."""
        return [*self._counts(), *self._tests(), *self._diagnosed(), *self._parameters()]

    def _counts(self) -> list[str]:
        counted = f"the model has {self.msos[1]} minimal over-determined sets and {self.tests[1]} tests"
        ran = f"{self.run[1]} of {self.tests[1]} tests can be run"
        as_many = self.msos[0] == self.msos[1] and self.tests[0] == self.tests[1]
        counted += ", as before" if as_many else f"; {self.msos[0]} and {self.tests[0]} before"
        ran += " as before" if as_many and self.run[0] == self.run[1] else f"; {self.run[0]} of {self.tests[0]} before"
        return [counted, ran]

    def _tests(self) -> list[str]:
        stopped: dict[str, list[str]] = {}
        for test in self.changed:
            if test.ran and not test.runs and test.name is not None:
                stopped.setdefault(str(test.obstacle), []).append(test.name)
        found = [f"{', '.join(names)} cannot be run any more: {reason}" for reason, names in stopped.items()]
        for test in self.changed:
            title = test.name if test.name == test.now else f"{test.name} (now {test.now})"
            if test.runs and not test.ran:
                found.append(f"{title if test.name else test.now} can be run now")
            if test.gained:
                found.append(f"{title} is sensitive to {', '.join(test.gained)} too")
            if test.lost:
                found.append(f"{title} is not sensitive to {', '.join(test.lost)} any more")
        return found

    def _diagnosed(self) -> list[str]:
        found: dict[str, list[str]] = {}
        for kind, title in KINDS.items():
            for sentence in _said(self.diagnosed[kind]):
                found.setdefault(sentence, []).append(title)
        if not found:
            return ["detectability and isolability are unchanged"]
        return [f"{sentence}, with {' and '.join(titles)}" for sentence, titles in found.items()]

    def _parameters(self) -> list[str]:
        found = []
        if self.untold:
            found.append(f"the recordings do not tell {', '.join(self.untold)}: the prior decides")
        if self.at_bound:
            found.append(f"at the end of what is possible: {', '.join(self.at_bound)}")
        return found


def structure_change(before: Model, after: Model, attempt: Attempt) -> StructureChange:
    """The change from a model to the one with the effects of an attempt in it."""
    old, new = structure_of(before), structure_of(after)
    tests, now = find_tests(before), find_tests(after)
    ran, runs = ([test for test in found if isinstance(test, Test)] for found in (tests, now))
    was, has = _findings(old, ran), _findings(new, runs)
    added, untold, at_bound = _parameters(before, attempt)
    return StructureChange(
        msos=(len(mso_sets(old)), len(mso_sets(new))),
        tests=(len(tests), len(now)),
        run=(len(ran), len(runs)),
        changed=tuple(changed_tests(tests, now, old.equations)),
        diagnosed={kind: _difference(was[kind], has[kind]) for kind in KINDS},
        new=added,
        untold=untold,
        at_bound=at_bound,
    )


Finding = tuple[Sequence[str], set[Pair]]
"""Detectable faults, and the pairs of which the first cannot be told from the second."""


def _findings(structure: Structure, tests: Sequence[Support]) -> dict[str, Finding]:
    faults = structure.faults
    found: dict[str, Finding] = {
        causality: (detectability(structure, causality), _pairs(isolability_of(structure, causality)))
        for causality in CAUSALITIES
    }
    return {**found, "run": (detectable(tests, faults), _pairs(isolability(tests, faults)))}


def _pairs(alike: Mapping[str, Sequence[str]]) -> set[Pair]:
    return {(fault, other) for fault, others in alike.items() for other in others}


def _difference(was: Finding, has: Finding) -> Diagnosed:
    return Diagnosed(
        gained=tuple(fault for fault in has[0] if fault not in was[0]),
        lost=tuple(fault for fault in was[0] if fault not in has[0]),
        told=tuple(sorted(was[1] - has[1])),
        mixed_up=tuple(sorted(has[1] - was[1])),
    )


def _parameters(before: Model, attempt: Attempt) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """The attempt's parameters that the model before has not: all, those not told, those at a bound."""
    names, n = attempt.unknowns.parameters, len(attempt.unknowns.parameters)
    scale = dict(zip(names, np.abs(attempt.unknowns.theta_by_x(attempt.x)).tolist(), strict=True))
    inside = dict(zip(names, attempt.inside[:n].tolist(), strict=True))
    new = tuple(name for name in names if name not in before.parameters)
    least = (1.0 + TELLS) ** -0.5  # of the prior's standard deviation
    untold = tuple(name for name in new if inside[name] and attempt.spreads[name] > least * scale[name])
    return new, untold, tuple(name for name in new if not inside[name])


def _said(found: Diagnosed) -> Iterator[str]:
    """What has changed, fault by fault."""
    if found.gained:
        yield f"{', '.join(found.gained)} can be detected now"
    if found.lost:
        yield f"{', '.join(found.lost)} cannot be detected any more"
    for pairs, verdict in ((found.told, "can now be told from"), (found.mixed_up, "cannot be told any more from")):
        for fault in dict.fromkeys(first for first, _ in pairs if first not in found.lost):
            yield f"{fault} {verdict} {', '.join(other for first, other in pairs if first == fault)}"
