"""The page of `scarce` has a row for each length, and says what was refused."""

from typing import Any

from hybrid_page import METHODS
from scarce import MINUTES, page
from test_hybrid import row


def test_every_length_is_judged_and_a_refusal_is_said() -> None:
    right = [["fA_t", 1, 0.5, [], []]]
    judged = [row(method, "large", {"fA_t": 0.3}, right, ["t08"]) for method in METHODS]
    minutes: dict[str, Any] = {str(each): {"refused": None, "judged": judged} for each in MINUTES[1:]}
    minutes[str(MINUTES[0])] = {"refused": "train: 120 s are needed", "judged": []}
    told = page([{"vehicle": 961, "minutes": minutes, "wall_s": 1.0, "cpu_s": 1.0, "commit": "abc"}])
    assert told.count("detected | 1 of 1") == len(MINUTES) - 1
    assert "- truck-961, 2 minutes: train: 120 s are needed" in told
