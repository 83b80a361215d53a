"""Exact confidence intervals of counts: a probability from trials, a rate from events in a time.

Both invert the tails of the distribution itself, so they hold for few events and for none: Clopper and Pearson (1934)
for the binomial distribution, Garwood (1936) for the Poisson distribution. Intervals are two-sided; where *at most* is
said, the bound is one-sided. They take blocks and events as independent,
which those of one recording are not quite: read them as the least that is open.

Quantiles are taken from `scipy.special`, as everywhere here: `scipy.stats` gives the same, and takes half a second of
every command to import.
"""

import msgspec
from scipy.special import betaincinv, gammaincinv

CONFIDENCE = 0.95


class Share(msgspec.Struct, frozen=True):
    """`hits` of `trials`; `p` is their quotient (None without trials), `low` and `high` the exact 95 % interval."""

    hits: int
    trials: int
    p: float | None
    low: float
    high: float


class Rate(msgspec.Struct, frozen=True):
    """`events` in `hours`; `per_hour` is their quotient (None without hours), `low`, `high` the exact 95 % interval.

    Without hours nothing bounds the rate: `high` is None.
    """

    events: int
    hours: float
    per_hour: float | None
    low: float
    high: float | None


def share(hits: int, trials: int) -> Share:
    """The probability behind `hits` of `trials`, by Clopper and Pearson.

    >>> share(0, 10).high.__round__(4)  # 1 - 0.025 ** (1 / 10)
    0.3085
    """
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(betaincinv(hits, trials - hits + 1, tail)) if hits else 0.0
    high = float(betaincinv(hits + 1, trials - hits, 1.0 - tail)) if hits < trials else 1.0
    return Share(hits, trials, hits / trials if trials else None, low, high)


def at_most(events: int, hours: float) -> float | None:
    """The rate [1/h] that is exceeded in one case of twenty: one-sided, so that no event in T hours gives 3/T.

    >>> at_most(0, 2.0).__round__(4)  # -log(0.05) / 2
    1.4979
    """
    return float(gammaincinv(events + 1, CONFIDENCE)) / hours if hours > 0.0 else None


def rate(events: int, hours: float) -> Rate:
    """The rate behind `events` in `hours`, by Garwood.

    >>> rate(0, 2.0).high.__round__(4)  # -log(0.025) / 2
    1.8444
    """
    if hours <= 0.0:
        return Rate(events, 0.0, None, 0.0, None)
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(gammaincinv(events, tail)) / hours if events else 0.0
    high = float(gammaincinv(events + 1, 1.0 - tail)) / hours
    return Rate(events, hours, events / hours, low, high)
