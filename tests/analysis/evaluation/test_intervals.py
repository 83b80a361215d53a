"""Exact intervals against published values, closed forms and the probabilities that define them."""

import math

import pytest
from scipy.stats import binom, poisson

from faultline.analysis.evaluation.measure.intervals import rate, share


def test_a_share_has_the_published_interval() -> None:
    """Clopper and Pearson for 10 of 20 and 4 of 20, from tables of the binomial distribution."""
    half, fifth = share(10, 20), share(4, 20)
    assert half.p == 0.5
    assert [half.low, half.high, fifth.low, fifth.high] == pytest.approx([0.27196, 0.72804, 0.05733, 0.43661], abs=1e-5)


@pytest.mark.parametrize(("hits", "trials"), [(1, 5), (3, 7), (19, 20), (50, 131)])
def test_at_each_end_of_the_interval_the_count_is_a_tail_of_a_fortieth(hits: int, trials: int) -> None:
    found = share(hits, trials)
    assert binom.sf(hits - 1, trials, found.low) == pytest.approx(0.025)
    assert binom.cdf(hits, trials, found.high) == pytest.approx(0.025)


def test_none_and_all_have_an_open_side() -> None:
    none, everything = share(0, 10), share(10, 10)
    assert (none.p, none.low, everything.p, everything.high) == (0.0, 0.0, 1.0, 1.0)
    assert [none.high, everything.low] == pytest.approx([1 - 0.025**0.1, 0.025**0.1])


def test_without_trials_nothing_is_known() -> None:
    found = share(0, 0)
    assert (found.p, found.low, found.high) == (None, 0.0, 1.0)


@pytest.mark.parametrize(("events", "hours"), [(1, 2.0), (4, 0.5), (30, 100.0)])
def test_at_each_end_of_a_rate_the_count_is_a_tail_of_a_fortieth(events: int, hours: float) -> None:
    found = rate(events, hours)
    assert found.high is not None
    assert found.per_hour == events / hours
    assert poisson.sf(events - 1, found.low * hours) == pytest.approx(0.025)
    assert poisson.cdf(events, found.high * hours) == pytest.approx(0.025)


def test_no_event_bounds_the_rate_and_no_hour_does_not() -> None:
    assert rate(0, 10.0).high == pytest.approx(-math.log(0.025) / 10.0)
    assert (rate(0, 0.0).per_hour, rate(0, 0.0).high) == (None, None)
