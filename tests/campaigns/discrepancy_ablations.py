"""What the workflow is without the parts that make it work: the same records, one part taken out at a time.

    .venv/bin/python tests/campaigns/discrepancy_ablations.py

What the variants are is told by `discrepancy_ablations_page`, on the campaign's page.
"""

import argparse
import json
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import Pool
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
from discrepancy import DURATION_S, FROZEN, Inline, done, record_case
from discrepancy_ablations_page import ABLATIONS
from discrepancy_cases import Case, cases
from results_page import digest, head_commit

from faultline.analysis.calibration.sections import Section
from faultline.analysis.calibration.validate import STEADY
from faultline.analysis.discrepancy.add.held_out import shown
from faultline.analysis.discrepancy.data import Data, load
from faultline.analysis.discrepancy.discover import discover
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.name.attempt import Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.contest import Outcome, contest
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.service.core.errors import InputError
from faultline.testbench.cycles import CYCLES

Array = npt.NDArray[np.float64]
Names = list[list[str]]

PEER = Path(".venv-peer/bin/python")

NOMINAL = ("n", "p", "root p", "dose")


def wanted() -> list[Case]:
    """One of every effect at its typical size, and as many with nothing."""
    of_a = [*cases("A")]
    hidden = [case for case in of_a if case.kind == "hidden" and case.name.endswith("-x1-0")]
    return [*hidden, *[case for case in of_a if case.kind == "nothing"][-len(hidden) :]]


def whole(data: Data) -> Names:
    """The sets that the workflow names."""
    found = discover(data, load_library(SYSTEMS / "uds"), Inline(), None, lambda *_: None)
    return [list(names) for names in found.verdict.sets] if found.verdict.kind in ("named", "one of") else []


@contextmanager
def no_timing_noise() -> Iterator[None]:
    """Inputs are exact, and dosed at the very time that is said."""

    def nothing(section: Section, *_: Any) -> Array:
        return np.zeros((sum(len(s.t) for s in section.samples.values()), 1))

    with patch("faultline.analysis.calibration.likelihood.disturbances", nothing):
        yield


@contextmanager
def no_other_beginnings() -> Iterator[None]:
    """Searches begin where the model without effects was fitted, nowhere else."""

    def from_there(crew: Any, effects: Any, nominal: Any, threshold: float, unbent: Any, say: Any) -> Outcome:
        del unbent
        return contest(crew, effects, nominal, threshold, None, say)

    with patch("faultline.analysis.discrepancy.discover.contest", from_there):
        yield


def without(part: Callable[[], Any], data: Data) -> Names:
    """The sets that are named without a part."""
    with part():
        return whole(data)


def by_rmse(data: Data) -> Names:
    """The entry with the smallest held-out error, if it is below that of the model as it is."""
    library = load_library(SYSTEMS / "uds")
    study = Study(data.key, data.model, library, data.training_sections, data.held_sections)
    baseline = baseline_of(study)
    judge = Judge(study, baseline)
    nominal = judge.attempt(())
    errors = dict[str, float]()
    for name in library:
        try:
            runs = shown(study, baseline, nominal, judge.attempt((name,)))
        except InputError:
            continue  # it cannot be run, and nobody would take it
        errors[name] = _error(runs.after.agreement)
    best = min(errors, key=lambda name: errors[name])
    return [[best]] if errors[best] < _error(runs.before.agreement) else []


def _error(agreement: Any) -> float:
    return float(sum(by_mode[STEADY].rms ** 2 for by_mode in agreement.values()))


def by_sparse_regression(data: Data) -> Names:
    """The candidate terms that pysindy chooses, each a set of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "features.npz"
        np.savez(path, **sindy_features(data))
        command = [str(PEER), "tests/campaigns/sindy_peer.py", str(path)]
        found = subprocess.run(command, capture_output=True, text=True, check=True)
    return [[name] for name in json.loads(found.stdout)]


def sindy_features(data: Data) -> dict[str, Any]:
    """Terms (N, F) and the pressure's rate (N,) [Pa/s] of both recordings, smoothed over a second."""
    found: dict[str, Any] = {"nominal": NOMINAL, "step_s": data.training_sections[0].drive.step_s}
    for title, sections in (("training", data.training_sections), ("held", data.held_sections)):
        parts = [_features(data, section) for section in sections]
        found["names"] = [*parts[0][0]]
        found[title] = np.concatenate([np.column_stack([*terms.values()]) for terms, _ in parts])
        found[f"{title}_rate"] = np.concatenate([rate for _, rate in parts])
    return found


def _features(data: Data, section: Section) -> tuple[dict[str, Array], Array]:
    h, samples = section.drive.step_s, section.samples["y_p_du"]
    t = section.t[(section.t >= samples.t[0]) & (section.t <= samples.t[-1])]
    smooth = np.ones(round(1.0 / h)) * h
    inputs = {name: section.drive.inputs[:, k] for k, name in enumerate(data.system.inputs)}
    p, n, dose = (
        np.convolve(value, smooth, "same")
        for value in (
            np.interp(t, samples.t, samples.value) / 1e5,
            *(np.interp(t, section.t, inputs[name]) for name in ("n_p", "dc_dose")),
        )
    )
    root, rate = np.sqrt(np.maximum(p - 1.0, 0.0)), np.gradient(p, h)
    terms = {
        "n": n, "p": p, "root p": root, "dose": dose * root, "full dose": (dose > 0.98) * root,
        "partial dose": ((dose > 0.02) & (dose < 0.98)) * root, "rate / p2": rate / p**2, "rate p": rate * p,
        "p2": p**2, "n2": n**2, "n p": n * p, "above 10.5 bar": np.maximum(p - 10.5, 0.0), "t": t, "p t": p * t,
        "root p t": root * t, "dose t": dose * root * t,
    }  # fmt: skip
    inside = slice(len(smooth), -len(smooth))
    return {name: value[inside] for name, value in terms.items()}, rate[inside]


VARIANTS: dict[str, Callable[[Data], Names]] = {
    "whole": whole,
    "without timing noise": lambda data: without(no_timing_noise, data),
    "without other beginnings": lambda data: without(no_other_beginnings, data),
    "by RMSE": by_rmse,
    "sparse regression": by_sparse_regression,
}


def run(case: Case) -> dict[str, Any]:
    """One record under all variants."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [
            record_case(case, CYCLES[name], name, case.seed + k, case.effects, Path(folder), DURATION_S)
            for k, name in enumerate(("training", "validation"))
        ]
        data = load(load_model("uds"), paths[:1], paths[1:], lambda _: None)
        named = {title: variant(data) for title, variant in VARIANTS.items()}
    return {"case": case.name, "effects": [*case.effects], "named": named}


def main() -> None:
    """Runs what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    commit, code = head_commit(), digest(*FROZEN)
    there = {line["case"] for line in done(ABLATIONS)}
    with Pool(options.processes) as pool:
        for result in pool.imap_unordered(run, [case for case in wanted() if case.name not in there]):
            with ABLATIONS.open("a") as file:
                file.write(json.dumps({**result, "commit": commit, "code": code}) + "\n")
            print(result["case"], result["named"], flush=True)


if __name__ == "__main__":
    main()
