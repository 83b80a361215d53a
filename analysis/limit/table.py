"""The limits in words, in the units in which people read sizes."""

from faultline.analysis.limit.limits import Limit, Limits
from faultline.service.core.manifest import Evidence, SizeUnit

BEYOND = "-"


class Units:
    """Units convert the sizes of each fault and form into what people read."""

    def __init__(self, evidence: Evidence) -> None:
        self._units: dict[tuple[str, str | None], SizeUnit] = {
            (each.fault, each.share_of): each for each in evidence.sizes
        }

    def size(self, fault: str, share_of: str | None, size: float | None) -> str:
        """Return a size with its unit; BEYOND for none."""
        if size is None:
            return BEYOND
        unit = self._units.get((fault, share_of))
        return f"{size:.3g}" if unit is None else unit.display.difference(size)

    def read(self, fault: str, share_of: str | None, size: float) -> float:
        """Return a size as a number in its unit."""
        unit = self._units.get((fault, share_of))
        return size if unit is None else size / unit.display.size

    def named(self, fault: str, share_of: str | None) -> str:
        """Return the name of that unit, and of what it is a part."""
        unit = self._units.get((fault, share_of))
        return "" if unit is None else f"{unit.display.unit} {'of ' if unit.of else ''}{unit.of}".strip()


def lines(found: Limits, units: Units) -> list[str]:
    """Return the tables, a line each: smallest sizes, then every assumed size."""
    chances = f"one alarm in {found.every_h:g} h without a fault, {found.nats:.1f} nats"
    told = [
        f"what any detector could do at best in {', '.join(found.drives)}: {chances}",
        "",
        "smallest size found within a time, median of the onsets; behind the last one the best and the worst tenth",
        "  " + " " * 24 + "".join(f"{f'{time_s:g} s':>14}" for time_s in found.times_s),
    ]
    told.append("  " + f"{'onsets':24}" + "".join(f"{count:>14}" for count in found.onsets))
    for each in found.smallest:
        best, _, worst = (units.size(each.fault, each.share_of, size) for size in each.size[-1])
        sizes = [units.size(each.fault, each.share_of, size) for _, size, _ in each.size]
        row = "".join(f"{size:>14}" for size in sizes)
        told.append(f"  {_name(each.fault, each.share_of):24}{row}  ({best} to {worst})")
    modes = [*found.limits[0].rate]
    rates = "".join(f"{mode:>10}" for mode in modes)
    told += ["", "delay [s] likewise; nats a second by mode; told apart from all others after [s], or not from"]
    told.append(f"  {'fault and size':34}{'delay':>16}  {rates}  apart")
    for limit in found.limits:
        name = f"{_name(limit.fault, limit.share_of)} {units.size(limit.fault, limit.share_of, limit.size)}"
        delay = " ".join(_seconds(value) for value in limit.delay_s)
        rate = "".join(f"{BEYOND if value is None else format(value, '.3g'):>10}" for value in limit.rate.values())
        told.append(f"  {name:34}{delay:>16}  {rate}  {_apart(limit)}")
    return told


def _name(fault: str, share_of: str | None) -> str:
    return fault if share_of is None else f"{fault} ({share_of})"


def _seconds(value: float | None) -> str:
    return BEYOND if value is None else f"{value:.0f}"


def _apart(limit: Limit) -> str:
    alike = [fault for fault, value in limit.apart_s.items() if value is None]
    if alike:
        return f"not from {', '.join(alike)}"
    return f"{max((value for value in limit.apart_s.values() if value is not None), default=0.0):.0f}"
