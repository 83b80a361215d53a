"""The ablations' part of the campaign's page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from discrepancy_cases import TRUTHS
from results_page import exact_share

ABLATIONS = Path("docs/results/discrepancy-ablations.jsonl")

TERMS = {
    "full_lift": "full dose",
    "opening_delay": "partial dose",
    "closing_delay": "partial dose",
    "entrained_air": "rate / p2",
    "stiff_hose": "rate p",
    "pump_slip": "p2",
    "incomplete_filling": "n2",
    "relief_valve": "above 10.5 bar",
    "viscosity_drift": "p t",
}
"""The candidate term of an effect, in a balance of the hose."""

HEAD = (
    "## What it is without its parts\n"
    "\n"
    "One record of every effect of set A at its typical size, and as many with nothing hidden. Without *timing noise* "
    "the inputs are taken for exact. Without *other beginnings* searches begin at the model as it was fitted. *By "
    "RMSE* takes the entry with the smallest error of the held-out free run, if that is smaller than the model's as it "
    "was, which is what people do. *Sparse regression* is pysindy 2.1 on the derivative of the pressure: right if the "
    "effect's term is chosen; effects that such a regression has no term for are left out of its count."
)


def ablations(results: Sequence[Mapping[str, Any]]) -> str:
    """The table; nothing of no results."""
    if not results:
        return ""
    lines = [
        "| variant | truth in a named set | and nothing else named | nothing hidden: something named |",
        "|---|---|---|---|",
    ]
    hidden, nothing = ([r for r in results if bool(r["effects"]) == there] for there in (True, False))
    for title in results[0]["named"]:
        right = [(r["named"][title], _right(title, r["effects"][0])) for r in hidden]
        counted = [(sets, names) for sets, names in right if names]
        there = sum(any({*some} & {*names} for some in sets) for sets, names in counted)
        alone = sum(len(sets) == 1 and {*sets[0]} <= {*names} for sets, names in counted)
        false = sum(bool(r["named"][title]) for r in nothing)
        row = [exact_share(there, len(counted)), exact_share(alone, len(counted)), exact_share(false, len(nothing))]
        lines.append(f"| {title} | {' | '.join(row)} |")
    commits = ", ".join(dict.fromkeys(r["commit"] for r in results))
    return "\n".join([HEAD, "", *lines, "", f"The variants are those of commit {commits}, older than the rest."])


def _right(title: str, effect: str) -> tuple[str, ...]:
    if title == "sparse regression":
        return (TERMS[effect],) if effect in TERMS else ()
    return TRUTHS[effect].entries
