"""Frames that come too early for one sender: any phase of a second one, and none of jitter, stalls and slow clocks."""

from collections.abc import Iterable, Sequence
from math import exp

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.core.signals.arrivals import (
    EARLY,
    JITTER_S,
    LATE,
    REPEATED,
    Arrival,
    Arrivals,
    _after,
    known_jitter,
)

T = 0.2


def judged(times: Iterable[float], own: Sequence[bytes] = (), speed: float = 1.0) -> list[str]:
    """How frames of these times came; each has bytes of its own unless `own` gives them."""
    arrivals = Arrivals(T)
    arrivals.speed = speed
    return [arrivals.judge(t, own[k] if own else k.to_bytes(8, "big")).name for k, t in enumerate(times)]


def on_time(count: int) -> np.ndarray:
    return T * np.arange(count, dtype=np.float64)


@pytest.mark.parametrize("seed", range(20))
def test_jitter_of_20_ms_makes_no_frame_early(seed: int) -> None:
    times = np.sort(on_time(5000) + np.random.default_rng(seed).uniform(-0.02, 0.02, 5000))
    assert set(judged(times)) == {"DUE"}, seed


@pytest.mark.parametrize("seed", range(20))
def test_a_repeating_gateway_is_no_second_sender_and_a_constant_value_is_no_repetition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = on_time(2000) + rng.uniform(-0.02, 0.02, 2000)
    both = np.concatenate([times, times + rng.uniform(1e-4, 0.02, 2000)])
    order = np.argsort(both)
    came = judged(both[order], [bytes([k % 2000 % 7]) for k in order])
    assert (came.count("DUE"), came.count("REPEATED")) == (2000, 2000), seed
    assert set(judged(times, [bytes(8)] * 2000)) == {"DUE"}


@pytest.mark.parametrize("phase", [0.001, 0.03, 0.08, 0.1, 0.12, 0.17, 0.199])
@pytest.mark.parametrize("every", [1, 2, 8, 60])
def test_a_second_sender_is_seen_with_its_first_frame_or_the_next_genuine_one(phase: float, every: int) -> None:
    """Whatever its phase: a frame more in a period leaves some interval below half of it."""
    times = on_time(1000)
    forged = times[100::every] + phase
    came = judged(np.sort(np.concatenate([times, forged])))
    early = [k for k, each in enumerate(came) if each == "EARLY"]
    assert early[0] in (101, 102)
    if abs(phase - T / 2) > (0.5 - EARLY) * T:
        assert len(early) >= len(forged) - 1  # the last one has no genuine frame after it


@pytest.mark.parametrize("phase", [0.001, 0.06, 0.08, 0.1, 0.12])
@pytest.mark.parametrize("slower", [1.025, 1.05, 1.09])
def test_a_clock_slower_than_the_dbcs_grants_a_forger_nothing(slower: float, phase: float) -> None:
    """The wound: at 1.05 periods, forged frames 75 to 90 ms later were all believed."""
    rng = np.random.default_rng(1)
    times = slower * on_time(1000) + rng.uniform(-0.005, 0.005, 1000)
    assert set(judged(times)) == {"DUE"}
    came = judged(np.sort(np.concatenate([times, times[100::8] + phase])))
    early = [k for k, each in enumerate(came) if each == "EARLY"]
    assert early
    assert early[0] <= 100 + 3 * 9, "in the first seconds"


def test_a_sender_that_was_held_up_catches_up() -> None:
    times = on_time(200)
    for stall in (0.15, 0.5, 3.0, 20.0):
        held = np.where((times >= 10.0) & (times < 10.0 + stall), 10.0 + stall, times)
        assert set(judged(np.sort(held))) == {"DUE"}, stall


@pytest.mark.parametrize("period", [0.13, 0.19, 0.21, 0.4])
def test_another_cycle_time_than_the_dbc_says_is_no_second_sender(period: float) -> None:
    assert set(judged(period * np.arange(2000))) == {"DUE"}


def test_a_clock_that_is_slow_grants_a_forger_no_credit_that_grows() -> None:
    """4 % slow: each interval is a delay of 8 ms, which a CUSUM that never forgets adds up to a frame of credit."""
    times = 1.04 * on_time(2000)
    forged = times[1000::8] + 0.001
    came = judged(np.sort(np.concatenate([times, forged])))
    assert came.count("EARLY") == len(forged)


def test_at_twenty_times_real_time_a_stall_of_a_second_is_twenty_of_log_time() -> None:
    times = on_time(400)
    late = np.where((times >= 30.0) & (times < 50.0), 50.0 + 0.02 * (times - 30.0), times)
    assert set(judged(np.sort(late), speed=20.0)) == {"DUE"}


def test_what_waited_for_the_beginning_is_not_early_nor_is_a_log_that_begins_anew() -> None:
    arrivals = Arrivals(T)
    for _ in range(3):
        came = [arrivals.judge(t, bytes([k])) for k, t in enumerate([0.0] * 20 + [T * k for k in range(1, 50)])]
        assert set(came) == {Arrival.DUE}


def test_the_same_bytes_after_a_quarter_of_the_period_are_a_second_sender() -> None:
    came = judged([*on_time(200), 199 * T + 1.01 * REPEATED * T], [bytes(8)] * 201)
    assert came[-1] == "EARLY"


def after(period_s: float, frames: Iterable[tuple[float, bytes]], speed: float = 1.0) -> list[str]:
    """How frames come after a long time of one frame a period, the last of them at time 0."""
    arrivals = Arrivals(period_s)
    arrivals.speed = speed
    for k in range(-1000, 1):
        assert arrivals.judge(k * period_s, b"own") is not Arrival.EARLY
    return [arrivals.judge(t, data).name for t, data in frames]


def test_other_bytes_at_the_same_time_are_a_second_senders_and_no_new_log() -> None:
    assert after(0.25, [(0.0, b"forged")]) == ["EARLY"]


def test_a_repetition_comes_within_a_quarter_of_the_period_or_the_jitter_but_never_after_half_of_it() -> None:
    assert after(0.25, [(0.0624, b"own")]) == ["REPEATED"]
    assert after(0.25, [(0.0625, b"own")]) == ["EARLY"]
    assert after(1.0 / 64.0, [(0.0078, b"own")]) == ["REPEATED"]
    assert after(1.0 / 64.0, [(1.0 / 128.0, b"own")]) == ["DUE"]


def test_a_delay_of_a_quarter_of_the_period_excuses_an_early_frame_and_a_shorter_one_does_not() -> None:
    assert after(0.25, [(0.3125, b"a"), (0.4125, b"b")]) == ["DUE", "DUE"]
    assert after(0.25, [(0.3124, b"a"), (0.4124, b"b")]) == ["DUE", "EARLY"]


@pytest.mark.parametrize(("speed", "quiet_s", "came"), [(5.0, 5.0, "DUE"), (5.0, 50.0, "EARLY"), (1.0, 5.0, "EARLY")])
def test_a_delay_is_forgotten_within_seconds_of_real_time(speed: float, quiet_s: float, came: str) -> None:
    """20 s of log time late; what catches up `quiet_s` later is excused by what is left of it."""
    late = [(21.0 + k, b"own") for k in range(round(quiet_s) + 1)]
    assert after(1.0, [*late, *((late[-1][0] + 0.001 * k, b"%d" % k) for k in (1, 2, 3))], speed)[-1] == came


@pytest.mark.parametrize(("speed", "early"), [(1.0, True), (5.0, False)])
def test_a_queue_that_is_emptied_at_the_beginning_may_hold_ten_seconds_of_real_time(speed: float, early: bool) -> None:
    assert ("EARLY" in judged([0.001 * k for k in range(200)], speed=speed)) is early


DELAYS = st.lists(st.sampled_from([0.0, 0.0, 0.0, -0.3, -0.05, -1e-9, 1e-9, 0.04, 0.6, 2.5]), max_size=60)


@given(st.sampled_from([0.0, 1e-9, 0.5, 7.0]), DELAYS)
def test_the_backlog_after_many_frames_is_that_after_each(backlog: float, delays: list[float]) -> None:
    expected = backlog
    for late in delays:
        expected = max(0.0, expected) * exp(-0.2) + late
    assert _after(backlog, np.full(len(delays), -0.2), np.array(delays)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("speed", [1.0, 5.0])
@pytest.mark.parametrize("seed", range(30))
def test_frames_at_once_are_judged_as_one_by_one_also_at_the_limits(seed: int, speed: float) -> None:
    """Intervals lie on every limit of the rule and a millionth to either side of it, and stalls are between them."""
    rng = np.random.default_rng(seed)
    jitter = JITTER_S * speed
    near, early, late = max(REPEATED * T, jitter), max(EARLY * T, jitter), max(LATE * T, jitter)
    limits = np.array([min(near, T / 2.0), T / 2.0, T - early, T + late, T, 2.0 * T, 1e-3, 3.0])
    around = limits[:, None] + np.array([-1e-6, 0.0, 1e-6])
    dt = np.concatenate([rng.choice(around.ravel(), 200), np.full(100, T), rng.uniform(0.0, 2.0 * T, 100)])
    rng.shuffle(dt)
    times = np.cumsum(dt)
    own = rng.integers(0, 2, len(times))
    one, all_at_once = Arrivals(T), Arrivals(T)
    one.speed = all_at_once.speed = speed
    expected = [one.judge(t, bytes([k])) for t, k in zip(times.tolist(), own.tolist(), strict=True)]
    begin, found = 0, []
    for end in (*sorted(rng.integers(1, len(times), 3).tolist()), len(times)):
        part = slice(begin, end)
        same = np.concatenate([[False], own[part][1:] == own[part][:-1]])
        due, early_ones = all_at_once.judge_all(times[part], same, lambda k, b=begin: bytes([own[b + k]]))  # type: ignore[misc]
        found += list(zip(due.tolist(), early_ones.tolist(), strict=True))
        begin = end
    assert found == [(came is Arrival.DUE, came is Arrival.EARLY) for came in expected], seed


def jittery(count: int, seed: int = 1) -> np.ndarray:
    """Frames every 100 ms, each up to 40 ms before or after its time, as another author's plant sends them."""
    return 0.1 * np.arange(count) + np.random.default_rng(seed).uniform(-0.04, 0.04, count)


def test_a_sender_whose_jitter_is_known_is_not_doubted() -> None:
    """Of its drives 40 % of the ticks were lost to doubts, as each lasts 10 s."""
    shown = known_jitter(jittery(5000), 0.1)
    assert 0.07 < shown <= 0.1
    for bears in (False, True):
        arrivals = Arrivals(0.1)
        arrivals.jitter_s = shown if bears else 0.0
        came = {arrivals.judge(t, b"%d" % k) for k, t in enumerate(jittery(5000, 2))}
        assert (Arrival.EARLY not in came) is bears


def test_known_jitter_is_borne_by_frames_at_once_as_by_one() -> None:
    times = jittery(3000, 3)
    one, many = Arrivals(0.1), Arrivals(0.1)
    one.jitter_s = many.jitter_s = 0.055
    expected = [one.judge(t, bytes(1)) for t in times.tolist()]
    due, early = many.judge_all(times, np.ones(len(times), np.bool_), lambda _: bytes(1))
    assert due.tolist() == [each is Arrival.DUE for each in expected]
    assert early.tolist() == [each is Arrival.EARLY for each in expected]


def test_little_jitter_needs_no_word_and_a_second_sender_shows_none() -> None:
    small = T * np.arange(1000) + np.random.default_rng(1).uniform(-0.02, 0.02, 1000)
    assert known_jitter(small, T) == 0.0
    assert known_jitter(np.sort(np.concatenate([small, small[::8] + 0.03])), T) == 0.0
    assert known_jitter(small[:50], T) == 0.0
