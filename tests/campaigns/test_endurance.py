"""A sample of the campaign: an hour of log time, and 100,000 mutated frames."""

import os

import pytest
from endurance import Said, line_rate, page, run


def test_an_hour_of_log_time_takes_no_more_memory_than_its_beginning() -> None:
    soaked = run("soak", "0.5")
    assert soaked.rss.max() < 105
    assert soaked.later.rss[-1] - soaked.later.rss[0] < 3.0  # MiB; rings fill for 45 minutes, two hours end at 2.8
    assert len(set(soaked.later.descriptors.tolist())) == 1


def test_mutated_frames_raise_nothing_and_leave_nothing() -> None:
    seed = int.from_bytes(os.urandom(4))
    print("seed", seed)
    fuzzed = run("fuzz", "100000", str(seed))
    assert fuzzed.later.rss[-1] - fuzzed.later.rss[0] < 3.0
    text = page(fuzzed, fuzzed, seed, Said("9 passed", "none of 77", "5 % of a core"), "0123456")
    assert "| 100000 mutated frames" in text


@pytest.mark.alone
def test_none_is_lost_beside_eight_thousand_foreign_frames_a_second() -> None:
    assert line_rate(5.0, 8000).startswith("none of 7")
