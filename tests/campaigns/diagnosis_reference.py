"""The reference tuning: thresholds from fault-free drives of other vehicles, which each vehicle's workshop adapts.

The vehicles are `diagnosis_cases.REFERENCE`: without hidden effects, on days of their own, and never judged. Needs
`faultline tune --also` and `--adapt`.
"""

from collections.abc import Sequence
from pathlib import Path
from shutil import rmtree

from diagnosis_cases import REFERENCE
from diagnosis_shop import Workshop, must

from faultline.analysis.tuning.command import main as tune

DRIVES, DRIVE_S = (20, 21), 1800.0
"""Of each vehicle: an hour, eight in all."""

OPTIONS: tuple[str, ...] = ()
"""Further ones of `faultline tune`, such as a target of suspicions an hour."""


def reference(root: Path, numbers: Sequence[int] = REFERENCE) -> Path:
    """The tuning of the reference vehicles, made once for a folder."""
    out = root / "reference" / "tuning.json"
    if not out.exists():
        rmtree(out.parent, ignore_errors=True)  # what an interrupted run left: a model would be in the way
        vehicles = [Workshop(number, "A", root / "reference" / f"truck-{number}") for number in numbers]
        (model, drives), *others = [_materials(vehicle) for vehicle in vehicles]
        words = [str(model), *map(str, drives)]
        for model, drives in others:
            words += ["--also", str(model), *map(str, drives)]
        must(tune, [*words, *OPTIONS, "--out", str(out)])
    return out


def _materials(vehicle: Workshop) -> tuple[Path, list[Path]]:
    """The calibrated model and the drives of a reference vehicle."""
    model, _ = vehicle.calibrated()
    return model, [vehicle.made("drive", k, DRIVE_S) for k in DRIVES]
