"""A sample of the campaign: some kills, and what was told to whom."""

import os
from pathlib import Path

import pytest
from alarmed import killed
from alarms import page


@pytest.mark.waits
def test_nothing_is_lost_through_kills(tmp_path: Path) -> None:
    seed = int.from_bytes(os.urandom(4))
    print("seed", seed)
    outcome = killed(tmp_path, 5, seed, records=6)
    logs = "\n".join(path.read_text() for path in sorted(tmp_path.glob("*.log")))
    assert len({*outcome.stored}) == len(outcome.stored) >= 6
    for kind in outcome.heard:
        assert outcome.missing(kind) == 0, f"{kind}: {logs}"
        assert outcome.unknown(kind) == 0, f"{kind}: {logs}"
    for kind in ("socket", "SSE"):
        ids = [each.id for each in outcome.heard[kind]]
        assert ids == outcome.stored, f"{kind}: each once and in order, as it asked for what came after"
    assert "0 lost" in page(outcome, outcome, seed, "0123456", 60.0)
