"""Text for the technician: what to do next, progress, the diagnosis so far, and the verdict."""

from faultline.service.core.records.discrimination import Separation
from faultline.service.core.records.event import Diagnosis
from faultline.service.protocol.live import FaultMeaning, SystemDescription
from faultline.service.workshop.cycle import Cycle
from faultline.service.workshop.hindrance import hindrances, instead
from faultline.service.workshop.verdict import Candidate, Kind, named

SILENCE_S = 2.0

HEADLINES: dict[Kind, str] = {"fault": "FAULT", "no-fault": "NO FAULT FOUND", "cannot-tell": "CANNOT TELL"}


def order(cycle: Cycle) -> str:
    """Return what to do next."""
    tick, progress = cycle.latest, cycle.progress
    if tick is None or cycle.silent_s >= SILENCE_S:
        return "nothing comes from the service: turn the ignition on, and check that the service hears the bus"
    k = progress.next
    if k is None:
        return _waiting(cycle)
    step = progress.steps[k]
    told = f"{instruction(cycle.system, step.mode)}, for another {progress.left(k):.0f} s"
    if progress.must_leave:
        return f"leave this mode for a moment, as it must be a second time. Then {told}"
    if not any(tick.usable):
        return f"{_why(cycle)} Then {told}"
    if tick.mode != step.mode:
        return f"wait: values settle after a change. Then {told}" if tick.mode not in cycle.modes else told
    return f"go on: {told}" if all(tick.usable) else f"go on: {told}. {_why(cycle)}"


def instruction(system: SystemDescription, mode: str) -> str:
    """Return what brings a mode about."""
    return system.instructions.get(mode, f"bring the system into its mode {mode!r}")


def _waiting(cycle: Cycle) -> str:
    if cycle.latest is not None and cycle.latest.diagnoses:
        return "all steps are done: operate the system as you like, until the candidates stand"
    if cycle.suspected:
        return "all steps are done, and something is suspected: repeat the steps until it is decided"
    return "all steps are done: some seconds more without a suspicion"


def _why(cycle: Cycle) -> str:
    """Return why tests cannot tell, and what to do about it."""
    assert cycle.latest is not None
    found = hindrances(cycle.system, cycle.latest)
    if found:
        return " ".join(f"{each}: {instead(each)}." for each in found)
    blind = " ".join(cycle.latest.cannot_tell)
    return (
        f"{blind or 'Some tests'} cannot tell yet: they warm up for some {cycle.system.settling_s:.0f} s."
        if blind
        else "Tests warm up."
    )


def so_far(cycle: Cycle) -> str:
    """Return the diagnosis so far; nothing is a verdict before the end."""
    tick = cycle.latest
    if tick is None:
        return "nothing yet"
    if tick.diagnoses:
        return f"FAULT: {' or '.join(_short(cycle.system, each) for each in tick.diagnoses)}"
    if cycle.episodes:
        last = cycle.episodes[-1]
        return f"a fault was there and has gone: {' or '.join(_short(cycle.system, each) for each in last.diagnoses)}"
    if cycle.suspected:
        return f"something is suspected{f' ({chr(32).join(tick.alarm)} alarm)' if tick.alarm else ''}, not confirmed"
    return "nothing is suspected"


def _short(system: SystemDescription, diagnosis: Diagnosis) -> str:
    candidate = named(system, diagnosis)
    names = " and ".join(each.component or each.name for each in candidate.faults) or "unknown"
    return names if diagnosis.p is None else f"{names} ({diagnosis.p:.0%})"


def _meaning(fault: FaultMeaning) -> str:
    where = ", ".join(filter(None, (fault.component, fault.place)))
    return ": ".join(filter(None, (where, fault.description)))


def candidate_line(candidate: Candidate) -> str:
    """Return an explanation in one line."""
    names = " and ".join(
        each.name
        + (f" ({_meaning(each)})" if each.component else "")
        + (f" SPN {each.spn}" if each.spn is not None else "")
        + (f" FMI {each.fmi}" if each.fmi is not None else "")
        for each in candidate.faults
    )
    near = (
        f"no fault of a component near {', '.join(candidate.near)}" if candidate.near else "none that the model knows"
    )
    likelihood = "" if candidate.p is None else f", p = {candidate.p:.3f}"
    return f"{candidate.rank}. {names or f'unknown: {near}'}{likelihood}"


def separation_line(separation: Separation) -> str:
    """Return the tests that discriminate two explanations."""
    one, other = (" and ".join(names) for names in separation.between)
    tests = [*separation.telling, *(f"{test} (cannot tell now)" for test in separation.waiting)]
    if not tests:
        return f"{one} or {other}: no test knows one and not the other; only sizes in other modes tell them apart"
    return f"{one} or {other}: {', '.join(tests)}"
