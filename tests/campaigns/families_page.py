"""The page of the campaign over plants of other structures."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from results_page import exact_share, provenance

from faultline.testbench.families.draw import FAMILIES

Rows = Sequence[dict[str, Any]]

CLAIMS = ("named", "one of", "unnamed", "fault")


def page(rows: Rows, commit: str, seconds: float, development: Sequence[str]) -> str:
    """The results as Markdown; `development` are the families that the methods were chosen on."""
    sound = [row for row in rows if not row["effects"]]
    later = sorted({row["family"] for row in sound} - {*development})
    groups = (("Families for development", development), ("Families made after the freeze", later))
    lines = [
        "# Plants of other structures: is anything claimed where nothing is missing?",
        "",
        "Made by `make campaign-families`; `faultline rig family` records such plants. **All data are simulated.** "
        "Each plant has two recordings of 480 s, and the four-state model with its data sheet. `discover` has the "
        "shipped library; `calibrate` fits the first and judges both.",
        "",
    ]
    for title, families in groups:
        its = [row for row in sound if row["family"] in families]
        if its:
            lines += [f"## {title}", "", *_nulls(its, families), "", *_calibrations(its, families), ""]
    hidden = [row for row in rows if row["effects"]]
    if hidden:
        lines += ["## Effects hidden in them", "", *_hidden(hidden), ""]
    lines += ["| family | what it is like |", "|---|---|", *(f"| {k} | {v.text} |" for k, v in FAMILIES.items()), ""]
    made = Counter(row["commit"] for row in rows if "commit" in row)
    by = "; ".join(f"{count} of {name}" for name, count in made.items())
    return "\n".join([*lines, provenance(commit, seconds), *([f"Plants by commit: {by}."] if made else []), ""])


def _nulls(rows: Rows, families: Sequence[str]) -> list[str]:
    def count(its: Rows, *kinds: str) -> int:
        return sum(row["verdict"] in kinds for row in its)

    lines = [
        "| family | plants | named | something missing | recordings differ | errors | most evidence [nats] | CPU [s] |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for family in families:
        its = [row for row in rows if row["family"] == family]
        told = [row for row in its if "evidence" in row]
        most = max((max(row["evidence"].values()) for row in told), default=math.nan)
        cpu = np.mean([row["cpu_s"] for row in told]) if told else math.nan
        lines.append(
            f"| {family} | {len(its)} | {count(its, 'named', 'one of')} | {count(its, 'unnamed', 'fault')} | "
            f"{count(its, 'recordings differ')} | {len(its) - len(told)} | {most:.0f} | {cpu:.0f} |"
        )
    return [*lines, "", f"**Something claimed: {exact_share(count(rows, *CLAIMS), len(rows))}.**"]


def _calibrations(rows: Rows, families: Sequence[str]) -> list[str]:
    its = [row for row in rows if "calibrate" in row]
    names = [name for name, (_, half, _) in its[0]["calibrate"]["errors"].items() if half > 0.0]
    refused = sum(bool(row["calibrate"]["doubts"]) for row in its)

    def share(those: Rows, chosen: Sequence[str]) -> str:
        found = [row["calibrate"]["errors"][name] for row in those for name in chosen]
        return exact_share(sum(abs(e) <= half for e, half, _ in found), len(found))

    lines = [
        f"`calibrate` accepts {exact_share(len(its) - refused, len(its))}. Parameters within the stated 95 % "
        f"intervals, relative to the displacement: **{share(its, names)}**.",
        "",
        "| family | within | | parameter | within |",
        "|---|---|---|---|---|",
    ]
    columns: list[list[str]] = [
        [f"{family} | {share([row for row in its if row['family'] == family], names)}" for family in families],
        [f"{name} | {share(its, [name])}" for name in names],
    ]
    for k in range(max(map(len, columns))):
        left, right = (column[k] if k < len(column) else " | " for column in columns)
        lines.append(f"| {left} | | {right} |")
    return lines


def _hidden(rows: Rows) -> list[str]:
    def key(row: dict[str, Any]) -> str:
        return ", ".join(f"{name} {size:g}" for name, size in row["effects"].items())

    lines = ["| family, plant | hidden | verdict | names | evidence [nats] |", "|---|---|---|---|---:|"]
    for row in sorted(rows, key=lambda row: (key(row), row["family"])):
        names = "; ".join(", ".join(one) for one in row["sets"])
        lines.append(
            f"| {row['family']}-{row['number']} | {key(row)} | {row['verdict']} | {names} | "
            f"{row.get('gain', 0.0):.0f} |"
        )
    return lines
