"""Dirt is where it is said to be, and as much of it; the page counts what drives with it tell."""

from typing import Any

import numpy as np
import pytest
from dirty import DIRTS, MESSAGES, PART, Dirt, page

from faultline.testbench.traffic import Frame

COUNT = 4000


def sent(signal: str) -> list[Frame]:
    """Frames of the signal's message, with all of its signals in the middle of their range, and others between."""
    message = next(m for m in MESSAGES if any(s.name == signal for s in m.signals))
    data = bytes(
        message.encode({s.name: (float(s.minimum or 0.0) + float(s.maximum or 0.0)) / 2 for s in message.signals})
    )
    other = Frame(0.0, message.frame_id + 1, data)
    return [f for k in range(COUNT) for f in (Frame(0.2 * k, message.frame_id, data), other._replace(t=0.2 * k))]


@pytest.mark.parametrize("dirt", DIRTS, ids=lambda d: f"{d.signal}-{d.burst}-{d.amplitude}")
def test_a_part_of_one_signals_samples_is_off_and_nothing_else(dirt: Dirt) -> None:
    clean = sent(dirt.signal)
    found = list(dirt.on(clean, np.random.default_rng(1)))
    assert [f._replace(data=b"") for f in found] == [f._replace(data=b"") for f in clean]
    message = next(m for m in MESSAGES if any(s.name == dirt.signal for s in m.signals))
    off = [k for k, (a, b) in enumerate(zip(clean, found, strict=True)) if a.data != b.data]
    assert 0.6 * PART * COUNT < len(off) < 1.5 * PART * COUNT
    for k in off:
        before, after = (message.decode(f.data, decode_choices=False) for f in (clean[k], found[k]))
        assert isinstance(before, dict)
        assert isinstance(after, dict)
        assert {name for name in before if before[name] != after[name]} == {dirt.signal}


def drive(fault: str, dirt: list[Any] | None, *events: tuple[float, str, list[Any]]) -> dict[str, Any]:
    return {"fault": fault, "onset_s": 150.0 if fault else 420.0, "dirt": dirt, "events": [*events]}


def test_the_page_counts_what_is_made_and_what_is_hidden() -> None:
    alone, burst = ["y_p_ap", 1, "large"], ["n_p", 5, "small"]
    told = (160.0, "occurred", [["fA_du", 1, 0.9, [], []]])
    drives = [
        drive("", None),
        drive("", alone, (20.0, "occurred", [["fA_t", 1, 0.9, [], []]])),
        drive("", burst),
        drive("fA_du", None, told),
        drive("fA_du", alone, (170.0, "occurred", told[2])),
        drive("fA_du", burst, (160.0, "occurred", [["fA_ori", 1, 0.9, [], []]])),
    ]
    record = {"vehicle": 1, "refused": None, "drives": drives, "wall_s": 60.0, "commit": "abc"}
    text = page([record])
    assert "| a fault made of it | none | 1 of 4" in text
    assert "| a fault hidden by it | none | 1 of 2" in text
    assert "| y_p_ap | 0 of 0; 0 of 0 | 0 of 0; 0 of 0 | 1 of 2; 0 of 1 |" in text
