"""docs/mqtt.md says what the code does."""

import re
from pathlib import Path

import pytest

from faultline import writing
from faultline.service.mqtt import broker, outbox, progress, puback_policy, throttled
from faultline.service.mqtt.cloudevent import CONTENT_TYPE, DIGITS
from faultline.service.mqtt.daemon import RETRY_S
from faultline.service.mqtt.topics import LEVEL

PAGE = (Path(__file__).parents[3] / "docs" / "mqtt.md").read_text()


def row(begin: str) -> str:
    """The first cell of the table's row that begins so."""
    found = [line for line in PAGE.splitlines() if line.startswith(f"| {begin}")]
    assert len(found) == 1, found
    return found[0].split("|")[1]


@pytest.mark.parametrize(
    ("begin", "codes"),
    [("0x00", puback_policy.TAKEN), ("0x90", puback_policy.OF_THE_MESSAGE), ("0x80", puback_policy.OF_THE_MOMENT)],
)
def test_every_reason_code_is_in_its_row(begin: str, codes: dict[int, str]) -> None:
    assert {int(code, 16) for code in re.findall(r"0x[0-9A-Fa-f]{2}", row(begin))} == set(codes)


def test_the_names_of_codes_are_those_that_are_said() -> None:
    named = re.findall(r"(0x[0-9a-f]{2}) ([a-z][a-z ]+[a-z])", PAGE.partition("| code |")[2])
    assert len(named) > 4
    assert [puback_policy.name_of(int(code, 16)) for code, _ in named] == [name for _, name in named]


def test_numbers_are_those_of_the_code() -> None:
    page = PAGE.replace("\n", " ")
    said = {
        "for five minutes": puback_policy.PATIENCE_S == 300,
        "a hundred are read ahead": outbox.WINDOW == 100,
        "| 20 in flight": outbox.IN_FLIGHT == 20,
        "the next twenty one by one": outbox.IN_FLIGHT == 20,
        "are 1 s, twice as long each time, 60 s at most": broker.RETRY_S == (1, 60),
        f"looked for every {RETRY_S[0]:g} to {RETRY_S[1]:g} s": True,
        "the same once a minute at most": throttled.SAID_S == 60,
        f"in {DIGITS} digits": True,
        "three are left": writing.ASIDE == 3,
        "half a second": progress.KEPT_S == 0.5,
        f"tried every {progress.RETRY_S:.0f} s": True,
        f"most {LEVEL} of them": True,
        f"`{CONTENT_TYPE}`": True,
    }
    assert [text for text in said if text not in page] == []
    assert [text for text, holds in said.items() if not holds] == []
