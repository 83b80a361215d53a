"""The page of `grey_box`: networks beside equations, per test."""

import os
import platform
import statistics
from collections.abc import Sequence
from typing import Any

from faultline.analysis.tuning.unfit import OUTDONE

Record = dict[str, Any]

HEAD = """# Grey-box networks beside the calibrated equations

All data are **simulated** by the rig, profile `ideal`; made by `make campaign-training`. Both are made from one
training recording of 600 s and judged on four others: *validation* (other doses), *drive* (random), and two under
pressure controllers that the training recording does not have: *slow* (validation; half the gain, twice the integral
time) and *brisk* (a drive; twice the gain, 0.7 of the integral time). The equations are run as
the vehicle runs them, at its ticks, where they do not know how old a command is. Errors are RMS over ticks at which
the test can tell [bar]. A ratio below one says that the networks are nearer.
"""

HARD, MARK = ("t12", "t13", "t19", "t21"), 0.75
EPOCHS = 1500
MEMBERS = 50
"""Networks of a bank: ten tests of five members."""


def page(records: Sequence[Record]) -> str:
    """The page, as Markdown."""
    compared = [r for r in records if r["kind"] == "compared"]
    parts = [HEAD]
    plain = [r for r in compared if r["effect"] is None]
    if plain:
        parts += ["## No effect hidden", _errors(plain), "## The band, fault-free", _coverage(plain)]
    for effect in sorted({r["effect"] for r in compared} - {None}):
        parts += [f"## Hidden in the vehicle: {effect}", _errors([r for r in compared if r["effect"] == effect])]
    if compared:
        parts += ["## Off the regime of the training", _off_regime(compared)]
    transfer = sorted((r for r in records if r["kind"] == "transfer"), key=lambda r: float(r["seconds"]))
    if transfer:
        parts += ["## From the bench to a truck (thesis 8.2.5)", _transfer(transfer)]
    thesis = sorted((r for r in records if r["kind"] == "thesis"), key=lambda r: str(r["test"]))
    corners = {r["way"]: r for r in records if r["kind"] == "corner"}
    if corners:
        parts += ["## Operation that was never trained (thesis Fig. 6.15, 6.16)", _corner(corners)]
    if thesis and plain:
        parts += ["## What it costs", _cost(plain, thesis)]
    whole = [r for r in records if r["kind"] == "whole"]
    if whole:
        parts += ["## The thesis' recipe to its end", _whole(whole, compared)]
    commits, codes = (", ".join(sorted({r[name] for r in records})) for name in ("commit", "code"))
    parts.append(f"Commit {commits}, code {codes}, {platform.machine()} with {os.cpu_count()} cores.")
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _ratio(found: Record) -> float:
    return float(found["networks"] / found["equations"])


def _errors(records: Sequence[Record]) -> str:
    """Median over records, with the range of the ratio."""
    names = [*records[0]["judged"]]
    lines = [
        f"| test | {' | '.join(f'{n}: equations | networks | ratio (range)' for n in names)} |",
        "|---|" + "---|---|---|" * len(names),
    ]
    for test in sorted(records[0]["judged"][names[0]]):
        cells = []
        for name in names:
            found = [r["judged"][name][test] for r in records]
            ratios = [_ratio(f) for f in found]
            spread = f" ({min(ratios):.2f} to {max(ratios):.2f})" if len(ratios) > 1 else ""
            both = [statistics.median(f[kind] for f in found) / 1e5 for kind in ("equations", "networks")]
            cells += [f"{value:.4f}" for value in both] + [f"{statistics.median(ratios):.2f}{spread}"]
        lines.append(f"| {test} | {' | '.join(cells)} |")
    hard = [_ratio(r["judged"][name][test]) for r in records for name in names for test in HARD]
    met = sum(ratio <= MARK for ratio in hard)
    cases = ", ".join(r["case"] for r in records)
    told = f"Of {', '.join(HARD)}, {met} of {len(hard)} ratios are at most {MARK}; the worst is {max(hard):.2f}."
    count = f"{len(records)} record{'s' if len(records) > 1 else ''}: {cases}."
    refused = ", ".join(r["case"] for r in records if not r["calibrated"])
    if refused:
        count += (
            f" **`calibrate` refuses {refused}**, as the equations do not describe the recording: they are judged with "
            "the parameters of the model file; fitted ones might be nearer."
        )
    return "\n\n".join([count, "\n".join(lines), told])


def _off_regime(records: Sequence[Record]) -> str:
    """How many networks that `tune` would keep, by the drive, are worse elsewhere than it would let them be."""
    left_out, kept, worse = 0, 0, list[str]()
    for record in records:
        for test, of_drive in record["judged"]["drive"].items():
            if _ratio(of_drive) > OUTDONE:
                left_out += 1
                continue
            for name, found in record["judged"].items():
                if name != "drive":
                    kept += 1
                    worse += [f"{record['case']} {test} {name} {_ratio(found[test]):.2f}"] * (
                        _ratio(found[test]) > OUTDONE
                    )
    return (
        f"By the drive `tune` would leave out {left_out} networks, as they err by more than {OUTDONE} times as much "
        f"as the equations. Of the others {len(worse)} of {kept} do so in another recording: "
        f"{', '.join(worse) or 'none'}."
    )


def _coverage(records: Sequence[Record]) -> str:
    lines = ["| test | within the 99 % band, median (range) |", "|---|---|"]
    for test in sorted(records[0]["judged"]["validation"]):
        covered = [100 * of[test]["covered"] for r in records for of in r["judged"].values()]
        lines.append(f"| {test} | {statistics.median(covered):.2f} % ({min(covered):.2f} to {max(covered):.2f} %) |")
    return "\n".join(lines)


def _transfer(records: Sequence[Record]) -> str:
    ways = [*records[0]["errors"]]
    lines = [f"| recording | test | {' | '.join(ways)} |", "|---|---|" + "---|" * len(ways)]
    for record in records:
        for test in sorted(record["errors"][ways[0]]):
            errors = " | ".join(f"{record['errors'][way][test] / 1e5:.4f}" for way in ways)
            lines.append(f"| {record['seconds']:.0f} s | {test} | {errors} |")
    costs = [
        f"of {r['seconds']:.0f} s, adapting {r['cpu_s']['adapted']:.0f} CPU-s, anew {r['cpu_s']['anew']:.0f} CPU-s"
        for r in records
    ]
    head = (
        "Errors [bar] on the truck's validation cycle of the bench's networks as they are, adapted to a short drive of "
        "the truck (`--from`), and of networks trained on that drive alone."
    )
    return "\n\n".join([head, "\n".join(lines), f"Cost: {'; '.join(costs)}."])


def _cost(compared: Sequence[Record], thesis: Sequence[Record]) -> str:
    times = [r["cpu_s"] for r in compared]
    ours = statistics.median(times) / MEMBERS
    head = (
        f"The default recipe takes {statistics.median(times):.0f} CPU-s ({min(times):.0f} to {max(times):.0f}) for ten "
        f"tests of 5 members on one core, {ours:.2f} CPU-s a member's test; variance and graph included. The "
        f"graph has {compared[0]['bytes'] / 1024:.0f} KiB. The thesis' recipe, one member of one test at a time on one "
        f"core, extrapolated from a few epochs to its {EPOCHS}:"
    )
    lines = ["| test | CPU-s an epoch | CPU-s a member | times ours |", "|---|---|---|---|"]
    for r in thesis:
        whole = EPOCHS * r["epoch_s"]
        lines.append(f"| {r['test']} | {r['epoch_s']:.2f} | {whole:.0f} | {whole / ours:.0f} |")
    return "\n\n".join([head, "\n".join(lines)])


def _corner(corners: Record) -> str:
    """By way of training: what t02 shows where it was never trained."""
    head = (
        "t02 is trained on a drive alone, where no dose is given below 9 bar. Then the pump filter clogs (0.85 of its "
        "area), the pressure falls, and doses go on: t02 decouples that fault, and what it shows there is false. *Not "
        "varied*: without recordings varied by the equations; *with the fault*: so, and on a recording of that fault "
        "besides. Beyond the band are so many ticks there."
    )
    lines = [
        "| trained | ticks | beyond the band | RMS error [bar] |",
        "|" + "---|" * 4,
    ]
    for way, r in sorted(corners.items(), reverse=True):
        lines.append(f"| {way} | {r['ticks']} | {100 * r['beyond']:.1f} % | {r['error'] / 1e5:.3f} |")
    return "\n\n".join([head, "\n".join(lines)])


def _whole(whole: Sequence[Record], compared: Sequence[Record]) -> str:
    """Its errors beside those of the same recordings' `bench-none-0`."""
    ours: Record = next((r["judged"] for r in compared if r["case"] == "bench-none-0"), {})
    head = f"{EPOCHS} epochs, one member, the training recording of bench-none-0 from one start; RMS errors [bar]."
    lines = ["| test | CPU-s | recording | thesis' recipe | ours | equations |", "|" + "---|" * 6]
    for r in sorted(whole, key=lambda r: str(r["test"])):
        for name, error in r["errors"].items():
            other = ours.get(name, {}).get(r["test"])
            both = " | ".join(f"{other[kind] / 1e5:.4f}" if other else "-" for kind in ("networks", "equations"))
            lines.append(f"| {r['test']} | {r['cpu_s']:.0f} | {name} | {error / 1e5:.4f} | {both} |")
    return "\n\n".join([head, "\n".join(lines)])
