"""The discrepancy campaign's results as a page: judged strictly, set B beside set A."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from discrepancy_cases import OUTSIDE, TRUTHS
from results_page import exact_share, provenance

from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS

Result = Mapping[str, Any]
Names = Sequence[str]

DECLARED: dict[str, dict[str, Any]] = json.loads(Path(__file__).with_name("discrepancy_declared.json").read_text())

GAP, CLOSED, FINAL = 1.5, 0.9, 1.1
"""Times the floor from which an error is a gap; the part of it to be closed; what may be left, times the floor."""

LONGEST_S = 60.0


def entries(r: Result) -> list[tuple[str, ...]]:
    """By effect, the entries that are right."""
    return [TRUTHS[name].entries for name in r["effects"] if name in TRUTHS]


def visible(r: Result) -> bool:
    """Whether recordings can show all effects, as was declared."""
    sizes = [(TRUTHS[name], size) for name, size in r["effects"].items()]
    return all(abs(truth.scale * size) >= DECLARED[truth.entry]["smallest"] for truth, size in sizes)


def spoke(r: Result) -> bool:
    """Whether something was given a name, or several."""
    return r["verdict"] in ("named", "one of")


def failed(r: Result) -> bool:
    """Whether there is no verdict, but what went wrong: silence of the program is no right answer."""
    return r["verdict"] not in ("nothing missing", "named", "one of", "unnamed", "fault")


def named_right(r: Result) -> bool:
    """Whether an entry of every effect is in a set that was named, each in another one."""
    orders = permutations(r["sets"], len(entries(r)))
    return spoke(r) and any(all(map(_has, sets, entries(r))) for sets in orders)


def wrong(r: Result) -> bool:
    """Whether a set was named without a truth in it, alone or beside others."""
    there = {n for name in r["effects"] if name in TRUTHS for n in (*TRUTHS[name].entries, *TRUTHS[name].besides)}
    nothing_right = r["kind"] != "two" and not named_right(r)  # of two, one may be too small
    return spoke(r) and (nothing_right or not all(_has(names, [*there]) for names in r["sets"]))


def unique(r: Result) -> bool:
    """Whether the truth stands alone, or with declared equivalents of it only, and nothing wrong beside it."""
    return named_right(r) and not wrong(r) and all(map(_equivalent, entries(r), _sets_of_truth(r)))


def _has(names: Names, others: Names) -> bool:
    return bool({*names} & {*others})


def _sets_of_truth(r: Result) -> list[Names]:
    """The set of each effect."""
    return [next(names for names in r["sets"] if _has(names, one)) for one in entries(r)]


def _equivalent(one: Names, names: Names) -> bool:
    return {*names} <= {*one, *(other for entry in one for other in DECLARED[entry]["alike"])}


def where(r: Result) -> set[str]:
    """The equations in which the effects act."""
    return {e for name in r["effects"] for e in (TRUTHS[name].equations if name in TRUTHS else OUTSIDE[name])}


@cache
def _changed(name: str) -> frozenset[str]:
    """The equations of the model that an entry changes."""
    model = load_model("uds")
    new = rewritten(model, load_library(SYSTEMS / "uds")[name]).equations
    return frozenset(e for e, equation in model.equations.items() if new[e].text != equation.text)


def told_where(r: Result) -> set[str]:
    """The equations that the user is told of: those of all candidates, or the located class where there are none."""
    names = [name for names in r["sets"] for name in names]
    return {e for name in names for e in _changed(name)} if spoke(r) else {*r["members"]}


def resolved(r: Result) -> bool:
    """Whether the proposed experiment left the right name alone."""
    asked = r.get("experiment", {})
    if not asked.get("proposed") or asked["verdict"] != "named":
        return False
    return unique({**r, "verdict": asked["verdict"], "sets": asked["sets"]})


Judged = tuple[int, int]


def _count(results: Iterable[Result], good: Callable[[Result], bool]) -> Judged:
    listed = [*results]
    return sum(map(good, listed)), len(listed)


def _regimes(results: Iterable[Result]) -> list[tuple[str, float, float, float]]:
    """Before, after and floor of every output and mode of the strong records; what is not added closes nothing."""
    return [
        (place, e["before"], e["after"] if spoke(r) and not r["refused"] else e["before"], e["floor"])
        for r in results
        for place, e in r.get("closure", {}).items()
    ]


def rows(results: Sequence[Result]) -> dict[str, Judged]:
    """Every count of the page by its title."""
    of = {kind: [r for r in results if r["kind"] == kind] for kind in ("hidden", "nothing", "outside", "two")}
    seen, pairs = [r for r in of["hidden"] if visible(r)], [r for r in of["two"] if visible(r)]
    several = [r for r in seen if r["verdict"] == "one of"]
    telling = [r for r in several if not unique(r)]
    located = [r for r in [*seen, *of["outside"]] if r["members"]]
    telling_where = [r for r in [*of["hidden"], *of["outside"]] if spoke(r) or r["members"]]
    strong = _regimes(seen)
    proposed = [r for r in several if r["experiment"]["proposed"]]
    gaps = [(b - a) / (b - f) for _, b, a, f in strong if b > GAP * f]
    return {
        "hidden and visible: truth in the named set": _count(seen, named_right),
        "... and it alone, or with declared equivalents": _count(seen, unique),
        "hidden, any size: a wrong set named, alone or besides": _count(of["hidden"], wrong),
        "hidden and visible: called a fault that set in": _count(seen, lambda r: r["verdict"] == "fault"),
        "any: ended with an error, no verdict": _count(results, failed),
        "nothing hidden: something named": _count(of["nothing"], spoke),
        "nothing hidden: said that something is missing, or a fault": _count(
            of["nothing"], lambda r: r["verdict"] in ("unnamed", "fault")
        ),
        "in no library: not given a name": _count(of["outside"], lambda r: not spoke(r) and not failed(r)),
        "in no library: noticed": _count(of["outside"], lambda r: r["verdict"] in ("unnamed", "fault") or spoke(r)),
        "located without any library: the right equation in the class": _count(
            located, lambda r: bool({*r["members"]} & where(r))
        ),
        "... and it is the first one": _count(located, lambda r: r["members"][0] in where(r)),
        "told to the user: the right equation, of the names' or in the located class": _count(
            telling_where, lambda r: bool(told_where(r) & where(r))
        ),
        "two hidden, both visible: both found": _count(pairs, named_right),
        "two hidden, both visible: at least one found": _count(
            pairs, lambda r: spoke(r) and any(_has(names, one) for names in r["sets"] for one in entries(r))
        ),
        "two hidden, any size: a wrong set named": _count(of["two"], wrong),
        "one of several: the experiment resolves it": _count(several, resolved),
        "... of those that are not all equivalent": _count(telling, resolved),
        "... where an experiment was proposed": _count(proposed, resolved),
        f"strong, gap above {GAP:g} times the floor: at least {100 * CLOSED:.0f} % of it closed": (
            sum(part >= CLOSED for part in gaps),
            len(gaps),
        ),
        f"strong: final error at most {FINAL:g} times the floor": (
            sum(a <= FINAL * f for _, _, a, f in strong),
            len(strong),
        ),
        "strong and named: refused by --apply": _count(
            (r for r in seen if "closure" in r and spoke(r)), lambda r: bool(r["refused"])
        ),
        f"a record within {LONGEST_S:.0f} s of two cores": _count(results, lambda r: r["cpu_s"] <= 2 * LONGEST_S),
    }


MARKS = {
    "hidden and visible: truth in the named set": "at least 95 %",
    "... and it alone, or with declared equivalents": "at least 85 %",
    "hidden, any size: a wrong set named, alone or besides": "at most 2 %",
    "any: ended with an error, no verdict": "none",
    "nothing hidden: something named": "at most 1 %",
    "in no library: not given a name": "at least 90 %",
    "located without any library: the right equation in the class": "at least 90 %",
    "told to the user: the right equation, of the names' or in the located class": "at least 90 %",
    "two hidden, both visible: both found": "at least 60 %",
    "two hidden, both visible: at least one found": "at least 90 %",
    "one of several: the experiment resolves it": "at least 80 %",
    f"strong, gap above {GAP:g} times the floor: at least {100 * CLOSED:.0f} % of it closed": "all",
    f"strong: final error at most {FINAL:g} times the floor": "all",
    f"a record within {LONGEST_S:.0f} s of two cores": "all",
}

HEAD = (
    "# Discrepancy workflow: hidden effects found, named and added\n"
    "\n"
    "Every record (`tests/campaigns/discrepancy.py`) is a simulated truck of its own, profile `ideal` and what is "
    "hidden: 480 s of the training cycle to fit, 480 s of the validation cycle held out, searched with the four-state "
    "model's datasheet values and the shipped library. The workflow was developed on effect set A (13 effects); set B "
    "(11 others) was first run once, after a commit that had frozen the code (5c99009: 91 of its 92 visible effects "
    "named). Here both sets are made again by later code; nothing in it was chosen on set B. Nothing changes "
    "between the two recordings of a truck here, and that is said (`--same-conditions`): without it each has zero "
    "errors, viscosity and tank pressure of its own, as far as the model says that they drift, and a weak laminar "
    "filter is taken for such a drift (122 records of 2801471 named 51 of 55 visible effects). *Visible* are "
    "effects above the smallest size that such recordings can show, *equivalents* what looks the same in them, both "
    "declared beforehand from sensitivities (`tests/campaigns/discrepancy_declared.json`). A named set without a truth "
    "in it is wrong, also beside a right one. What is not named, or refused by `--apply`, closes nothing. How it is "
    "counted was changed in five places after set B had been seen (`docs/decisions/008-evidence-not-rmse.md`). In "
    "brackets: exact 95 % intervals (Clopper and Pearson)."
)


def page(by_set: Mapping[str, Sequence[Result]], ablations: str = "") -> str:
    """The page of the results of effect sets, by the set's name."""
    judged = {name: rows(results) for name, results in by_set.items()}
    every = [r for results in by_set.values() for r in results]
    table = [
        f"| | mark | {' | '.join(f'set {name}' for name in by_set)} | all |",
        f"|---|---|{'---|' * (len(by_set) + 1)}",
    ]
    for title, found in rows(every).items():
        cells = [exact_share(*judged[name][title]) for name in by_set]
        table.append(f"| {title} | {MARKS.get(title, '')} | {' | '.join(cells)} | {exact_share(*found)} |")
    sizes = [f"{name} {_mean_size(results):.2f}" for name, results in by_set.items()]
    widths = [f"{name} {_mean_class(results):.1f}" for name, results in by_set.items()]
    parts = [
        HEAD,
        "\n".join(table),
        f"Mean size of the truth's sets, visible effects: {', '.join(sizes)} (at most 1.8). Mean size of the located "
        f"class, of 18 equations: {', '.join(widths)}.",
        *(f"## Set {name}, effect by effect\n\n{_by_effect(results)}" for name, results in by_set.items()),
        *(f"## Set {name}, gaps\n\n{_closures(results)}" for name, results in by_set.items()),
        *(f"## Set {name}, those that were not as they should be\n\n{_failures(r)}" for name, r in by_set.items()),
        ablations,
        "State of the code (`FROZEN` in the campaign), by set: " + "; ".join(map(_code, by_set, by_set.values())) + ".",
        provenance(", ".join(dict.fromkeys(r["commit"] for r in every)), sum(r["seconds"] for r in every)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _code(name: str, results: Sequence[Result]) -> str:
    codes = [*dict.fromkeys(r["code"] for r in results)]
    return f"{name} {codes[0]}" if len(codes) == 1 else f"**{name} not by one: {', '.join(codes)}**"


def _mean_size(results: Sequence[Result]) -> float:
    seen = [r for r in results if r["kind"] == "hidden" and visible(r) and named_right(r)]
    return _mean([len(names) for r in seen for names in _sets_of_truth(r)])


def _mean_class(results: Sequence[Result]) -> float:
    return _mean([len(r["members"]) for r in results if r["members"] and r["kind"] in ("hidden", "outside")])


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _by_effect(results: Sequence[Result]) -> str:
    lines = [
        "| effect | records | visible | truth in set | alone or equivalents | wrong set | mean size of its set |",
        "|---|---|---|---|---|---|---|",
    ]
    hidden = [r for r in results if r["kind"] == "hidden"]
    for name in dict.fromkeys(effect for r in hidden for effect in r["effects"]):
        those = [r for r in hidden if name in r["effects"]]
        seen = [r for r in those if visible(r)]
        size = _mean([len(names) for r in seen if named_right(r) for names in _sets_of_truth(r)])
        counts = [len(those), len(seen), sum(map(named_right, seen)), sum(map(unique, seen)), sum(map(wrong, those))]
        lines.append(f"| {name} | {' | '.join(map(str, counts))} | {size:.1f} |")
    return "\n".join(lines)


def _closures(results: Sequence[Result]) -> str:
    """By output and mode."""
    lines = [
        f"| output, mode | gaps | closed, median | at least {100 * CLOSED:.0f} % | records | final over floor, median "
        f"| at most {FINAL:g} |",
        "|---|---|---|---|---|---|---|",
    ]
    found = _regimes(r for r in results if r["kind"] == "hidden" and visible(r))
    for place in dict.fromkeys(place for place, *_ in found):
        those = [(b, a, f) for name, b, a, f in found if name == place]
        closed = [(b - a) / (b - f) for b, a, f in those if b > GAP * f]
        final = np.array([a / f for _, a, f in those])
        middle = f"{100 * np.median(closed):.0f} %" if closed else "-"
        lines.append(
            f"| {place} | {len(closed)} | {middle} | {sum(part >= CLOSED for part in closed)} | {len(those)} | "
            f"{np.median(final):.2f} | {int(np.sum(final <= FINAL))} |"
        )
    return "\n".join(lines)


def _failures(results: Sequence[Result]) -> str:
    bad = [
        r
        for r in results
        if failed(r)
        or (r["kind"] == "hidden" and (wrong(r) or (visible(r) and not unique(r))))
        or (r["kind"] == "nothing" and r["verdict"] != "nothing missing")
        or (r["kind"] == "outside" and spoke(r))
        or (r["kind"] == "two" and (wrong(r) or (visible(r) and not named_right(r))))
    ]
    return "\n".join(_told(r) for r in bad) or "None."


def _told(r: Result) -> str:
    sets = "; ".join("{" + ", ".join(names) + "}" for names in r["sets"])
    asked = r.get("experiment", {}).get("proposed")
    then = f"; with {asked}: {r['experiment']['verdict']} {r['experiment']['sets']}" if asked else ""
    return f"- {r['case']}: {r['verdict']} {sets} (gain {r['gain']:.0f}, left {r['remainder']:.0f} nats){then}"
