"""Networks that err more than their equations on drives that no training saw, or run away, are left out."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import numpy.typing as npt

from faultline.analysis.tuning.thresholds import Seen
from faultline.analysis.tuning.unfit import AWAY, OUTDONE, unfit
from faultline.analysis.tuning.vehicles import Drive, Vehicle
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import TimeScale

Array = npt.NDArray[np.float64]
NAMES = ("t1.ode", "t1.rnn", "t2.rnn")
PROMISED = 100.0
K = 400


def vehicle(*drives: Array, edge: Array | None = None) -> Vehicle:
    """Drives of one mode, whose residuals (K, 3) these are; those of an edge that comes first besides."""
    made = []
    for r in drives:
        every = r if edge is None else np.vstack([edge, r])
        mode = np.repeat([EDGE, 1], [len(every) - len(r), len(r)])
        usable = np.ones(every.shape, dtype=np.bool_)
        seen = Seen("d", np.zeros((len(every), 1)), every, usable, mode, ("edge", "idle"), TimeScale(0.2, 20.0))
        made.append(cast(Drive, SimpleNamespace(seen=seen)))
    generators = [SimpleNamespace(name=name, test=name[:2]) for name in NAMES]
    networks = SimpleNamespace(
        description=SimpleNamespace(generators=generators[1:], error=[PROMISED, PROMISED]), graph=b""
    )
    runnable = SimpleNamespace(generators=generators, networks=networks, units=["Pa"] * 3)
    return cast(Vehicle, SimpleNamespace(runnable=runnable, drives=made))


def noise(*size: float, off: float = 0.0) -> Array:
    return np.random.default_rng(4).normal(0.0, size, (K, 3)) + off


def test_a_network_no_worse_than_the_equations_stays() -> None:
    assert unfit(vehicle(noise(100.0, 1.1 * 100.0, 100.0))) == {}


def test_one_that_is_worse_is_left_out_with_the_reason() -> None:
    found = unfit(vehicle(noise(100.0, (OUTDONE + 0.3) * 100.0, 100.0)))
    assert [*found] == ["t1.rnn"]
    assert "times as much as the equations" in found["t1.rnn"]


def test_where_a_drive_lies_is_no_error() -> None:
    """The decision takes it off; five times what training promised is what drives may be apart."""
    drives = [noise(100.0, 100.0, 100.0, off=off) for off in (-5 * PROMISED, 5 * PROMISED)]
    assert unfit(vehicle(*drives)) == {}


def test_edges_are_not_looked_at() -> None:
    assert unfit(vehicle(noise(100.0, 100.0, 100.0), edge=np.full((50, 3), (0.0, 1e6, 1e6)))) == {}


def test_one_that_runs_away_is_left_out_with_equations_and_without() -> None:
    far = noise(100.0, 100.0, 100.0) + np.array([0.0, 1e9, 2.0 * AWAY * PROMISED])
    found = unfit(vehicle(far))
    assert [*found] == ["t1.rnn", "t2.rnn"]
    assert all(why.endswith("it runs away") for why in found.values())


def test_what_is_no_number_runs_away() -> None:
    r = noise(100.0, 100.0, 100.0)
    r[-1, 2] = np.nan
    assert [*unfit(vehicle(r))] == ["t2.rnn"]
