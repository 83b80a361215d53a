"""Ticks in a row are decided as one after the other: what an event says is the same at every tick."""

from itertools import pairwise

import numpy as np
import pytest
from test_decision import NAMES, NOTHING_BROUGHT, OF_PATTERNS, OFFSET, ROWS, SCALE, moved, usual
from uds_time import IDLE, MAXIMUM

from faultline.service.core.decision.decision import Decision
from faultline.service.core.decision.telling import Teller
from faultline.service.core.records.line import encode
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import Indices

SIZES = [(each.fault, each.size) for each in OF_PATTERNS.evidence.hypotheses]
TICKS = 4000


def drive(seed: int) -> tuple[Indices, Residuals]:
    """Modes and residuals of a drive with faults that come and go, noise, and tests that cannot tell for a while."""
    rng = np.random.default_rng(seed)
    cuts = np.sort(rng.choice(TICKS, 60, replace=False))
    modes = np.zeros(TICKS, dtype=np.int64)
    rows = []
    fault, size = None, 0.0
    for begin, end in pairwise([0, *cuts.tolist(), TICKS]):
        if rng.random() < 0.15:
            fault, size = (
                (None, 0.0) if fault else (str(rng.choice(["fA_du", "fq_leak", "fy_p_ap"])), rng.uniform(0.1, 1.0))
            )
        mode = int(rng.integers(EDGE, MAXIMUM + 1))
        modes[begin:end] = mode
        r = OFFSET[:, mode] + 0.3 * SCALE[:, mode] * rng.standard_normal((end - begin, len(NAMES)))
        if fault and mode != EDGE:
            r[:, ROWS] += moved(fault, size, mode)
        usable = np.tile(rng.random(len(NAMES)) < 0.98, (end - begin, 1))
        shift = np.array([moved(name, abs(of), mode or IDLE) for name, of in SIZES])
        n = len(r)
        rows.append(
            Residuals(
                r,
                np.tile(usual(mode), (n, 1)),
                np.tile(SCALE[:, mode], (n, 1)),
                usable,
                np.tile(shift, (n, 1, 1)),
                np.tile(NOTHING_BROUGHT, (n, 1)),
                held=rng.random(r.shape) < 0.01,
            )
        )
    r, y_hat, sigma, usable, shift, brought = map(np.concatenate, zip(*(each[:6] for each in rows), strict=True))
    held = np.concatenate([each.held for each in rows])
    return modes, Residuals(r, y_hat, sigma, usable, shift, brought, held=held)


@pytest.mark.parametrize("seed", range(6))
def test_they_are_decided_as_one_by_one(seed: int) -> None:
    modes, residuals = drive(seed)
    one, many = Decision(OF_PATTERNS), Decision(OF_PATTERNS)
    events: tuple[list[bytes], list[bytes]] = [], []
    tellers = [Teller("truck", "b" * 64, OF_PATTERNS.time) for _ in range(2)]
    at_once, done = 0, 0
    while done < TICKS:
        most = 1 if tellers[1].waits else 64
        ticks = many.extend(done, modes[done : done + most], residuals.part(done, done + most))
        for tick in range(done, done + ticks):
            one.update(tick, int(modes[tick]), residuals.at(tick))
            events[0].extend(map(encode, tellers[0].update(tick, one)))
        done += ticks
        events[1].extend(map(encode, tellers[1].update(done - 1, many)))
        at_once = max(at_once, ticks)
        assert events[1] == events[0]
        np.testing.assert_array_equal(many.sums, one.sums)
        np.testing.assert_array_equal(many.level, one.level)
        assert (many.suspicious, many.since, many.named) == (one.suspicious, one.since, one.named)
    assert at_once > 10
    assert len(events[0]) > 3
