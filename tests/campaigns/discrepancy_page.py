"""The discrepancy campaign's results as a page."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import permutations
from typing import Any

import numpy as np
from discrepancy_cases import TRUTHS
from results_page import exact_share, provenance

Result = Mapping[str, Any]


def named_right(r: Result) -> bool:
    """Whether an entry of every effect is in a set that was named, each in another one."""
    orders = permutations(r["sets"], len(r["right"]))
    return r["verdict"] in ("named", "one of") and any(all(map(_has, sets, r["right"])) for sets in orders)


def _has(names: Sequence[str], entries: Sequence[str]) -> bool:
    return bool({*names} & {*entries})


def unique(r: Result) -> bool:
    """Whether the truth stands alone, or with declared equivalents of it only."""
    return named_right(r) and _alone(r, r["sets"])


def _alone(r: Result, sets: Sequence[Sequence[str]]) -> bool:
    [entries], [alike] = r["right"], r["alike"]
    return all({*names} <= {*entries, *alike} for names in sets if _has(names, entries))


def wrong(r: Result) -> bool:
    """Whether a set was named without the truth in it."""
    return r["verdict"] in ("named", "one of") and not named_right(r)


def besides(r: Result) -> bool:
    """Whether a further effect was named that is not there."""
    there = {name for effect in r["effects"] for name in (*TRUTHS[effect].entries, *TRUTHS[effect].besides)}
    return (
        r["verdict"] in ("named", "one of") and named_right(r) and not all(_has(names, [*there]) for names in r["sets"])
    )


def said(r: Result) -> set[str]:
    """The equations in which something is missing: those that what was named changes, or the class that was located."""
    return set(r["changed"] if r["verdict"] in ("named", "one of") else r["members"])


def page(results: Sequence[Result], set_name: str, seconds: float) -> str:
    """The page; `seconds` is what this run of the campaign took."""
    of = {kind: [r for r in results if r["kind"] == kind] for kind in ("hidden", "nothing", "outside", "two")}
    seen = [r for r in of["hidden"] if all(r["visible"].values())]
    spoke = [r for r in seen if r["sets"]]
    codes = [*dict.fromkeys(r["code"] for r in results)]
    speaking = [r for r in [*of["hidden"], *of["outside"]] if said(r)]
    lines = [
        f"# Discrepancy workflow, the rig's effect set {set_name}",
        "",
        f"{len(results)} records (`tests/campaigns/discrepancy.py`): each a truck of its own of profile `ideal`, 480 s "
        "of the training cycle to fit and 480 s of the validation cycle held out, searched with the four-state model's "
        "datasheet values and the shipped library. All data are simulated. *Visible* are effects above the smallest "
        "size that the recordings could show, as the sensitivities declare it before anything is searched. In "
        "brackets: exact 95 % intervals (Clopper, Pearson).",
        "",
        "| | share | mark |",
        "|---|---|---|",
        _row("hidden and visible: truth inside the named set", sum(map(named_right, seen)), len(seen), "at least 95 %"),
        _row("... and it alone, or with declared equivalents", sum(map(unique, seen)), len(seen), "at least 85 %"),
        _row("hidden: a wrong set named", sum(map(wrong, of["hidden"])), len(of["hidden"]), "at most 2 %"),
        _row(
            "hidden: right, and a further effect that is not there", sum(map(besides, of["hidden"])), len(of["hidden"])
        ),
        _row(
            "nothing hidden: something named",
            sum(r["verdict"] in ("named", "one of") for r in of["nothing"]),
            len(of["nothing"]),
            "at most 1 %",
        ),
        _row(
            "nothing hidden: something unnamed missing",
            sum(r["verdict"] == "unnamed" for r in of["nothing"]),
            len(of["nothing"]),
        ),
        _row(
            "in no library: left unnamed",
            sum(r["verdict"] in ("unnamed", "nothing missing") for r in of["outside"]),
            len(of["outside"]),
            "at least 90 %",
        ),
        _row(
            "the right equation in the class, when it speaks",
            sum(bool(said(r) & set(r["where"])) for r in speaking),
            len(speaking),
            "at least 90 %",
        ),
        _row("two hidden: both found", sum(map(named_right, of["two"])), len(of["two"]), "at least 60 %"),
        _row("two hidden: at least one found", sum(_one(r) for r in of["two"]), len(of["two"]), "at least 90 %"),
        _row("one of several, not all equivalent: the experiment resolves it", *_experiments(seen), "at least 80 %"),
        "",
        f"Mean size of the named sets: {_mean([len(names) for r in spoke for names in r['sets']]):.2f} (at most 1.8). "
        f"CPU time a record: median {np.median([r['cpu_s'] for r in results]):.0f} s, longest "
        f"{max(r['cpu_s'] for r in results):.0f} s.",
        "",
        *_by_effect(of["hidden"]),
        "",
        *_closures(of["hidden"]),
        "",
        *_failures([*seen, *of["outside"], *of["two"], *of["nothing"]]),
        f"Searched and recorded by one state of the code, {codes[0]}."
        if len(codes) == 1
        else f"**Not by one state of the code**: {', '.join(codes)}.",
        "",
        provenance(", ".join(dict.fromkeys(r["commit"] for r in results)), seconds),
        "",
    ]
    return "\n".join(lines)


def _row(title: str, found: int, of: int, mark: str = "") -> str:
    return f"| {title} | {exact_share(found, of)} | {mark} |"


def _one(r: Result) -> bool:
    return any(_has(names, entries) for entries in r["right"] for names in r["sets"])


def _experiments(hidden: Iterable[Result]) -> tuple[int, int]:
    """Of those that needed one, in how many an experiment told the truth from all that are not its equivalents."""
    asked = [r for r in hidden if r["verdict"] == "one of" and named_right(r) and not unique(r)]
    return sum(_resolved(r) for r in asked), len(asked)


def _resolved(r: Result) -> bool:
    sets = r["experiment"].get("sets", [])
    return any(_has(names, r["right"][0]) for names in sets) and _alone(r, sets)


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _by_effect(hidden: Sequence[Result]) -> list[str]:
    lines = [
        "| effect | records | visible | truth in set | alone | wrong set | named sets, mean size |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(effect for r in hidden for effect in r["effects"]):
        those = [r for r in hidden if name in r["effects"]]
        seen = [r for r in those if all(r["visible"].values())]
        size = _mean([len(names) for r in seen for names in r["sets"]])
        lines.append(
            f"| {name} | {len(those)} | {len(seen)} | {sum(map(named_right, seen))} | {sum(map(unique, seen))} | "
            f"{sum(map(wrong, those))} | {size:.1f} |"
        )
    return lines


def _closures(hidden: Sequence[Result]) -> list[str]:
    """Of the closable gap, per output and mode, at strong size: RMS errors are squared to take the floor out."""
    found: dict[str, list[tuple[float, float]]] = {}
    for r in hidden:
        for where, e in r.get("closure", {}).items():
            if e["before"] > 1.5 * e["floor"]:
                closed = (e["before"] - e["after"]) / (e["before"] - e["floor"])
                found.setdefault(where, []).append((closed, e["after"] / e["floor"]))
    lines = [
        "Closure of the closable gap on the held-out recording (where the error was above 1.5 times the floor, the "
        "same truck recorded without the effect):",
        "",
        "| output, mode | records | closed, median | at least 90 % | final error over the floor, median "
        "| at most 1.1 |",
        "|---|---|---|---|---|---|",
    ]
    for where, pairs in found.items():
        closed, final = np.array(pairs).T
        lines.append(
            f"| {where} | {len(pairs)} | {100 * np.median(closed):.0f} % | {int(np.sum(closed >= 0.9))} | "
            f"{np.median(final):.2f} | {int(np.sum(final <= 1.1))} |"
        )
    return lines if found else []


def _failures(results: Sequence[Result]) -> list[str]:
    bad = [
        r
        for r in results
        if (r["kind"] == "hidden" and not unique(r))
        or (r["kind"] == "nothing" and r["verdict"] != "nothing missing")
        or (r["kind"] == "outside" and r["verdict"] in ("named", "one of"))
        or (r["kind"] == "two" and not named_right(r))
    ]
    lines = ["Those that were not as they should be:", ""]
    for r in bad:
        sets = "; ".join("{" + ", ".join(names) + "}" for names in r["sets"])
        lines.append(f"- {r['case']}: {r['verdict']} {sets} (gain {r['gain']:.0f}, left {r['remainder']:.0f} nats)")
    return [*lines, ""] if bad else []
