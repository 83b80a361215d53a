"""Text of records of the event socket."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import msgspec

from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Equation, Fault, Manifest
from faultline.service.core.records.context import SCHEMA as CONTEXT
from faultline.service.core.records.context import Context, LampStates, TroubleCode
from faultline.service.core.records.event import Diagnosis, Event, Size, decode, schema_of
from faultline.service.core.records.fault import CLEARED, Change, Cleared, FaultRecord
from faultline.service.core.records.fault import SCHEMA as FAULT
from faultline.service.core.records.health import SCHEMA as HEALTH
from faultline.service.core.records.health import Health, meaning

WORDS = {
    "started": "started",
    "suspected": "suspected",
    "dismissed": "suspicion dismissed",
    "occurred": "FAULT",
    "refined": "FAULT, refined",
    "healed": "healed",
    "withdrawn": "WITHDRAWN",
    "cannot_tell": "cannot tell",
}
"""How a transition reads."""


CHANGES: dict[Change, str] = {
    "pending": "is pending",
    "confirmed": "is confirmed",
    "failed": "is there again",
    "refined": "has other candidates",
    "withdrawn": "was not it",
    "revoked": "is erased: it was another one, or rested on samples that are doubted",
    "passed": "is not there any more",
    "settled": "was not there for a cycle",
    "aged": "is forgotten",
    "displaced": "is forgotten, for want of room",
}
"""How what has become of a remembered fault reads."""


def described(line: bytes, path: Path, faults: Mapping[str, Fault], equations: Mapping[str, Equation]) -> str:
    """Return the text of a record from `path`; raises InputError if it is none."""
    try:
        schema = schema_of(line)
        if schema == HEALTH:
            return describe_health(msgspec.json.decode(line, type=Health))
        if schema == FAULT:
            return describe_fault(msgspec.json.decode(line, type=FaultRecord))
        if schema == CONTEXT:
            return describe_context(msgspec.json.decode(line, type=Context))
        if schema == CLEARED:
            cleared = msgspec.json.decode(line, type=Cleared)
            return f"{'':9}    erased by {cleared.by}: {', '.join(map(str, cleared.numbers)) or 'nothing'}"
        return describe(decode(line), faults, equations)
    except (msgspec.DecodeError, msgspec.ValidationError) as error:
        raise InputError(f"{path}: sent no event: {line[:80]!r} ({error})") from error


def meanings(manifest: Manifest) -> tuple[dict[str, Fault], dict[str, Equation]]:
    """Return what the names of faults and equations mean; of a disturbed equation, what may disturb it too."""
    equations = {one.name: one for one in manifest.equations}
    for each in manifest.disturbances:
        was = equations[each.equation]
        equations[was.name] = msgspec.structs.replace(was, description=f"{was.description}: {each.description}?")
    return {fault.name: fault for fault in manifest.faults}, equations


def describe(event: Event, faults: Mapping[str, Fault], equations: Mapping[str, Equation] | None = None) -> str:
    """Return the text of an event; `faults` and `equations` explain names, and may be empty."""
    blind_no_more = event.transition == "cannot_tell" and not event.cannot_tell
    head = f"{event.t_s:9.1f} s  {'all tests can tell' if blind_no_more else WORDS[event.transition]}"
    if event.since_tick is not None and event.tick:
        since = event.since_tick * event.t_s / event.tick
        head += f", evidence since {since:.1f} s"
    if event.intermittent:
        head += ", comes and goes"
    lines = [head, *(_candidate(diagnosis, faults, equations or {}) for diagnosis in by_likelihood(event.diagnoses))]
    if not event.diagnoses:
        lines.append(_nothing(event))
    if event.alarm:
        lines.append(f"fired: {' '.join(event.alarm)}")
    if event.cannot_tell:
        lines.append(f"cannot tell: {' '.join(event.cannot_tell)}")
    return "\n             ".join(lines)


def describe_health(health: Health) -> str:
    """Return the text of the standing conditions."""
    if not health.conditions:
        return f"{'':9}    all is well with buses and signals"
    lines = [f"{each.of} {meaning(each.kind)}, since {each.since}" for each in health.conditions]
    return "\n             ".join([f"{'':9}    buses and signals:", *lines])


def describe_fault(record: FaultRecord) -> str:
    """Return the text of a change of a remembered fault."""
    fault = record.fault
    names = " or ".join(" and ".join(each.faults) or "unknown" for each in fault.diagnoses)
    return f"{'':9}    fault {fault.number} {CHANGES[record.change]}: {names}, status 0x{fault.mask:02X}"


def describe_context(context: Context) -> str:
    """What another device says of itself, for a person."""
    head = f"{'':11}" if context.t_s is None else f"{context.t_s:9.1f} s"
    who = f"0x{context.sender:02X}"
    if context.silent:
        return f"{head}  another device, {who}, says nothing any more of its trouble codes"
    what = "has" if context.message == "DM1" else "had"
    codes = [f"SPN {_spns(code)} FMI {code.fmi}{_times(code.count)}" for code in context.codes]
    lamps = [] if context.lamps is None or context.message == "DM2" else _lit(context.lamps)
    said = "; ".join([f"{what} {', '.join(codes) or 'no trouble code'}", *lamps])
    return f"{head}  another device, {who}, {said} ({context.message})"


def _spns(code: TroubleCode) -> str:
    """The SPN, or those that it may be."""
    return " or ".join(map(str, dict.fromkeys([code.spn, *code.other_spns])))


def _times(count: int | None) -> str:
    return "" if count is None else f" ({count} times)"


def _lit(lamps: LampStates) -> list[str]:
    """The lamps that are asked for."""
    states = msgspec.structs.asdict(lamps).items()
    flashes = {"on": "", "slow": ", flashing", "fast": ", flashing fast"}
    return [f"{name.replace('_', ' ')} lamp{flashes[state]}" for name, state in states if state in flashes]


def _nothing(event: Event) -> str:
    """Return the text of an event without candidates, which does not mean no fault."""
    if event.transition == "withdrawn":
        return "what was told rests on samples that are doubted now: whether there is a fault is not known"
    if event.transition == "dismissed":
        if event.alarm:
            return "nothing was confirmed: it is taken for the drive's baseline, though a test alarms"
        return "nothing is suspected any more, and nothing was confirmed"
    if event.alarm or event.suspected:
        why = "" if event.alarm else "no test alarms by itself, but the residuals together have changed: "
        return f"{why}not confirmed yet: what is seen now decides"
    if event.cannot_tell:
        return "no alarm, but not known to be free of faults: some tests cannot tell"
    return "no fault so far: every test is quiet"


def by_likelihood(diagnoses: Iterable[Diagnosis]) -> list[Diagnosis]:
    """Return diagnoses as people read them: by rank, those of one rank with the more probable first."""
    return sorted(diagnoses, key=lambda each: (each.rank, -(each.p or 0.0)))


def _candidate(diagnosis: Diagnosis, faults: Mapping[str, Fault], equations: Mapping[str, Equation]) -> str:
    likelihood = "" if diagnosis.p is None else f", p = {diagnosis.p:.3f}"
    if not diagnosis.faults:
        known = (f"{name} ({equations[name].description})" if name in equations else name for name in diagnosis.near)
        where = f", near {', '.join(known)}" if diagnosis.near else ""
        why = "no fault of a component" if diagnosis.near else "none that the model knows"
        why = "no fault of the model explains what is seen" if diagnosis.p is None else why
        return f"{diagnosis.rank}. unknown: {why}{where}{_sizes(diagnosis)}{likelihood}"
    names = " and ".join(f"{name}{_meaning(faults.get(name))}" for name in diagnosis.faults)
    return f"{diagnosis.rank}. {names}{_sizes(diagnosis)}{likelihood}"


def _sizes(diagnosis: Diagnosis) -> str:
    return "".join(f", {_size(each)}" for each in diagnosis.sizes)


def _size(size: Size) -> str:
    """An interval, what is lost as a loss.

    >>> _size(Size(low=-47.0, high=-41.0, unit="%", of="area of the filter")), _size(Size(low=0.1, high=0.2, unit="V"))
    ('41 to 47 % of the area of the filter lost', 'by 0.1 to 0.2 V')
    """
    if size.of and size.high <= 0.0:
        return f"{-size.high:g} to {-size.low:g} {size.unit} of the {size.of} lost"
    return f"by {size.low:g} to {size.high:g} {size.unit}{size.of and f' of the {size.of}'}"


def _meaning(fault: Fault | None) -> str:
    return f" ({': '.join(filter(None, (fault.component, fault.description)))})" if fault else ""
