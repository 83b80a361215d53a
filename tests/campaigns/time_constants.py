"""How often 95 % intervals hold a drift's time constant and its amount: by the curvature, and by the profile.

    .venv/bin/python tests/campaigns/time_constants.py

Three tanks whose pump drifts towards another delivery, in simulated recordings of 600 s; what is searched for is the
true effect. The method was made with seeds below 100.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from results_page import head_commit

sys.path.insert(0, str(Path(__file__).parents[1] / "analysis" / "discrepancy"))
from test_profile import RECORDED_S, TANKS, searched

from faultline.analysis.discrepancy.name.profile import Ends
from faultline.analysis.discrepancy.show.sizes import sizes
from faultline.analysis.model.display import units_of

PAGE = Path("docs/results/time-constants.md")
TIMES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""In lengths of the recording."""

COLUMNS = ("drift_T", "drift_k")


def held(time: float, seed: int) -> list[tuple[bool, bool, bool]]:
    """Of time constant and amount: does the curvature's interval hold it, does the profile's, is that open."""
    effect, best, profiled, part = searched(time * RECORDED_S, seed)
    curved = {size.parameter: size.interval for size in sizes(best, {effect.name: effect}, units_of(TANKS))}
    found = []
    for name, true in zip(COLUMNS, (time * RECORDED_S, part), strict=True):
        found.append((_holds(curved[name], true), _holds(profiled[name], true), None in profiled[name]))
    return found


def _holds(interval: Ends | None, true: float) -> bool:
    low, high = interval or (None, None)
    return interval is not None and (low is None or low <= true) and (high is None or true <= high)


def page(rows: Sequence[tuple[float, list[list[tuple[bool, bool, bool]]]]], commit: str) -> str:
    """The table, by time constant."""
    lines = [
        "# Do intervals hold a drift's time constant?",
        "",
        "Made by `make campaign-time-constants`. **All data are simulated**: three tanks in which the pump's delivery",
        "drifts to another one, 600 s to fit. Before, 600 s with a prior of 65 % are usual for the time constant, and",
        "a curvature has that in it; a profile says what the recording says, with an open end where that is nothing.",
        "",
        "| time constant / recording | drifts | its curvature | profile | open | amount: curvature | profile | open |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for time, drifts in rows:
        counts = [str(sum(each[k][j] for each in drifts)) for k in range(len(COLUMNS)) for j in range(3)]
        lines.append(f"| {time:g} | {len(drifts)} | {' | '.join(counts)} |")
    return "\n".join([*lines, "", f"Commit {commit}."]) + "\n"


def main() -> None:
    """Measures and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--count", type=int, default=20)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.count)
    PAGE.write_text(page([(time, [held(time, seed) for seed in seeds]) for time in TIMES], head_commit()))


if __name__ == "__main__":
    main()
