"""The size that was told of a fault, beside the true one."""

from collections.abc import Sequence

import msgspec

from faultline.analysis.evaluation.truth import TrueFault, Truth
from faultline.analysis.model.units import parse_unit
from faultline.service.core.records.event import Event

PART, PERCENT = "1", "%"


class SizeTold(msgspec.Struct, frozen=True, kw_only=True):
    """The last interval of 95 % that was told of a fault, in `unit`, `of` what it is a part.

    `true` is the true size in this unit, None where the truth says no unit that can be converted; `covered` whether
    the interval has it.
    """

    fault: str
    low: float
    high: float
    unit: str
    of: str
    true: float | None
    covered: bool | None


def size_told(truth: Truth, events: Sequence[Event], until_s: float) -> SizeTold | None:
    """The size told of a single fault by the last event up to `until_s` [s of `Event.t_s`]; None where none was."""
    if len(truth.fault) != 1:
        return None
    [fault] = truth.fault
    within = [event for event in events if event.t_s <= until_s]
    own = [d for d in within[-1].diagnoses if d.faults == [fault.name] and d.sizes] if within else []
    if not own:
        return None
    size = own[0].sizes[0]
    true = _in_unit(fault, size.unit, negative=size.low + size.high < 0.0)
    return SizeTold(
        fault=fault.name,
        low=size.low,
        high=size.high,
        unit=size.unit,
        of=size.of,
        true=true,
        covered=None if true is None else size.low <= true <= size.high,
    )


def _in_unit(fault: TrueFault, unit: str, *, negative: bool) -> float | None:
    """The true size in a unit; a part that is lost has no sign in a truth, and what is told of it may have one."""
    if fault.unit == PART and unit == PERCENT:
        return float(f"{(-1.0 if negative else 1.0) * 100.0 * abs(fault.size):.6g}")
    try:
        (own, dimension), (told, other) = parse_unit(fault.unit), parse_unit(unit)
    except ValueError:
        return None
    return float(f"{fault.size * own / told:.6g}") if dimension == other else None
