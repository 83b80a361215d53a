"""What the campaign calls lost. A boot of the guest is too long for `make test`, which cuts one in tests/guest."""

from typing import Any

from power import KINDS, Life, Outcome, page

RECORDS: list[dict[str, Any]] = [
    {"id": f"a-{seq}", "seq": seq, "schema": "faultline.event/1", "transition": "occurred"} for seq in (1, 2, 3)
]


def outcome(**heard: list[dict[str, Any]]) -> Outcome:
    everybody = {kind: heard.get(kind, [*RECORDS]) for kind in KINDS}
    return Outcome([*RECORDS], everybody, [Life(3.0, dict.fromkeys(KINDS, 3), 1, 0)], [], [])


def test_what_comes_twice_is_not_lost() -> None:
    again = outcome(MQTT=[*RECORDS, RECORDS[2]])
    assert again.figures("MQTT") == (4, 1, 0, 0, 0)
    assert again.lost == 0
    assert "**1 cuts of 1 guests, 3 records in the store: 0 lost.**" in page([again], 1, "0123456", 60.0)


def test_what_one_of_them_never_heard_or_the_store_forgot_is_lost() -> None:
    assert outcome(SSE=RECORDS[:2]).figures("SSE") == (2, 0, 1, 0, 0)
    assert outcome(socket=[*RECORDS, {**RECORDS[0], "id": "a-4"}]).figures("socket") == (4, 0, 0, 1, 0)
    assert outcome(socket=[*RECORDS[:2], {**RECORDS[2], "seq": 4}]).figures("socket") == (3, 0, 0, 0, 1)
    assert outcome(SSE=[]).lost == 3
    assert outcome()._replace(stored=[RECORDS[0], RECORDS[2]]).gaps == 1
