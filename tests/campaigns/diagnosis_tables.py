"""The tables of the diagnosis page: one a question."""

import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise

from diagnosis_goals import APART, Hours, Mates, detected, early, mean_size, median, share, singles
from diagnosis_judged import EXCITED_S, LOOKS_S, Judged
from diagnosis_mates import beside, narrow
from results_page import exact_rate, exact_share

ALL = "**all but fA_p and the leak**"


def _table(columns: str, rows: Sequence[str]) -> list[str]:
    count = columns.count("|") - 1
    return [columns, "|" + "---|" * count, *rows]


def by_fault(told: Sequence[Judged], of_others: Mates) -> list[str]:
    """What was told of every fault, small and large."""
    columns = (
        f"| fault | size | detected | within {EXCITED_S:.0f} s exciting | median delay [s] | exciting [s] | "
        "in the diagnosis | alone or with mates | mean size | wrong alone |"
    )
    cells = dict.fromkeys((one.faults[0], one.label) for one in told if one.kind == "single")
    groups = [(fault, label, singles(told, label, only=[fault])) for fault, label in cells]
    groups += [(ALL, label, singles(told, label)) for label in ("small", "large")]
    rows = []
    for fault, label, those in groups:
        seen = detected(those)
        cell = [
            fault,
            label,
            share(those, lambda one: one.detected),
            share(those, early),
            median([one.delay_s for one in those]),
            median([one.excited_s for one in those]),
            share(seen, Judged.holds),
            share(seen, lambda one: narrow(one, of_others)),
            mean_size(those),
            str(sum(one.wrong_alone() for one in seen)),
        ]
        rows.append("| " + " | ".join(cell) + " |")
    return _table(columns, rows)


def by_look(told: Sequence[Judged]) -> list[str]:
    """How the diagnosis develops after the first one."""
    rows = []
    for label in ("small", "large"):
        for look in LOOKS_S:
            those = [one for one in singles(told, label) if look in one.standing]
            sizes = [len(one.first(look)) for one in those if one.first(look)]
            mean = f"{sum(sizes) / len(sizes):.2f}" if sizes else "-"
            top = [one.standing[look][0][0] == one.faults[0] for one in those if one.standing[look]]
            rows.append(
                f"| {label} | {look:.0f} | {share(those, lambda one, look=look: one.holds(look))} | {mean} | "  # type: ignore[misc]
                f"{sum(top)} of {len(top)} | {sum(one.wrong_alone(look) for one in those)} |"
            )
    return _table("| size | after [s] | in the diagnosis | mean size | told first | wrong alone |", rows)


def curve(told: Sequence[Judged]) -> list[str]:
    """Detection over size, in parts of the large one."""
    numbers = {one.vehicle for one in told if one.kind == "curve"}
    those = [one for one in told if one.kind == "curve" or (one.label == "large" and one.vehicle in numbers)]
    those = [one for one in those if one.kind != "pair"]
    parts = sorted({_part(one) for one in those})
    rows = []
    for fault in dict.fromkeys(one.faults[0] for one in those):
        cells = []
        for part in parts:
            at = [one for one in those if one.faults[0] == fault and _part(one) == part]
            seen, held = sum(one.detected for one in at), sum(one.holds() for one in detected(at))
            delay = median([one.delay_s for one in at])
            cells.append(f"{seen} of {len(at)}, {held} in, {delay} s" if at else "-")
        rows.append(f"| {fault} | " + " | ".join(cells) + " |")
    return _table("| fault | " + " | ".join(f"{part:g} x large" for part in parts) + " |", rows)


def smallest(told: Sequence[Judged]) -> list[str]:
    """The smallest size of each fault from which on all recordings were detected, of the sizes that were driven."""
    columns = "| fault | sizes driven | all detected from | recordings of that size and above |"
    those = [one for one in told if one.kind in ("single", "curve") and one.changes]
    rows = []
    for fault in dict.fromkeys(one.faults[0] for one in those):
        by_size: dict[float, list[bool]] = {}
        for one in those:
            if one.faults[0] == fault:
                by_size.setdefault(float(f"{one.sizes[0]:.4g}"), []).append(one.detected)
        grid = sorted(by_size)
        size = _all_from(by_size)
        if size is None:
            missed = by_size[grid[-1]]
            cells = f"above the grid (> {grid[-1]:g}) | {sum(missed)} of {len(missed)} detected at {grid[-1]:g}"
        else:
            found = f"below the grid (<= {size:g})" if size == grid[0] else f"{size:g}"
            cells = f"{found} | {sum(len(seen) for at, seen in by_size.items() if at >= size)}"
        rows.append(f"| {fault} | {', '.join(f'{at:g}' for at in grid)} | {cells} |")
    return _table(columns, rows)


def _all_from(by_size: Mapping[float, Sequence[bool]]) -> float | None:
    """The smallest size at which, and above which, all were detected; None: not all of the largest were."""
    found = None
    for size in sorted(by_size, reverse=True):
        if not all(by_size[size]):
            break
        found = size
    return found


def _part(one: Judged) -> float:
    return float(one.label) if one.kind == "curve" else 1.0


def pairs(told: Sequence[Judged]) -> list[str]:
    """Two faults at once, each pair on one vehicle."""
    rows = []
    for one in told:
        if one.kind == "pair":
            said = "; ".join(one.first()) or ("healed" if one.detected else "nothing")
            delay = "-" if one.delay_s is None else f"{one.delay_s:.0f}"
            rows.append(f"| {' + '.join(one.faults)} | {delay} | {said} | {'yes' if one.holds() else 'no'} |")
    return _table("| pair | delay [s] | rank 1 after 120 s | true pair in |", rows)


def isolability(told: Sequence[Judged]) -> list[str]:
    """Which faults stand together at rank 1, over all vehicles."""
    rows = []
    for (fault, label), (count, others) in beside(told).items():
        said = ", ".join(f"{name} {times}" for name, times in others.most_common()) or "none"
        rows.append(f"| {fault} | {label} | {count} | {said} |")
    return _table("| fault | size | in the diagnosis | beside it, how often |", rows)


def alarms(free: Hours) -> list[str]:
    """Alarms of single tests without a fault."""
    rows = [f"| {test} | {exact_rate(count, free.hours)} |" for test, count in sorted(free.alarms.items())]
    return _table("| test | alarms without a fault |", rows)


def by_effect(told: Sequence[Judged], effects: Mapping[int, Sequence[str]]) -> list[str]:
    """What hidden effects cost: by effect, over the vehicles that have it."""
    rows = []
    for name in sorted({name for names in effects.values() for name in names}):
        those = [one for one in told if name in effects[one.vehicle]]
        false = Counter(said for one in those for names in one.false for said in names)
        hours = sum(one.free_s for one in those) / 3600
        small, large = singles(those, "small"), singles(those, "large")
        count = sum(len(one.false) for one in those)
        rows.append(
            f"| {name} | {len({one.vehicle for one in those})} | {exact_rate(count, hours)} | "
            f"{', '.join(false) or '-'} | {share(small, lambda one: one.detected)} | "
            f"{share(detected(small), Judged.holds)} | {share(detected(large), Judged.holds)} |"
        )
    columns = "| effect | vehicles | told without a fault | which | small: detected | small: in | large: in |"
    return _table(columns, rows)


BINS = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 0.99, 1.0)


def calibration(told: Sequence[Judged]) -> list[str]:
    """How often what was given a probability was there, over all looks at single faults that the model knows."""
    looks = [
        (p, name == one.faults[0])
        for one in told
        if one.kind in ("single", "curve") and one.faults[0] not in APART
        for said in one.standing.values()
        for name, _, p, *_ in said
        if p is not None
    ]
    rows = ["| p told | mean | true |", "|---|---|---|"]
    for low, high in pairwise(BINS):
        inside = [(p, true) for p, true in looks if low <= p < high or (p == high == 1.0)]
        if inside:
            mean = statistics.fmean(p for p, _ in inside)
            rows.append(f"| {low:g} to {high:g} | {mean:.2f} | {exact_share(sum(t for _, t in inside), len(inside))} |")
    if looks:
        rows += ["", f"Expected calibration error: {calibration_error(looks):.3f} over {len(looks)} probabilities."]
    return rows


def calibration_error(looks: Sequence[tuple[float, bool]]) -> float:
    """The mean distance of probabilities told from how often they were true, by bins of 0.1 (Naeini and others, 2015).

    >>> round(calibration_error([(0.95, True)] * 19 + [(0.95, False)] + [(0.05, True)]), 6)
    0.045238
    """
    bins: dict[int, list[tuple[float, bool]]] = {}
    for p, true in looks:
        bins.setdefault(min(int(10.0 * p), 9), []).append((p, true))
    off = [abs(sum(p for p, _ in inside) - sum(true for _, true in inside)) for inside in bins.values()]
    return sum(off) / len(looks)
