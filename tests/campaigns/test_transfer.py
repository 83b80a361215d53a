"""The page of `transfer` counts what the records say."""

from transfer import MINUTES, WAYS, page


def record(vehicle: int, adapted: float) -> dict[str, object]:
    errors = {way: {"t02": error} for way, error in zip(WAYS, (2000.0, adapted, 1000.0), strict=True)}
    minutes = {str(each): {"errors": errors, "anew": ["t02"] if vehicle == 1 else []} for each in MINUTES}
    return {"vehicle": vehicle, "minutes": minutes, "wall_s": 60.0, "cpu_s": 60.0, "commit": "abc"}


def test_as_good_is_within_what_two_seeds_differ_by() -> None:
    made = page([record(1, 1040.0), record(2, 1100.0), record(3, 900.0)])
    assert "3 vehicles." in made
    for minutes in MINUTES:
        assert f"| {minutes} | t02 | 2.00 | 1.04 | 1.00 | 2 of 3 | 1 of 3 |" in made
