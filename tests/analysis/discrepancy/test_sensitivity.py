"""What can be seen at all: directions less what others can do, smallest sizes, look-alikes, and the law of chance."""

import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.discrepancy.name.sensitivity import (
    Direction,
    alike,
    chance,
    remaining,
    smallest,
    smallest_sizes,
)

Array = npt.NDArray[np.float64]
M, BLOCK, ENOUGH = 800, 8, 10.0


def direction(name: str, visible: Array, low: float = -1e3, high: float = 1e3, spread: float = 1.0) -> Direction:
    count = visible.shape[1]
    return Direction(name, visible, visible, np.full(count, low), np.full(count, high), np.full(count, spread))


def test_what_others_can_do_does_not_remain() -> None:
    rng = np.random.default_rng(1)
    others = np.linalg.qr(rng.standard_normal((M, 4)))[0] * 1e3
    apart = np.linalg.qr(np.column_stack([others, rng.standard_normal((M, 1))]))[0][:, -1:]
    assert remaining(others[:, :1] / 50.0, others) == pytest.approx(0.0, abs=1e-3)
    assert remaining(apart, others) == pytest.approx(apart, abs=1e-9)
    assert remaining(5.0 * apart + others @ rng.standard_normal((4, 1)), others) == pytest.approx(5.0 * apart, abs=1e-3)


def test_what_others_do_only_weakly_is_left_in_part() -> None:
    """What is unknown has a prior: it is as the covariance of the data, with all else integrated out, has it."""
    rng = np.random.default_rng(2)
    others, d = rng.standard_normal((40, 3)), rng.standard_normal((40, 2))
    assert remaining(d, others) == pytest.approx(np.linalg.solve(np.eye(40) + others @ others.T, d))
    assert remaining(d, np.zeros((40, 0))) == pytest.approx(d)


@pytest.mark.parametrize("power", [2.0, 10.0, 300.0])
def test_a_size_is_visible_when_its_evidence_is_expected_above_the_threshold(power: float) -> None:
    rng = np.random.default_rng(3)
    v = rng.standard_normal((50, 1))
    v *= np.sqrt(power) / np.linalg.norm(v)
    size = smallest(direction("a", v, spread=0.02), 8.0) / 0.02
    pulled = (size * v + rng.standard_normal((50, 4000))).T @ v
    evidence = 0.5 * pulled**2 / (power + 1.0) - 0.5 * np.log(power + 1.0)
    assert np.mean(evidence) == pytest.approx(8.0, abs=1.0)


def test_what_is_beyond_the_bounds_cannot_be_seen() -> None:
    v = np.full((4, 1), 0.5)
    needed = smallest(direction("a", v), ENOUGH)
    assert np.isfinite(needed)
    assert smallest(direction("a", v, 0.0, 1.01 * needed), ENOUGH) == needed
    assert smallest(direction("a", v, 0.0, 0.99 * needed), ENOUGH) == np.inf
    assert smallest(direction("a", v, -1.01 * needed, 0.0), ENOUGH) == needed
    blind = direction("blind", np.zeros((4, 1)))
    assert smallest_sizes([direction("a", v), blind], ENOUGH) == {"a": needed, "blind": np.inf}


def test_alike_is_in_the_metric_of_what_remains() -> None:
    """What shares only a part that others can do as well is not alike, and what differs only in that is."""
    others = 1e3 * np.eye(4)[:, :1]
    one, same, other = np.array([[5.0, -5.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]).T[:, :, None]
    made = [
        Direction(name, d, remaining(d, others), *(np.full(1, x) for x in (-9.0, 9.0, 1.0)))
        for name, d in (("one", one), ("same", same), ("other", other))
    ]
    assert alike(made) == {"one": ("same",), "same": ("one",), "other": ()}


def test_alike_is_what_has_the_same_direction_either_way() -> None:
    a = np.eye(3)[:, :1]
    made = {
        "a": a,
        "larger": 40.0 * a,
        "opposite": -a,
        "near": a + 0.15 * np.eye(3)[:, 1:2],
        "apart": a + 0.5 * np.eye(3)[:, 1:2],
        "either": np.column_stack([np.eye(3)[:, 2], a]),
        "blind": 0.0 * a,
    }
    found = alike([direction(name, v) for name, v in made.items()])
    assert found["a"] == ("larger", "opposite", "near", "either")
    assert "a" in found["either"]
    assert found["apart"] == found["blind"] == ()


def law(visible: Array, noises: Array, low: float, high: float) -> float:
    """The 99 % quantile of the best effect's evidence for draws (draws, M) of what a right model leaves."""
    power = np.sum(visible**2, axis=0) + 1.0
    g = noises @ visible
    size = np.clip(g / power, low, high)
    evidence = g * size - 0.5 * power * size**2 - 0.5 * np.log(power)
    return float(np.quantile(np.maximum(np.where(size != 0.0, evidence, 0.0).max(axis=1), 0.0), 0.99))


@pytest.mark.parametrize("low", [-np.inf, 0.0])
@pytest.mark.parametrize("within", [0.0, 0.7])
def test_the_law_of_chance_is_that_of_the_noise_that_there_is(low: float, within: float) -> None:
    """Larger than unit, or alike within blocks; effects that may go either way, or one way only."""
    rng = np.random.default_rng(4)
    visible = rng.standard_normal((M, 12)) * np.geomspace(0.03, 1.0, 12)
    block = np.arange(M) // BLOCK

    def noise() -> Array:
        return 3.0 * (rng.standard_normal(M) + within * rng.standard_normal(M // BLOCK)[block])

    direct = law(visible, np.array([noise() for _ in range(4000)]), low, np.inf)
    assert direct > 2 * ENOUGH
    directions = [direction(str(k), visible[:, k : k + 1], low, np.inf) for k in range(12)]
    told = [chance(directions, noise(), block) for _ in range(5)]
    assert np.mean(told) == pytest.approx(direct, rel=0.2)


def test_chance_brings_more_with_more_noise_and_the_same_each_time() -> None:
    rng = np.random.default_rng(5)
    d, left, block = direction("a", rng.standard_normal((M, 2))), rng.standard_normal(M), np.arange(M) // BLOCK
    assert chance([], left, block) == 0.0
    assert chance([d], 0.1 * left, block) < 1.0 < ENOUGH < chance([d], 3.0 * left, block)
    assert chance([d], 3.0 * left, block) == chance([d], 3.0 * left, block)
