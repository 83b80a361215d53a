"""The page of `hybrid.py`: what each method detects and names, and how often networks alarm at what they decouple."""

from collections.abc import Sequence
from statistics import median
from typing import Any, NamedTuple

from diagnosis_judged import Judged, judged
from results_page import exact_rate, exact_share, provenance

from faultline.analysis.model import load_model
from faultline.analysis.structure import Test, find_tests

Record = dict[str, Any]

METHODS = {
    "equations": "equations",
    "networks": "networks alone",
    "structure": "from structure alone",
    "both": "both",
}
SIZES = ("large", "severe")
LEAKS_AT = "e10"
"""The equation near which a leak is to be found: no component of the model leaks."""
LOOK_S = 120.0

HEAD = """# Networks as a diagnosis system

All data are **simulated** by the rig. Made by `make campaign-hybrid`; vehicles, sizes and what counts are declared in
`tests/campaigns/hybrid.py`. The same vehicles, drives and faults by four bundles: calibrated equations; networks alone,
trained with what the equations know; networks from structure alone, trained on a recording that excites besides; and
equations and networks in one bundle. *In the set*: two minutes after the first diagnosis the true component is among
the explanations of rank 1, alone or in a pair. *Allowed*: the faults that hit all tests which alarmed since the onset,
until the recording's end; tests that decouple the fault, and alarm at last, rule out the truth. Cases in which a
clogged pump filter changes nothing that is measured are left out. Intervals of 95 % are exact.
"""


WRONG = (
    "`calibrate` doubted that the equations describe the vehicle (an effect that they lack, or a day), and was forced."
)


class Told(NamedTuple):
    """A judged recording of a method, and the tests that alarmed since the onset."""

    one: Judged
    alarmed: list[str]
    suspicions: int


def sensitive() -> dict[str, frozenset[str]]:
    """The faults that each test of the model is sensitive to, the leak among them."""
    tests = [test for test in find_tests(load_model("uds")) if isinstance(test, Test)]
    leak = {test.name: {"leak_ap"} if LEAKS_AT in test.equations else set() for test in tests}
    return {test.name: frozenset(test.faults) | leak[test.name] for test in tests}


def in_set(one: Judged) -> bool:
    """Whether the truth is of rank 1 at the look."""
    if one.faults == ("leak_ap",):
        return one.located(LEAKS_AT, LOOK_S)
    return one.faults[0] in one.named(LOOK_S)


def allowed(alarmed: Sequence[str], signature: dict[str, frozenset[str]]) -> int:
    """How many single faults hit every test that alarmed."""
    return len(frozenset.intersection(*(signature[test] for test in alarmed))) if alarmed else 0


def read(records: Sequence[Record]) -> dict[str, list[Told]]:
    """The judged recordings of each method."""
    told: dict[str, list[Told]] = {method: [] for method in METHODS}
    for record in records:
        for row in record["judged"]:
            if row["changes"]:
                onset = row["onset_s"] or row["seconds"]
                suspected = sum(how == "suspected" and t < onset for t, _, how, _ in row["events"])
                told[row["method"]].append(Told(judged(record["vehicle"], row), row["alarmed"], suspected))
    return told


def shares(told: dict[str, list[Told]]) -> list[tuple[str, list[str]]]:
    """What matters of all faults together, by method."""
    faulty = {method: [each for each in of if each.one.faults] for method, of in told.items()}
    rows = (("detected", _detected), ("in the set", _in_set), ("names of rank 1, mean", _names))
    found = [(what, [of(faulty[method]) for method in METHODS]) for what, of in rows]
    return [*found, ("false diagnoses", [_false(told[method]) for method in METHODS])]


def page(records: Sequence[Record]) -> str:
    """The tables, of all vehicles that are there."""
    signature = sensitive()
    told = read(records)
    refused = ", ".join(str(r["vehicle"]) for r in records if r["refused"]) or "none"
    commit = ", ".join(sorted({record["commit"] for record in records}))
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), ""]
    lines += [f"{len(records)} vehicles. Refused by the workshop's tuning: {refused}.", ""]
    lines += [f"| | {' | '.join(METHODS.values())} |", "|---" * (1 + len(METHODS)) + "|"]
    for size in SIZES:
        here = {method: [each for each in told[method] if each.one.label == size] for method in METHODS}
        for what, of in (
            ("detected", _detected),
            ("median delay", _delay),
            ("in the set", _in_set),
            ("names of rank 1, mean", _names),
            ("allowed by the alarms, mean", lambda h: _allowed(h, signature)),
            ("allowed by those that are sensitive, mean", lambda h: _allowed(_of_sensitive(h, signature), signature)),
            ("tests that decouple the fault and alarmed", lambda h: _decoupled(h, signature)),
            ("tests that are sensitive and alarmed", lambda h: _sensitive(h, signature)),
        ):
            lines.append(f"| {size}: {what} | {' | '.join(of(here[method]) for method in METHODS)} |")
    for what, of in (("false diagnoses", _false), ("false suspicions", _suspected)):
        lines.append(f"| {what} | {' | '.join(of(told[method]) for method in METHODS)} |")
    lines += ["", "## What it takes", "", "Medians over the vehicles.", ""]
    lines += [f"| | {' | '.join(METHODS.values())} |", "|---" * (1 + len(METHODS)) + "|"]
    for column, what in enumerate(("CPU time to the bundle [s]", "lines of the model", "recordings [s]")):
        of_methods = [[r["costs"][method][column] for r in records if r["costs"]] for method in METHODS]
        lines.append(f"| {what} | {' | '.join(f'{median(each):.0f}' if each else '-' for each in of_methods)} |")
    lines += ["", "## Both, beside the better one", "", *_paired(told)]
    lines += ["", "## Where the equations are wrong", "", WRONG, ""]
    lines += [f"| | {' | '.join(METHODS.values())} |", "|---" * (1 + len(METHODS)) + "|"]
    for doubted in (True, False):
        numbers = {record["vehicle"] for record in records if record["doubted"] == doubted}
        here = {m: [e for e in told[m] if e.one.vehicle in numbers and e.one.faults] for m in METHODS}
        name = f"{len(numbers)} vehicles {'in doubt' if doubted else 'without doubt'}"
        for what, of in (("detected", _detected), ("in the set", _in_set), ("names of rank 1, mean", _names)):
            lines.append(f"| {name}: {what} | {' | '.join(of(here[method]) for method in METHODS)} |")
    lines += ["", "## Every fault", "", "Detected, in the set, mean names.", ""]
    lines += [f"| | {' | '.join(METHODS.values())} |", "|---" * (1 + len(METHODS)) + "|"]
    for fault in dict.fromkeys(each.one.faults[0] for of in told.values() for each in of if each.one.faults):
        for size in SIZES:
            chosen = {m: [e for e in told[m] if e.one.faults == (fault,) and e.one.label == size] for m in METHODS}
            lines.append(f"| {fault}, {size} | {' | '.join(_cell(chosen[method]) for method in METHODS)} |")
    return "\n".join(lines) + "\n"


def _paired(told: dict[str, list[Told]]) -> list[str]:
    """Cases of all methods, in pairs: detected with the truth in the set by both bundles together, and by either."""
    good = {
        method: {
            (e.one.vehicle, e.one.faults, e.one.label): bool(_looked([e])) and in_set(e.one)
            for e in told[method]
            if e.one.faults
        }
        for method in METHODS
    }
    cases = sorted(set.intersection(*(set(of) for of in good.values()))) if all(good.values()) else []
    if not cases:
        return ["No cases yet."]
    better = max(("equations", "networks"), key=lambda method: sum(good[method][case] for case in cases))
    gained = sum(good["both"][case] and not good[better][case] for case in cases)
    lost = sum(good[better][case] and not good["both"][case] for case in cases)
    shares = "; ".join(f"{METHODS[m]} {sum(good[m][c] for c in cases)}" for m in ("equations", "networks", "both"))
    return [
        f"{len(cases)} cases; detected, and the truth in the set: {shares}. Both have {gained} that {METHODS[better]} "
        f"{'have' if better == 'equations' else 'has'} not, and lack {lost} that it has: "
        f"{100.0 * (gained - lost) / len(cases):+.1f} points."
    ]


def _looked(here: Sequence[Told]) -> list[Judged]:
    return [each.one for each in here if each.one.detected and each.one.standing.get(LOOK_S)]


def _detected(here: Sequence[Told]) -> str:
    return exact_share(sum(each.one.detected for each in here), len(here))


def _delay(here: Sequence[Told]) -> str:
    delays = [each.one.delay_s for each in here if each.one.delay_s is not None]
    return f"{median(delays):.0f} s" if delays else "-"


def _in_set(here: Sequence[Told]) -> str:
    looked = _looked(here)
    return exact_share(sum(map(in_set, looked)), len(looked))


def _names(here: Sequence[Told]) -> str:
    looked = _looked(here)
    return f"{sum(len(one.first(LOOK_S)) for one in looked) / len(looked):.2f}" if looked else "-"


def _allowed(here: Sequence[Told], signature: dict[str, frozenset[str]]) -> str:
    counts = [allowed(each.alarmed, signature) for each in here if each.alarmed]
    return f"{sum(counts) / len(counts):.2f}" if counts else "-"


def _of_sensitive(here: Sequence[Told], signature: dict[str, frozenset[str]]) -> list[Told]:
    """The same without alarms of tests that decouple the fault, which rule out the truth."""
    return [e._replace(alarmed=[test for test in e.alarmed if e.one.faults[0] in signature[test]]) for e in here]


def _decoupled(here: Sequence[Told], signature: dict[str, frozenset[str]]) -> str:
    pairs = [test in e.alarmed for e in here for test, of in signature.items() if e.one.faults[0] not in of]
    return exact_share(sum(pairs), len(pairs))


def _sensitive(here: Sequence[Told], signature: dict[str, frozenset[str]]) -> str:
    pairs = [test in e.alarmed for e in here for test, of in signature.items() if e.one.faults[0] in of]
    return exact_share(sum(pairs), len(pairs))


def _false(here: Sequence[Told]) -> str:
    return exact_rate(sum(len(each.one.false) for each in here), sum(each.one.free_s for each in here) / 3600)


def _suspected(here: Sequence[Told]) -> str:
    return exact_rate(sum(each.suspicions for each in here), sum(each.one.free_s for each in here) / 3600)


def _cell(here: Sequence[Told]) -> str:
    looked = _looked(here)
    if not looked:
        return f"{sum(each.one.detected for each in here)} of {len(here)}"
    names = sum(len(one.first(LOOK_S)) for one in looked) / len(looked)
    return f"{sum(e.one.detected for e in here)} of {len(here)}, {sum(map(in_set, looked))}; {names:.1f}"
