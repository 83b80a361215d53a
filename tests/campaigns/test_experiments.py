"""How the campaign of experiments counts; that an experiment resolves is shown by the story of air in the hose."""

from typing import Any

from experiments import ROUNDS, SIZES, evaluation, page

from faultline.testbench.effects import checked


def record(
    number: int, before: list[list[str]], after: list[list[str]] | None, verdict: str = "named"
) -> dict[str, Any]:
    """Air in the hose, with sets of names before and after an experiment; none was proposed where there are none."""
    kept: dict[str, Any] = {"proposed": None}
    if after is not None:
        kept = {
            "proposed": "speed_ramp-x4",
            "duration_s": 360.0,
            "likely": [["entrained_air", "stiff_hose", 20.0, 0.9], ["stiff_hose", "entrained_air", 20.0, 0.3]],
            "verdict": verdict,
            "sets": after,
        }
    first = {"case": f"{number}-air", "kind": "hidden", "effects": {"entrained_air": 1.0}, "verdict": "one of"}
    return {**first, "sets": before, "experiment": kept, "plan_cpu_s": float(number)}


def test_only_sets_with_the_right_name_count_and_only_the_right_one_alone_is_a_success() -> None:
    two = [["entrained_air", "stiff_hose"]]
    text = page(
        [
            record(1, two, [["entrained_air"]]),
            record(2, two, [["stiff_hose"]]),
            record(3, two, two, "one of"),
            record(4, two, None),
            record(5, [["stiff_hose", "pump_slip"]], [["stiff_hose"]]),
            {"case": "6-air", "effects": {"entrained_air": 1.0}, "verdict": "named", "sets": [["entrained_air"]]},
        ]
    )
    assert "Of 6 records 5 had several names that are not all equivalent; in 1 of them\nnone was right" in text
    assert "| the right one is left alone | 80 %, at least 40 sets | 1 of 4, 25.0 %" in text
    assert "| ... where an experiment was proposed |  | 1 of 3, 33.3 %" in text
    assert "| the right one is lost |  | 1 of 4, 25.0 %" in text
    assert "- 0.8 to 0.95: 1 of 3, 33.3 %" in text  # of the right name against another
    assert "| 1-air | entrained_air, stiff_hose | speed_ramp-x4, 360 s | **named: entrained_air** |" in text
    assert "| 4-air | entrained_air, stiff_hose | none | - |" in text
    assert "takes 3 s of CPU in the middle, 5 s at most" in text


def test_every_record_is_another_truck_and_can_be_recorded() -> None:
    cases = [*evaluation()]
    assert len(cases) == ROUNDS * sum(map(len, SIZES.values()))
    assert len({case.vehicle for case in cases}) == len({case.seed for case in cases}) == len(cases)
    for case in cases:
        checked(case.effects)
