"""Hypotheses beside the residuals: what each would do to them in the operation of the moment."""

import numpy as np

from faultline.service.core.residuals.assumed import Assumed
from faultline.service.core.signals.values import FloatArray

OWNER = np.array([0, 0, 1])
ALL = np.ones(2, dtype=np.bool_)


class Made:
    """Two hypotheses of two generators with three states: x counts ticks, r is z of the moment less the hypothesis."""

    def __init__(self) -> None:
        self.broken: int | None = None
        self.seen: list[list[float]] = []  # the states of the first hypothesis, tick by tick

    def __call__(self, **arrays: FloatArray) -> list[FloatArray]:
        z, x = arrays["z"], arrays["x"]
        self.seen.append(x[0].tolist())
        r = z[:, :2] - np.array([[1.0, 2.0], [10.0, 20.0]])
        following = x + 1.0
        if self.broken is not None:
            following[self.broken] = np.nan
        return [r, r, r, following]


def test_the_shift_is_the_residual_less_what_it_would_be_under_the_fault() -> None:
    assumed = Assumed(Made(), 2, OWNER)
    shift = assumed.step(np.array([5.0, 6.0, 7.0]), np.zeros(3), np.array([5.0, 6.0]), ALL)
    assert shift.tolist() == [[1.0, 2.0], [10.0, 20.0]]


def test_states_move_with_their_generator_and_begin_again_with_it() -> None:
    graph = Made()
    assumed = Assumed(graph, 2, OWNER)
    z, r, first = np.zeros(3), np.zeros(2), np.array([True, False])
    assumed.step(z, np.zeros(3), r, first)
    assumed.step(z, np.zeros(3), r, first)
    assumed.restart(first, np.array([7.0, 8.0, 9.0]))
    assumed.step(z, np.zeros(3), r, ALL)
    assert graph.seen == [[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [7.0, 8.0, 0.0]]


def test_a_hypothesis_that_cannot_be_computed_shifts_nothing_and_begins_again_from_the_sensors() -> None:
    graph = Made()
    assumed = Assumed(graph, 2, OWNER)
    z, r, fresh = np.array([5.0, 6.0, 7.0]), np.array([5.0, 6.0]), np.array([3.0, 3.0, 3.0])
    graph.broken = 1
    assert assumed.step(z, fresh, r, ALL).tolist() == [[1.0, 2.0], [0.0, 0.0]]
    graph.broken = None
    assert assumed.step(z, fresh, r, ALL).tolist() == [[1.0, 2.0], [10.0, 20.0]]
