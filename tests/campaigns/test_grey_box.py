"""A fixed sample of the campaign: one vehicle, the tests that differ in what they see, and every part of the page."""

from pathlib import Path
from typing import Any

import pytest
import torch
from grey_box import SLOW, Case, judged, made, trained
from grey_box_page import HARD, page

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.model import load_model
from faultline.training.recipe import DEFAULT

BESIDE = 1.3
"""More than this many times the equations' error, and `tune` leaves a network out."""

DISTINCT = ("t02", "t06", "t08", "t12", "t13")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("grey-box")


def test_networks_are_nearer_than_the_equations_where_these_integrate(folder: Path) -> None:
    """Nearer in another cycle, within the band; where another controller drives, none that `tune` would leave out.

    Another processor's rounding is worth another seed of a training: three seeds give t12 1.09, 1.17 and 1.25 there.
    """
    torch.set_num_threads(1)
    case = Case("bench", None, 0)
    training = made(case, "training", folder, 1, 600.0)
    assert calibrate(["uds", str(training), "--out", str(folder / "model.toml")]) == 0
    model = load_model(str(folder / "model.toml"))
    networks, _, _ = trained(model, training, DEFAULT, 0, tests=DISTINCT)
    assert len(networks.graph) < 1.5e6
    drive = made(case, "drive", folder, 3, 480.0), 0.9
    slow = made(case, "validation", folder, 2, 480.0, SLOW), BESIDE
    for recording, hard in (drive, slow):
        for test, told in judged(model, networks, recording).items():
            limit = hard if test in HARD else BESIDE
            assert told["networks"] < limit * told["equations"], test
            assert told["covered"] > 0.96, test


def test_the_page_has_all_its_parts() -> None:
    tests = {test: {"equations": 2e3, "networks": 1e3, "covered": 0.99} for test in ("t02", *HARD)}
    stamp = {"commit": "abc", "code": "def"}
    common = {"kind": "compared", "vehicle": "bench", "seed": 0, "cpu_s": 50.0, "bytes": 500_000, "calibrated": True}
    of = dict.fromkeys(("validation", "drive", "slow"), tests)
    errors = {way: dict.fromkeys(tests, 1e3) for way in ("as they are", "adapted", "anew")}
    corner: dict[str, Any] = {
        "kind": "corner",
        "case": "corner",
        "ticks": 467,
        "beyond": 0.1,
        "error": 2.6e3,
    }
    records = [
        {**common, "case": "bench-none-0", "effect": None, "judged": of},
        {**common, "case": "bench-full_lift-0", "effect": "full_lift", "judged": of, "calibrated": False},
        {"kind": "transfer", "case": "t", "seconds": 120.0, "cpu_s": {"adapted": 9.0, "anew": 50.0}, "errors": errors},
        {"kind": "thesis", "case": "thesis-t02", "test": "t02", "epoch_s": 1.3},
        {"kind": "whole", "case": "whole-t02", "test": "t02", "cpu_s": 2e3, "errors": {"drive": 9e3}},
        {**corner, "way": "default"},
    ]
    told = page([{**record, **stamp} for record in records])
    assert "Of t12, t13, t19, t21, 12 of 12 ratios are at most 0.75; the worst is 0.50." in told
    assert "By the drive `tune` would leave out 0 networks" in told
    assert "Of the others 0 of 20 do so in another recording: none." in told
    assert "| t02 | 1.30 | 1950 | 1950 |" in told
    assert "## Hidden in the vehicle: full_lift" in told
    assert told.count("`calibrate` refuses") == 1
    assert "| t02 | 2000 | drive | 0.0900 | 0.0100 | 0.0200 |" in told
    assert "| default | 467 | 10.0 % | 0.026 |" in told
    assert "adapting 9 CPU-s, anew 50 CPU-s" in told
