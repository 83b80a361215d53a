"""The global search: an entry whose gradient is zero where it begins is found, sized and named."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from made_study import UDS1, Inline, study

from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.name.attempt import Begin, Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.contest import Outcome, contest
from faultline.analysis.discrepancy.name.global_search import TRIALS, search, spread
from faultline.analysis.discrepancy.name.search import descend
from faultline.analysis.discrepancy.name.work import Crew
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

JUMP = """schema = 1
[[effect]]
name = "jump"
statement = "the dosing valve passes more above a dose"
component = "dosing valve"
source = "made"
signature = "nothing below the dose"
[effect.parameter.g]
unit = "1"
description = "additional flow"
null = 0.0
spread = 0.2
min = 0.0
max = 1.0
[effect.parameter.d_0]
unit = "1"
description = "dose above which it does; it starts where no dose is"
value = 1.5
spread = 0.3
min = 0.02
max = 2.0
[[effect.change]]
where = ["q_dos", "A_dos"]
replace = "A_dos -> A_dos*(1 + g*max(dc_dose - d_0, 0))"
"""
T = np.linspace(0.0, 1.0, 101)
STRONG, BESIDE = np.array([False, True, False]), np.array([False, False, True])


class Threshold:
    """A likelihood and a problem at once: 10 x_0 + 100 x_1 max(t - 2 - x_2/2, 0) measured at t = 0 to 1.

    The threshold begins above all t. It cannot be run with strengths above `end`.
    """

    bounds = np.array([[-np.inf, 0.0, -5.0], [np.inf, np.inf, 5.0]])

    def __init__(self, strength: float, threshold: float, end: float = np.inf) -> None:
        self._y = 10.0 + 100.0 * strength * np.maximum(T - threshold, 0.0)
        self._end = end

    def left(self, _: object, x: Array) -> Array:
        """The differences (M,)."""
        if x[1] > self._end:
            raise InputError("no run")
        return np.asarray(self._y - 10.0 * x[0] - 100.0 * x[1] * np.maximum(T - 2.0 - 0.5 * x[2], 0.0))

    def slopes(self, _: object, x: Array) -> Array:
        """Their derivatives (M, 3)."""
        above = np.maximum(T - 2.0 - 0.5 * x[2], 0.0)
        return -np.column_stack([10.0 + 0.0 * T, 100.0 * above, -50.0 * x[1] * (above > 0.0)])


def searched(made: Threshold) -> Any:
    problem: Any = made
    return search(problem, problem, np.array([1.0, 0.0, 0.0]), STRONG | BESIDE, STRONG)


def test_where_the_gradient_is_zero_the_descent_stays_and_the_global_search_leads_it_to_the_optimum() -> None:
    made: Any = Threshold(0.5, 0.6)
    begin = np.array([1.0, 0.0, 0.0])
    assert (made.slopes(made, begin)[:, 1:] == 0.0).all()
    there = descend(made, made, begin)
    assert there.x[1:] == pytest.approx([0.0, 0.0])
    found = searched(made)
    best = descend(made, made, found.begins[0], 40)
    assert best.cost < there.cost - 300.0
    assert best.x[1] == pytest.approx(0.5, rel=0.1)
    assert 2.0 + 0.5 * best.x[2] == pytest.approx(0.6, abs=0.05)
    assert there.cost - best.cost > found.promised > 0.5 * (there.cost - best.cost)
    assert (found.tried, found.failed) == (TRIALS[1], 0)


def test_where_nothing_is_missing_no_size_promises_anything() -> None:
    found = searched(Threshold(0.0, 0.6))
    assert found.promised == pytest.approx(0.0, abs=1e-6)
    assert len(found.begins) == 0


def test_sizes_that_cannot_be_run_are_counted_and_the_others_lead_on() -> None:
    found = searched(Threshold(0.5, 0.6, end=0.1))
    assert 0 < found.failed < found.tried
    assert found.promised > 100.0
    none = searched(Threshold(0.5, 0.6, end=0.0))
    assert (none.failed, none.promised, len(none.begins)) == (none.tried, 0.0, 0)


@pytest.mark.parametrize(("lower", "upper"), [(0.0, np.inf), (-2.0, 2.0), (-np.inf, 0.0), (0.0, 1e-4)])
def test_sizes_are_of_all_orders_of_magnitude_within_the_bounds(lower: float, upper: float) -> None:
    made: Any = Threshold(0.0, 0.6)
    made.bounds = np.array([[-np.inf, lower, -1.0], [np.inf, upper, 1.0]])
    begin = np.array([0.3, 0.0, 0.0])
    trials = spread(made, begin, STRONG | BESIDE, STRONG)
    assert (trials >= made.bounds[0]).all()
    assert (trials <= made.bounds[1]).all()
    assert (trials[:, 0] == 0.3).all()
    sizes = trials[:, 1]
    assert (sizes != 0.0).all()
    assert {*np.sign(sizes).tolist()} == {side for side, end in ((-1.0, lower), (1.0, upper)) if end != 0.0}
    if upper > 1e-3:
        assert np.ptp(np.log10(np.abs(sizes))) > 2.5


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("library") / "own.toml"
    path.write_text(JUMP)
    return path


def contested(own: Path, size: float, entries: tuple[str, ...] = ("stiff_hose",)) -> tuple[Study, Outcome]:
    made = study(entries, {"full_open_gain": size} if size else {})
    found = Study(f"{made.key}+own", UDS1, {**made.library, **load_library(None, own)}, made.training, made.held)
    baseline = baseline_of(found)
    judge = Judge(found, baseline)
    nominal = judge.attempt(())
    location = judge.locate(nominal)
    begin = Begin(nominal.unknowns, location.x) if location.members else None
    crew = Crew(Inline(), found, baseline, None)
    return found, contest(crew, [*found.library], nominal, 0.0, lambda: begin, lambda *_: None, ["jump"])


def test_an_own_entry_that_begins_beyond_all_data_is_found_and_named(own: Path) -> None:
    """The wound: its gradient was zero where it began, it was "promised 0.0006 nats" and never fitted."""
    found, outcome = contested(own, 0.2)
    judge = Judge(found, baseline_of(found))
    direction = judge.direction("jump")
    assert np.abs(direction.does).max() < 1e-12
    assert [place.rivals for place in outcome.places] == [("jump",)]
    assert outcome.chosen.values["jump_d_0"] < 1.0
    tried = outcome.tried["jump"]
    assert (tried.sizes, tried.failed) == (TRIALS[1], 0)
    assert tried.promised > 30.0
    placed = judge.direction("jump", Begin(outcome.chosen.unknowns, outcome.chosen.x))
    assert placed.power[0] > 1.0


def test_where_nothing_is_missing_an_own_entry_is_searched_and_not_named(own: Path) -> None:
    _, outcome = contested(own, 0.0)
    assert outcome.places == ()
    tried = outcome.tried
    assert (tried["jump"].sizes, tried["stiff_hose"].sizes) == (TRIALS[1], 0)
    assert tried["jump"].promised < 10.0
