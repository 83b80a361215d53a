"""A fixed sample of the campaign: one vehicle, three faults."""

import pytest
from diagnosis import Record, vehicle
from diagnosis_page import page


@pytest.fixture(scope="module")
def told() -> Record:
    return vehicle("truck-301", ["fA_t", "fA_du", "fy_p_du"], free=1)


def test_large_faults_are_named_among_their_mates_and_nothing_is_told_without_one(told: Record) -> None:
    assert [one for one in told["judged"] if one["false"]] == []
    for one in told["judged"]:
        if one.get("size") == "large":
            assert one["fault"] in one["standing"], one
            assert len(one["standing"]) <= 3, one
            assert one["delay_s"] < 60.0, one


def test_the_page_counts_what_was_told(told: Record) -> None:
    said = page([{**told, "commit": "abc", "code": "def"}])
    assert "1 vehicles. Fault-free: 0 diagnoses told in 0.4 h, so at most 7.20 an hour (95 %)." in said
    assert "| fA_t | large | 1 of 1, 100.0 % (2.5 to 100.0 %) |" in said
