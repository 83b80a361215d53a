"""Logs as columns against the same frames one by one: every value, age, quality, doubt and count is equal."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.service.core.j1939.identifiers import PRIORITY_MASK, SOURCE_MASK
from faultline.service.core.manifest import Bounds, Input, Mode, Modes
from faultline.service.core.residuals.evaluator import TickByTick
from faultline.service.core.residuals.generators import FRESH, Residuals
from faultline.service.core.residuals.observer import Observer, Tick
from faultline.service.core.signals.columns import CanSignals
from faultline.service.core.signals.decode import EXTENDED, STANDARD, DecodeTable
from faultline.service.core.signals.layout import Cut, Field, Layout, Only, Selector
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.sampling import Sampler
from faultline.service.core.signals.values import FloatArray, Mask
from faultline.service.logs import Frame
from faultline.service.logs.batch import Batch, batch_of

INF = float("inf")
STATE = ("value", "time", "quality", "doubted_until")
PERIODS = (0.01, 0.1, 0.25, 1.0)


class Case(NamedTuple):
    layouts: dict[tuple[int, bool], Layout]
    inputs: list[Input]
    frames: list[Frame]
    cuts: list[int]
    rows: int
    speed: float


@st.composite
def cuts(draw: st.DrawFn, size: int, longest: int = 64) -> Cut:
    length = draw(st.integers(1, min(longest, 8 * size)))
    return Cut(draw(st.integers(0, 8 * size - length)), length, draw(st.booleans()))


@st.composite
def fields(draw: st.DrawFn, name: str, size: int, only: Only) -> Field:
    is_float = draw(st.integers(0, 4)) == 0
    wide = 70 if draw(st.integers(0, 9)) == 0 else 64
    cut = draw(cuts(size, wide))
    if is_float:
        length = draw(st.sampled_from([each for each in (16, 32, 64) if each <= 8 * size] or [0]))
        is_float = length > 0
        cut = Cut(draw(st.integers(0, 8 * size - length)), length, cut.big_endian) if is_float else cut
    low, high = draw(st.sampled_from([(-INF, INF), (0.0, 100.0), (-5.0, 3.0), (2.0, INF), (-INF, 0.5)]))
    return Field(
        name=name,
        cut=cut,
        signed=draw(st.booleans()),
        is_float=is_float,
        scale=draw(st.sampled_from([1.0, 0.1, -0.5, 1e3, 0.0025, 1e300])),
        offset=draw(st.sampled_from([0.0, -7.0, 0.3])),
        low=low,
        high=high,
        only=only,
    )


@st.composite
def messages(draw: st.DrawFn, number: int, kind: str) -> tuple[tuple[int, bool], Layout]:
    is_29_bits = kind in ("sender", "any", "long")
    j1939 = is_29_bits or (kind == "standard" and draw(st.booleans()))
    size = {"long": draw(st.integers(9, 30)), "fd": draw(st.sampled_from([12, 64]))}.get(kind, draw(st.integers(1, 8)))
    group = draw(st.sampled_from([0xFF10, 0xF004, 0xEF00])) if is_29_bits else 0
    address = draw(st.sampled_from([0x3D, 0x21]))
    identifier = {"standard": 0x100 + number, "fd": 0x200 + number}.get(kind, group << 8 | address)
    identifier = 0x1000_0100 + number if kind == "extended" else identifier
    selector = Selector(draw(cuts(size, 4)), frozenset({0, 1, 2}), ())
    outer: Only = ((selector.cut, frozenset({1, 2})),)
    inner = Selector(draw(cuts(size, 4)), frozenset({0, 3}), outer)
    kinds: list[Only] = [(), (), outer, (*outer, (inner.cut, frozenset({0})))]
    names = [f"m{number}s{k}" for k in range(draw(st.integers(1, 3)))]
    mask = {"standard": STANDARD, "extended": EXTENDED, "fd": STANDARD}.get(kind, PRIORITY_MASK)
    layout = Layout(
        name=f"m{number}",
        identifier=identifier & ~SOURCE_MASK if kind == "any" else identifier,
        mask=mask & ~SOURCE_MASK if kind == "any" else mask,
        size=size,
        j1939=j1939,
        period_s=draw(st.sampled_from([None, *PERIODS])),
        fields=[draw(fields(name, size, draw(st.sampled_from(kinds)))) for name in names],
        selectors=(selector, inner) if draw(st.booleans()) else (),
    )
    return (
        layout.identifier | SOURCE_MASK if kind == "any" else layout.identifier,
        is_29_bits or kind == "extended",
    ), layout


@st.composite
def payloads(draw: st.DrawFn, size: int) -> bytes:
    """Mostly of a few values, so that they rest, repeat, jump and say that there is none."""
    length = draw(st.sampled_from([size] * 8 + [size - 1, min(64, size + 1), 8, 0]))
    few = st.sampled_from([0x00, 0x01, 0x02, 0x7F, 0xFB, 0xFE, 0xFF])
    return bytes(draw(st.lists(few, min_size=length, max_size=length)))


@st.composite
def sent(draw: st.DrawFn, layouts: Sequence[tuple[tuple[int, bool], Layout]]) -> list[tuple[int, bool, bytes]]:
    """The identifier and data of a frame, or of the frames of a message in parts."""
    (identifier, is_extended), layout = draw(st.sampled_from(layouts))
    source = draw(st.sampled_from([identifier & SOURCE_MASK] * 6 + [0x3D, 0x21, 0x07]))
    if layout.j1939 and is_extended:
        identifier = identifier & ~SOURCE_MASK | source | draw(st.sampled_from([6, 6, 6, 3])) << 26
    what = draw(st.sampled_from(["own"] * 12 + ["parts"] * 3 + ["claim", "foreign", "standard"]))
    if what == "claim":
        return [(0x18EEFF00 | source, True, draw(st.sampled_from([b"12345678", b"87654321", b"1"])))]
    if what == "foreign":
        return [(draw(st.integers(0, EXTENDED)), True, bytes(8))]
    if what == "standard":
        return [(identifier & STANDARD, False, bytes(8))]
    data = draw(payloads(layout.size))
    if what == "parts" and is_extended and len(data) > 8:
        return list(in_parts(identifier, data, draw(st.integers(0, 20)) == 0))
    return [(identifier, is_extended, data)]


def in_parts(identifier: int, data: bytes, is_damaged: bool) -> Iterator[tuple[int, bool, bytes]]:
    count = -(-len(data) // 7)
    group = (identifier >> 8 & 0x3FFFF).to_bytes(3, "little")
    yield 0x18ECFF00 | identifier & SOURCE_MASK, True, bytes([0x20, len(data), 0, count, 0xFF]) + group
    for k in range(count - is_damaged):
        yield 0x18EBFF00 | identifier & SOURCE_MASK, True, bytes([k + 1]) + data[7 * k : 7 * k + 7].ljust(7, b"\xff")


@st.composite
def inputs_of(draw: st.DrawFn, signals: Sequence[str]) -> list[Input]:
    return [
        Input(
            signal=name,
            unit="Pa",
            maximum_age_s=draw(st.sampled_from([0.3, 1.0, 5.0])),
            lower=0.0,
            upper=draw(st.sampled_from([3.0, 1e6])),
            frozen_s=draw(st.sampled_from([None, 0.5, 2.0])),
            largest_step=draw(st.sampled_from([None, 1.0, 100.0])),
        )
        for name in signals
    ]


@st.composite
def cases(draw: st.DrawFn) -> Case:
    all_kinds = ["standard", "extended", "fd", "sender", "any", "long"]
    kinds = draw(st.lists(st.sampled_from(all_kinds), min_size=1, max_size=4))
    layouts = [draw(messages(n, kind)) for n, kind in enumerate(kinds)]
    by_key = dict(layouts)
    inputs = draw(inputs_of([name for layout in by_key.values() for name in layout.signals]))
    t, frames = draw(st.sampled_from([0.0, 1e9])), list[Frame]()
    steps = st.sampled_from([0.0, 0.001, 0.01, 0.05, 0.1, 0.1, 0.25, 0.25, 1.0, 3.0, -0.05])
    for _ in range(draw(st.integers(1, 60))):
        t += draw(steps)
        for can_id, is_extended, data in draw(sent([*by_key.items()])):
            frames.append(Frame(t, can_id, is_extended, data))
            t += draw(st.sampled_from([0.0, 0.001]))
    at = sorted(draw(st.lists(st.integers(0, len(frames)), max_size=4)))
    return Case(by_key, inputs, frames, at, draw(st.sampled_from([1, 10, 1000])), draw(st.sampled_from([1.0, 5.0])))


class Blind:
    def step(self, z: FloatArray, usable: Mask, ages: FloatArray = FRESH) -> Residuals:
        none = np.zeros(0)
        return Residuals(none, none, none, np.zeros(0, dtype=np.bool_))


def observer(case: Case) -> tuple[DecodeTable, Sampler, Observer]:
    table, sampler = DecodeTable(case.layouts), Sampler(case.inputs)
    table.run_at(case.speed)
    first = case.inputs[0].signal
    steady = [Mode(name="low", where={first: Bounds(below=0.1)}), Mode(name="rest")]
    modes = Modes(steady=steady, edges={first: 0.1}, settle_s=0.4)
    return table, sampler, Observer(table, sampler, TickByTick(Blind(), ModeTracker(modes, case.inputs, 0.2)), 0.2, 1.0)


def pieces(case: Case) -> list[Batch]:
    ends = [0, *case.cuts, len(case.frames)]
    return [batch_of(case.frames[begin:end]) for begin, end in pairwise(ends)]


def shown(tick: Tick, sampler: Sampler) -> str:
    found = tick.number, tick.t_s, tick.z.tolist(), tick.quality.tolist(), tick.ages.tolist(), tick.mode
    return repr((found, dict(sampler.new_doubts())))  # NaN equals NaN


def counts(table: DecodeTable) -> dict[str, object]:
    parts = table.parts
    lost = {} if parts is None else {"complete": parts.complete, "losses": parts.losses, "open": parts.unfinished}
    return asdict(table.rejected) | {"taken": table.taken, "repeated": table.repeated, "senders": table.senders} | lost


@settings(max_examples=100, deadline=None)
@given(cases())
def test_a_log_as_columns_gives_what_its_frames_give_one_by_one(case: Case) -> None:
    both_alike(case)


def both_alike(case: Case) -> DecodeTable:
    """Check that a log gives the same both ways; return the table of its frames."""
    table, sampler, one = observer(case)
    expected: list[str] = []
    for frame in case.frames:
        expected += [shown(tick, sampler) for row in one.frame(*frame) for tick in row]
    expected += [shown(tick, sampler) for row in one.advance(one.now + 3.0) for tick in row]
    other_table, other_sampler, other = observer(case)
    found = [
        shown(tick, other_sampler)
        for piece in CanSignals(other_table, lambda: pieces(case), case.rows).pieces()
        for row in other.take(piece)
        for tick in row
    ]
    found += [shown(tick, other_sampler) for row in other.advance(other.now + 3.0) for tick in row]
    assert found == expected
    assert counts(other_table) == counts(table)
    states = [[repr(getattr(each, name)) for name in STATE] for each in other_sampler.inputs]
    assert states == [[repr(getattr(each, name)) for name in STATE] for each in sampler.inputs]
    return table


def plain(name: str, shift: int, length: int = 8) -> Field:
    return Field(name, Cut(shift, length, big_endian=False), False, False, 0.5, 0.0, -INF, INF)


STEADY = {
    (0x00FF103D, True): Layout("own", 0x00FF103D, PRIORITY_MASK, 8, True, 0.2, [plain("a", 0), plain("b", 8, 16)]),
    (0x00F004FE, True): Layout("any", 0x00F00400, PRIORITY_MASK & ~SOURCE_MASK, 4, True, 0.1, [plain("c", 0)]),
    (0x00FF2021, True): Layout("long", 0x00FF2021, PRIORITY_MASK, 20, True, 0.5, [plain("d", 64), plain("e", 140, 10)]),
    (0x123, False): Layout("std", 0x123, STANDARD, 8, False, 0.05, [plain("f", 3, 7)]),
}


def steady(rng: np.random.Generator, seconds: float = 60.0) -> list[Frame]:
    """Messages in their periods, and what may happen to them, each somewhere and for some time."""
    frames: list[Frame] = []
    for (identifier, is_extended), layout in STEADY.items():
        assert layout.period_s is not None
        can_id = identifier & ~SOURCE_MASK | 0x3D if layout.is_from_any else identifier
        value = rng.integers(0, 200)
        for t in np.arange(rng.uniform(0.0, 1.0), seconds, layout.period_s) + rng.uniform(-0.01, 0.01):
            change = rng.choice(["rests"] * 10 + ["walks"] * 5 + ["jumps", "none"])
            value = {"rests": value, "walks": (value + 1) % 200, "jumps": rng.integers(0, 250), "none": value}[change]
            data = bytes([0xFF if change == "none" else value]) * layout.size
            events = [(t, can_id, data)]
            if rng.random() < 0.02:
                events.append((t + rng.uniform(0.0, 0.02), can_id, data))
            if 20.0 < t < 40.0 and rng.random() < 0.05:
                events.append((t + rng.uniform(0.0, layout.period_s), can_id, bytes(layout.size)))
            if t > 50.0 and is_extended and rng.random() < 0.1:
                events.append((t, can_id ^ 0x1C, data))
            if 15.0 < t < 18.0 and rng.random() < 0.5:
                events = [(18.0, can_id, data)] if rng.random() < 0.5 else []
            if rng.random() < 0.01:
                events.append((t + 0.01, can_id, data[:-1]))
            for at, number, content in events:
                whole = [(number, is_extended, content)]
                parts = in_parts(number, content, rng.random() < 0.05) if len(content) > 8 else whole
                frames += [Frame(float(at) + 0.001 * k, *part) for k, part in enumerate(parts)]
    frames += [Frame(t, 0x18EEFF3D, True, bytes([k]) * 8) for k, t in enumerate(np.sort(rng.uniform(0.0, seconds, 4)))]
    return sorted(frames, key=lambda frame: frame.t)


@pytest.mark.parametrize("seed", range(12))
def test_a_minute_of_steady_messages_with_all_that_may_happen_to_them_gives_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    signals = [name for layout in STEADY.values() for name in layout.signals]
    inputs = [
        Input(signal=name, unit="Pa", maximum_age_s=1.0, lower=0.0, upper=90.0, frozen_s=1.0, largest_step=5.0)
        for name in signals
    ]
    frames = steady(rng)
    cut = sorted(rng.integers(0, len(frames), 6).tolist())
    table = both_alike(Case(STEADY, inputs, frames, cut, int(rng.choice([1, 200, 5000])), 1.0))
    rejected = table.rejected
    happened = rejected.early, rejected.short, rejected.unclear, rejected.claimed, sum(table.repeated.values())
    assert all(happened), (seed, happened)
