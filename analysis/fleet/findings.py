"""What the drives of a fleet say of its vehicles: which component, since when, how sure, in how many drives.

A finding is what the likeliest explanation of a drive names. It stands where the vehicle's last drive with a verdict
has it too. A drive without a verdict (open, failed) neither confirms nor ends one: silence is no all-clear.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from itertools import groupby
from typing import Any, NamedTuple

UNKNOWN = "unknown"
"""Where the likeliest explanation names no component."""

Row = Mapping[str, Any]


class Finding(NamedTuple):
    """A component, or several together, of a vehicle.

    `first` and `last` are the starts of its first and its last drive, `number` how many have it of the `of` drives with
    a verdict since the first. `p` and `size` are those of the last one, `others` what else explains it.
    """

    vehicle: str
    components: str
    stands: bool
    first: datetime | None
    last: datetime | None
    number: int
    of: int
    p: float | None
    size: str
    others: str


class Fleet(NamedTuple):
    """The findings of all vehicles, those that stand first; drives by verdict; vehicles without a verdict, and why.

    `simulated` drives are of no vehicle.
    """

    vehicles: int
    hours: float
    verdicts: Counter[str]
    findings: list[Finding]
    silent: dict[str, str]
    simulated: int

    @property
    def standing(self) -> list[Finding]:
        """Those that stand."""
        return [each for each in self.findings if each.stands]

    @property
    def past(self) -> list[Finding]:
        """Return the findings that the vehicle's last drive with a verdict does not have."""
        return [each for each in self.findings if not each.stands]

    @property
    def by_component(self) -> Counter[str]:
        """Vehicles by what stands."""
        return Counter(each.components for each in self.standing)


def fleet_of(rows: Iterable[Row]) -> Fleet:
    """Return what the rows of `drives` say, which come by vehicle and time."""
    findings: list[Finding] = []
    verdicts: Counter[str] = Counter()
    silent: dict[str, str] = {}
    vehicles, span_s, simulated = 0, 0.0, 0
    for vehicle, drives in groupby(rows, key=lambda row: str(row["vehicle"])):
        own = list(drives)
        vehicles += 1
        span_s += sum(row["span_s"] or 0.0 for row in own)
        simulated += sum(bool(row["simulated"]) for row in own)
        verdicts.update(row["verdict"] for row in own)
        told = [row for row in own if row["verdict"] in ("fault", "no fault")]
        if not told:
            silent[vehicle] = own[-1]["reason"]
        findings += _findings(vehicle, told)
    findings.sort(key=lambda each: (not each.stands, -(each.p or 0.0), each.vehicle))
    return Fleet(vehicles, span_s / 3600.0, verdicts, findings, silent, simulated)


def _findings(vehicle: str, drives: Sequence[Row]) -> list[Finding]:
    found = []
    names = [_components(row["diagnoses"]) for row in drives]
    for components in dict.fromkeys(name for name in names if name is not None):
        having = [k for k, name in enumerate(names) if name == components]
        last = drives[having[-1]]
        best, *others = _by_rank(last["diagnoses"])
        found.append(
            Finding(
                vehicle=vehicle,
                components=components,
                stands=having[-1] == len(drives) - 1,
                first=drives[having[0]]["start"],
                last=last["start"],
                number=len(having),
                of=len(drives) - having[0],
                p=best["p"],
                size=_size(best),
                others=", ".join(dict.fromkeys(_name(each) for each in others if _name(each) != components)),
            )
        )
    return found


def _by_rank(diagnoses: Sequence[Row]) -> list[Row]:
    return sorted(diagnoses, key=lambda each: (each["rank"], -(each["p"] or 0.0)))


def _components(diagnoses: Sequence[Row]) -> str | None:
    return _name(_by_rank(diagnoses)[0]) if diagnoses else None


def _name(diagnosis: Row) -> str:
    return " and ".join(diagnosis["components"]) or UNKNOWN


def _size(diagnosis: Row) -> str:
    """The interval of its size; nothing where none is known."""
    if not diagnosis["sizes"]:
        return ""
    size = diagnosis["sizes"][0]
    of = f" of {size['of']}" if size["of"] else ""
    return f"{size['low']:.3g} to {size['high']:.3g} {size['unit']}{of}"
