"""A network's error beyond the usual: its residual weighs less, in detectors, in the window and in the filter."""

import numpy as np
import pytest

from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel
from faultline.service.core.decision.baseline_level import BaselineLevel
from faultline.service.core.decision.blocks import BlockMeans
from faultline.service.core.decision.model_error import ALIKE, MOST, ModelError
from faultline.service.core.decision.straying import Straying
from faultline.service.core.decision.window import Window
from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import TimeScale

TIME = TimeScale(period_s=0.2, settling_s=20.0)
NAMES = ["t1.rnn", "t2.ode"]
MODE = 1


def evidence() -> Evidence:
    """Two generators in a mode, of which the first says how large its error is: 3 usually, 5 at the edge."""
    return Evidence(
        generators=NAMES,
        offset=[[0.0, 0.0]] * 2,
        spread=[[1.0, 1.0]] * 2,
        noise=[[[1.0, 0.0], [0.0, 1.0]]] * 2,
        visit=[[[0.0, 0.0], [0.0, 0.0]]] * 2,
        allowance=[[0.1, 0.1]] * 2,
        drifts=[],
        operation=[[0.0, 0.0]] * 2,
        followers=[],
        graph=None,
        hypotheses=[],
        sigma={"t1.rnn": [5.0, 3.0]},
    )


def tick(sigma: float, r: float = 8.0) -> Residuals:
    """Both residuals are `r`."""
    both = np.full(2, r)
    told = Residuals(both, 0.0 * both, np.array([sigma, 99.0]), np.ones(2, dtype=np.bool_))
    return ModelError(evidence(), NAMES).beside(MODE, told)


def test_what_is_usual_has_no_excess_and_what_says_nothing_has_none_either() -> None:
    assert tick(3.0).excess.tolist() == [0.0, 0.0]
    assert tick(5.0).excess.tolist() == [ALIKE**2 * 16.0, 0.0]
    nothing = np.zeros(2)
    there = Residuals(nothing, nothing, nothing, np.ones(2, dtype=np.bool_))
    assert ModelError(evidence(), NAMES).beside(0, there._replace(sigma=np.full(2, 5.0))).excess.max() == 0.0
    assert ModelError(evidence(), ["other", "t2.ode"]).beside(MODE, there) is there


def test_who_knows_nothing_cannot_tell() -> None:
    assert tick(3.0 * MOST).usable.tolist() == [True, True]
    assert tick(3.01 * MOST).usable.tolist() == [False, True]


def test_detectors_see_a_residual_in_parts_of_its_error() -> None:
    known = BaselineLevel(evidence(), NAMES, BaselineModel(evidence(), TIME))
    usual, unsure = (known.taken_off(MODE, np.full(2, 8.0), tick(sigma).excess) for sigma in (3.0, 5.0))
    assert unsure[1] == usual[1]
    assert unsure[0] == pytest.approx(8.0 / np.hypot(8.0 / usual[0], ALIKE * 4.0))


def deviations(sigma: float, ticks: int) -> FloatArray:
    """How many standard deviations the means (K,) of a window are."""
    window = Window(evidence(), NAMES, TIME)
    for _ in range(ticks):
        window.add(MODE, tick(sigma))
    straying = Straying(evidence())
    spread = np.sqrt(straying.scatter(window.means).diagonal())
    return np.asarray(straying.deviation(window.means)[0] / spread)


def test_no_number_of_ticks_makes_a_mean_surer_than_the_network_is() -> None:
    usual, unsure = deviations(3.0, 400), deviations(5.0, 400)
    assert unsure[1] == usual[1] > 80.0
    assert unsure[0] == pytest.approx(8.0 / (ALIKE * 4.0), rel=0.01)


def test_the_baseline_does_not_follow_what_the_network_does_not_know() -> None:
    found = []
    for sigma in (3.0, 20.0):
        blocks, baseline = BlockMeans(evidence(), NAMES, TIME), BaselineFilter(BaselineModel(evidence(), TIME))
        for k in range(300):
            if (block := blocks.add(k, MODE, tick(sigma, 0.2))) is not None:
                baseline.step(block)
        found.append(baseline.state.mean[0, :2])
    assert found[1][0] < 0.1 * found[0][0]
    assert found[1][1] == pytest.approx(found[0][1])
