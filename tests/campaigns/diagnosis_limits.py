"""What was reached beside what the limit allows (`diagnosis_limit`): small faults, delays, names, sizes."""

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from diagnosis_goals import APART, detected, early, share, singles
from diagnosis_judged import LOOKS_S, Judged
from results_page import exact_share

Limits = Mapping[int, Mapping[str, Mapping[str, Mapping[str, Any]]]]
"""By vehicle, fault and size in words: what `diagnosis_limit.limit_of` found."""

DETECTABLE = 0.5
"""The limit calls a fault detectable that it finds in time after so many of the onsets."""
SETTLED_S = max(LOOKS_S)
"""By this look after the first diagnosis a window has settled."""


def beside_the_limit(told: Sequence[Judged], limits: Limits) -> list[str]:
    """The tables: what was wanted of small faults, and every fault with its limit."""
    small = singles(told, "small") + [one for one in singles(told, "small", only=APART) if one.changes]
    possible = [one for one in small if _of(one, limits)["within"] >= DETECTABLE]
    settled = [one for one in possible if one.first(SETTLED_S)]
    names = [len(one.first(SETTLED_S)) for one in settled]
    limit = [1 + len(_of(one, limits)["others"]) for one in settled]
    ratio = f"{statistics.fmean(names):.2f} to {statistics.fmean(limit):.2f}" if names else "-"
    pairs = detected([one for one in told if one.kind == "pair"])
    covered, asked = coverage(told)
    lines = [
        "| | wanted | measured |",
        "|---|---|---|",
        f"| small, detectable by the limit: in 300 s of exciting operation | >= 85 % | {share(possible, early)} |",
        f"| small, all but a pump filter that changes nothing: the same | >= 75 % | {share(small, early)} |",
        f"| settled diagnosis: mean number of names, to what the limit leaves | <= 1.2 times | {ratio} |",
        f"| pairs: the true one in the settled diagnosis | >= 75 % | {share(pairs, _settled)} |",
        f"| single faults: the 95 % interval of the size has it | 90 to 98 % | {exact_share(covered, asked)} |",
    ]
    return [*lines, "", *_by_fault(small, limits)]


def _of(one: Judged, limits: Limits) -> Mapping[str, Any]:
    return limits[one.vehicle][one.faults[0]][one.label]


def _settled(one: Judged) -> bool:
    return one.holds(SETTLED_S)


def _by_fault(small: Sequence[Judged], limits: Limits) -> list[str]:
    rows = [
        "| small fault | recordings | detectable | detected in time | median delay [s] | limit [s] | ratio (<= 2) |",
        "|---|---|---|---|---|---|---|",
    ]
    for fault in dict.fromkeys(one.faults[0] for one in small):
        own = [one for one in small if one.faults[0] == fault]
        possible = sum(_of(one, limits)["within"] >= DETECTABLE for one in own)
        both = [
            (one.delay_s, _of(one, limits)["delay_s"])
            for one in own
            if one.delay_s is not None and _of(one, limits)["delay_s"] is not None
        ]
        cells = ["-", "-", "-"]
        if both:
            delay, limit = (statistics.median(column) for column in zip(*both, strict=True))
            cells = [f"{delay:.0f}", f"{limit:.0f}", f"{delay / limit:.1f}"]
        rows.append(f"| {fault} | {len(own)} | {possible} | {share(own, early)} | {' | '.join(cells)} |")
    return rows


def coverage(told: Sequence[Judged]) -> tuple[int, int]:
    """How many intervals of settled sizes have the true one, of how many; of faults that the rig has in those units."""
    covered = asked = 0
    for one in told:
        if one.kind not in ("single", "curve") or one.faults[0] == "leak_ap":
            continue
        for name, _, _, _, sizes in one.standing.get(SETTLED_S, []):
            if name == one.faults[0] and sizes:
                low, high, unit = sizes[0]
                if (true := IN_UNIT.get(unit)) is not None:
                    asked += 1
                    covered += low <= true * one.sizes[0] * (1.0 if one.faults[0].startswith("fy_") else -1.0) <= high
    return covered, asked


IN_UNIT = {"%": 100.0, "bar": 1e-5, "mbar": 1e-2}
"""The rig's unit, a fraction or Pa, in those that sizes are told in."""
