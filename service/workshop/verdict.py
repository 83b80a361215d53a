"""Verdict of the test: a fault, no fault found, or cannot tell. Never forced. Pure."""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import msgspec

from faultline.service.core.records.discrimination import Separation
from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Fault as Remembered
from faultline.service.core.records.health import Standing, meaning
from faultline.service.protocol.live import FaultMeaning, SystemDescription
from faultline.service.workshop.cycle import Cycle, End, Episode
from faultline.service.workshop.hindrance import hindrances, instead
from faultline.service.workshop.progress import NEAR

Kind = Literal["fault", "no-fault", "cannot-tell"]

ENDS: Mapping[End, str] = {
    "complete": "every step was done",
    "patience": "nothing came further for too long",
    "interrupted": "the test was broken off by hand",
    "service-ended": "the service has ended, or does not answer any more",
    "begun-anew": "the service has taken up another bundle",
}


class Candidate(msgspec.Struct, frozen=True, kw_only=True):
    """One explanation: all of `faults` together, none where it is unknown, then `near` equations, each in words."""

    rank: int
    p: float | None
    faults: list[FaultMeaning]
    near: list[str]


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """`present`: the fault is there at the end. `reasons`: of cannot tell, what is missing; else what to know of it."""

    kind: Kind
    present: bool
    reasons: list[str]
    candidates: list[Candidate]
    separating: list[Separation]


class Seen(NamedTuple):
    """State of the service at the end: the remembered faults, and the standing conditions."""

    remembered: Sequence[Remembered]
    conditions: Sequence[Standing]


def judge(cycle: Cycle, end: End, seen: Seen) -> Verdict:
    """Return the verdict of a cycle that has ended."""
    if cycle.episodes:
        return _fault(cycle, end)
    missing = _missing(cycle, end, seen)
    if missing:
        return Verdict(kind="cannot-tell", present=False, reasons=missing, candidates=[], separating=[])
    return Verdict(kind="no-fault", present=False, reasons=_to_know(cycle), candidates=[], separating=[])


def named(system: SystemDescription, diagnosis: Diagnosis) -> Candidate:
    """Return the diagnosis with what its names mean."""
    faults = {each.name: each for each in system.faults}
    disturbed = {each.equation: f": {each.description}?" for each in system.disturbances}
    equations = {each.name: f" ({each.description}{disturbed.get(each.name, '')})" for each in system.equations}
    return Candidate(
        rank=diagnosis.rank,
        p=diagnosis.p,
        faults=[faults.get(name, FaultMeaning(name=name)) for name in diagnosis.faults],
        near=[f"{name}{equations.get(name, '')}" for name in diagnosis.near],
    )


def _fault(cycle: Cycle, end: End) -> Verdict:
    """Return the verdict for the fault that is there, else the last that was: one that has gone is no all-clear."""
    episode = cycle.episodes[-1]
    ordered = sorted(episode.diagnoses, key=lambda each: (each.rank, -(each.p or 0.0)))
    return Verdict(
        kind="fault",
        present=episode.until_s is None,
        reasons=[*_history(cycle, episode), *_unfinished(cycle, end)],
        candidates=[named(cycle.system, each) for each in ordered],
        separating=episode.separating,
    )


def _history(cycle: Cycle, episode: Episode) -> list[str]:
    said = []
    if episode.stood_before:
        said.append("it was confirmed before the test began")
    else:
        said.append(f"confirmed {episode.since_s:.0f} s after the beginning")
    if episode.begun_anew:
        said.append("the service began anew after that, and it was not seen again since: do the test once more")
    elif episode.until_s is not None:
        gone = f"it was not there any more from {episode.until_s:.0f} s on"
        if episode.stood_before:
            said.append(f"{gone}: where it was repaired before the test, do the test once more")
        else:
            said.append(f"{gone}: it comes and goes, which is a fault all the same")
    if len(cycle.episodes) > 1:
        said.append(f"a fault was confirmed {len(cycle.episodes)} times; this is the last")
    return said


def _unfinished(cycle: Cycle, end: End) -> list[str]:
    """Return why the candidates may be more than necessary."""
    if end == "complete":
        return []
    return [f"{ENDS[end]}: what was not seen may have told candidates apart", *_steps_left(cycle)]


def _to_know(cycle: Cycle) -> list[str]:
    said = [
        "no fault found is not a proof: a small one that was there from the start may be taken for the drive's baseline"
    ]
    if cycle.suspicions:
        times = "once" if cycle.suspicions == 1 else f"{cycle.suspicions} times"
        said.append(f"something was suspected {times}, and dismissed")
    return said


def _missing(cycle: Cycle, end: End, seen: Seen) -> list[str]:
    """Return everything that stands in the way of "no fault found"."""
    reasons = [] if end == "complete" else [ENDS[end]]
    if cycle.latest is None:
        reasons.append("not one sample came: is the ignition on, and does the service hear the bus?")
    reasons += _steps_left(cycle) + _blind(cycle) + _undecided(cycle)
    if cycle.latest is not None and (reasons or cycle.latest.cannot_tell):
        reasons += [f"{each}: {instead(each)}" for each in hindrances(cycle.system, cycle.latest)]
    if cycle.latest is not None and cycle.latest.cannot_tell:
        reasons.append(f"{' '.join(cycle.latest.cannot_tell)} cannot tell at the end")
    reasons += [
        f"fault {each.number} is remembered as being there, and was not seen to be gone"
        for each in seen.remembered
        if each.system == cycle.system.name and each.status.test_failed
    ]
    if reasons:
        reasons += [f"{each.of} {meaning(each.kind)}" for each in seen.conditions]
    return reasons


def _steps_left(cycle: Cycle) -> list[str]:
    progress = cycle.progress
    return [
        f"not done: mode {step.mode}, time {step.visit}: {progress.seconds[k]:.0f} of {step.hold_s:.0f} s"
        for k, step in enumerate(progress.steps)
        if not progress.is_done(k)
    ]


def _blind(cycle: Cycle) -> list[str]:
    """Return tests that could not tell for as long as is required; equal ones in one line."""
    required = required_s(cycle)
    short: dict[str, list[str]] = {}
    for test, seconds in cycle.seconds.items():
        lacking = [f"{mode} {seconds[mode]:.0f} s" for mode in cycle.modes if seconds[mode] < required[mode] - NEAR]
        if lacking:
            short.setdefault(", ".join(lacking), []).append(test)
    whole = ", ".join(f"{mode} {seconds:.0f} s" for mode, seconds in required.items())
    return [f"{' '.join(tests)} could tell only: {lacking} (required: {whole})" for lacking, tests in short.items()]


def _undecided(cycle: Cycle) -> list[str]:
    if cycle.suspected and cycle.latest is not None:
        who = " ".join(cycle.latest.alarm)
        what = f"{who} alarms" if who else "the residuals together have changed"
        return [f"{what} at the end, and no fault is confirmed: something is suspected and not decided"]
    if cycle.latest is not None and not cycle.settled:
        return [f"the last {cycle.quiet_s:.0f} s were not all without a suspicion"]
    return []


def required_s(cycle: Cycle) -> dict[str, float]:
    """Return the seconds in which every test has to be able to tell, by mode."""
    return {mode: sum(step.hold_s for step in cycle.progress.steps if step.mode == mode) for mode in cycle.modes}
