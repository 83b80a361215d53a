"""What is declared before anything is searched: how small an effect recordings can show, and what looks the same there.

    .venv/bin/python tests/campaigns/discrepancy_declared.py

From the sensitivities of six records in which nothing is hidden, before any other is searched: for every entry of the
library the median of its smallest visible size, and the entries that look the same in more than half of the records.
"""

import json
import tempfile
from multiprocessing import Pool
from pathlib import Path
from statistics import median
from typing import Any

from discrepancy import DURATION_S, record_case
from discrepancy_cases import Case, cases

from faultline.analysis.discrepancy.data import load
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.name.attempt import Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.contest import LEAST
from faultline.analysis.discrepancy.name.sensitivity import alike, smallest_sizes
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.testbench.cycles import CYCLES

DECLARED = Path(__file__).with_suffix(".json")

RECORDS = 6
BEYOND = 1e9
"""Stands for a size that no record could show."""


def of_record(case: Case) -> tuple[dict[str, float], dict[str, tuple[str, ...]]]:
    """Smallest sizes and look-alikes in one record."""
    with tempfile.TemporaryDirectory() as folder:
        training, held = (
            record_case(case, CYCLES[name], name, case.seed + k, {}, Path(folder), DURATION_S)
            for k, name in enumerate(("training", "validation"))
        )
        data = load(load_model("uds"), [training], [held], lambda _: None)
        study = Study(data.key, data.model, load_library(SYSTEMS / "uds"), data.training_sections, data.held_sections)
        judge = Judge(study, baseline_of(study))
        directions = [judge.direction(name) for name in study.library]
    return dict(smallest_sizes(directions, LEAST)), alike(directions)


def main() -> None:
    """Writes the declaration."""
    silent = [case for case in cases("A") if case.kind == "nothing"][:RECORDS]
    with Pool(2) as pool:
        found = pool.map(of_record, silent)
    declared: dict[str, Any] = {}
    for name in load_library(SYSTEMS / "uds"):
        sizes = [min(sizes[name], BEYOND) for sizes, _ in found]
        others = sorted({other for _, same in found for other in same[name]})
        often = [other for other in others if 2 * sum(other in same[name] for _, same in found) > RECORDS]
        declared[name] = {"smallest": float(f"{median(sizes):.3g}"), "alike": often}
    DECLARED.write_text(json.dumps(declared, indent=1) + "\n")


if __name__ == "__main__":
    main()
