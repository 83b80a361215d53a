"""Varied recordings are what the plant would have done with other inputs, where the equations are right."""

import numpy as np
import pytest
from made_samples import circuit, rc

from faultline.training.reckoned import Equations, Example, reckoned
from faultline.training.varied import varied

AMPLITUDE = 0.3


def examples() -> list[Example]:
    """Without noise: what the equations themselves say."""
    layout, equations = rc(), Equations(rc())
    [measured] = reckoned(layout, circuit(1, 1500), equations)
    [(x, y)] = equations.courses([measured.z])
    return [measured._replace(x=x, y=y)]


def test_states_and_predictions_move_as_the_equations_say() -> None:
    layout, equations = rc(), Equations(rc())
    [usual] = examples()
    found = varied(layout, [usual], equations, AMPLITUDE, 2, 0)
    assert len(found) == 2
    for example in found:
        [(x, y)] = equations.courses([example.z])
        assert example.x == pytest.approx(x)
        assert example.y == pytest.approx(y)
        assert not example.natural
    assert not np.array_equal(found[0].z, found[1].z)


def test_what_the_equations_do_not_know_stays() -> None:
    """An offset of the measured current is in the varied one as well."""
    layout, equations = rc(), Equations(rc())
    [usual] = examples()
    [plain] = varied(layout, [usual], equations, AMPLITUDE, 1, 0)
    [shifted] = varied(layout, [usual._replace(y=usual.y + 0.01)], equations, AMPLITUDE, 1, 0)
    assert shifted.y - plain.y == pytest.approx(np.full_like(plain.y, 0.01))


def test_signals_move_by_the_amplitude_slowly_and_within_their_region() -> None:
    layout, equations = rc(), Equations(rc())
    [usual] = examples()
    [found] = varied(layout, [usual], equations, AMPLITUDE, 1, 0)
    for column, name in enumerate(layout.signals):
        known, moved = layout.model.known[name], found.z[:, column] - usual.z[:, column]
        assert known.min <= found.z[:, column].min()
        assert found.z[:, column].max() <= known.max
        assert moved.std() == pytest.approx(AMPLITUDE * usual.z[:, column].std(), rel=0.3)
        assert np.diff(moved).std() < 0.3 * moved.std()


def test_the_same_seed_varies_the_same_and_none_are_none() -> None:
    layout, equations = rc(), Equations(rc())
    first, again = (varied(layout, examples(), equations, AMPLITUDE, 1, 3) for _ in range(2))
    assert np.array_equal(first[0].z, again[0].z)
    assert not varied(layout, examples(), equations, AMPLITUDE, 0, 3)
