"""Messages in other phases: as if their ECU had begun its cycle at another instant."""

from collections.abc import Iterator

import numpy as np
import pytest

from faultline.service.core.signals.received import Received, column_of
from faultline.service.core.signals.values import Quality
from faultline.service.logs import Frame
from faultline.training.phases import PHASES, STARTS, Start, _share, starts

FAST, SLOW = 1, 2
PERIODS = {FAST: 0.1, SLOW: 0.2}
BAD = b"bad"


class Ramps:
    """Signals: every message says the time at which it was sent, that of FAST as `a`, that of SLOW as `b`."""

    def __init__(self, frames: list[Frame]) -> None:
        self._frames = frames

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        """Yield all of them, in two pieces."""
        del judged
        middle = len(self._frames) // 2
        for part in (self._frames[:middle], self._frames[middle:]):
            items: dict[str, list[tuple[int, float, int]]] = {}
            for row, frame in enumerate(part):
                if frame.can_id in PERIODS:
                    is_bad = frame.data == BAD
                    value, quality = (0.0, Quality.NOT_AVAILABLE) if is_bad else (float(frame.data), Quality.GOOD)
                    items.setdefault("a" if frame.can_id == FAST else "b", []).append((row, value, int(quality)))
            if part:
                time = np.array([frame.t for frame in part])
                columns = {name: column_of(each) for name, each in items.items()}
                yield Received(time[0], time[-1], time, time, columns)

    def strangers(self) -> list[str]:
        """Return nothing."""
        return []


def frames(which: tuple[int, ...] = (FAST, SLOW), lost: float = -1.0, bad: float = -1.0) -> list[Frame]:
    found = [Frame(0.005, 99, True, b"other traffic")]
    for can_id in which:
        for k in range(50):
            t_s = round(0.02 + 0.037 * can_id + k * PERIODS[can_id], 6)
            if can_id == SLOW or abs(t_s - lost) > 1e-3:
                found.append(Frame(t_s, can_id, True, BAD if abs(t_s - bad) < 1e-3 else f"{t_s}".encode()))
    return sorted(found, key=lambda frame: frame.t)


def sent(start: Start, can_id: int) -> list[tuple[float, float, Quality]]:
    """Time, value and quality of every message of an identifier."""
    [piece] = start.pieces()
    column = piece.columns["a" if can_id == FAST else "b"]
    worth = zip(piece.time[column.row].tolist(), column.value.tolist(), column.quality.tolist(), strict=True)
    return [(t, value, Quality(quality)) for t, value, quality in worth]


def test_a_moved_message_says_what_was_between() -> None:
    found = [*starts(Ramps(frames()))]
    assert len(found) == PHASES * STARTS
    for start in found:
        for can_id in PERIODS:
            assert all(value == pytest.approx(t_s, abs=1e-9) for t_s, value, _ in sent(start, can_id))


def test_messages_lie_otherwise_to_each_other_and_the_slowest_stays() -> None:
    found = [*starts(Ramps(frames()))]
    phases = {round((sent(start, FAST)[0][0] - sent(start, SLOW)[0][0]) % 0.1, 4) for start in found}
    assert len(phases) == PHASES
    slow = {round(sent(start, SLOW)[0][0] % 0.2, 4) for start in found}
    assert len(slow) == 1
    assert sum(start.natural for start in found) == STARTS


def test_switched_on_at_instants_of_the_slowest_period() -> None:
    natural = [start for start in starts(Ramps(frames())) if start.natural]
    firsts = [next(start.pieces()).first_s for start in natural]
    assert firsts == sorted(firsts)
    assert firsts[-1] - firsts[0] < 0.2 + 1e-9
    assert len({*firsts}) > 2


def test_nothing_is_made_up_where_a_message_was_lost() -> None:
    """Beside the gap a moved message repeats a neighbour."""
    moved = [start for start in starts(Ramps(frames(lost=1.057))) if not start.natural]
    for start in moved:
        values = np.array([(t_s, value) for t_s, value, _ in sent(start, FAST)])
        beside = values[np.abs(values[:, 0] - 1.057) < 0.1]
        assert len(beside)
        assert {round(value, 3) for value in beside[:, 1]} <= {0.957, 1.157}


@pytest.mark.parametrize("late_s", [0.0995, 0.1])
def test_a_late_message_makes_no_value_that_never_was(late_s: float) -> None:
    """The wound: a message just before the next one, or of the same instant, was drawn out to a spike."""
    found = [f._replace(t=f.t + late_s) if abs(f.t - 1.057) < 1e-3 else f for f in frames()]
    for start in starts(Ramps(sorted(found, key=lambda frame: frame.t))):
        values = [value for t_s, value, _ in sent(start, FAST) if abs(t_s - 1.1) < 0.2]
        assert min(values) > 0.85
        assert max(values) < 1.35


def test_three_messages_lie_otherwise_each_to_each() -> None:
    shares = {(part, rank): _share(part, rank) for part in range(PHASES) for rank in range(4)}
    assert all(abs(share) <= 0.5 for share in shares.values())
    for one in range(4):
        for other in range(one):
            apart = {round((shares[part, one] - shares[part, other]) % 1.0, 3) for part in range(PHASES)}
            assert len(apart) == PHASES


def test_what_is_not_available_stays_so() -> None:
    for start in starts(Ramps(frames(bad=1.057))):
        qualities = [quality for t_s, _, quality in sent(start, FAST) if abs(t_s - 1.057) < 0.05]
        assert Quality.NOT_AVAILABLE in qualities
        assert 0.0 not in {value for _, value, quality in sent(start, FAST) if quality is Quality.GOOD}


def test_one_message_alone_is_not_moved() -> None:
    found = [*starts(Ramps(frames((SLOW,))))]
    assert len(found) == STARTS
    assert all(start.natural for start in found)


def test_a_log_without_signals_has_starts_without_frames() -> None:
    assert all(not [*start.pieces()] for start in starts(Ramps([Frame(0.0, 99, True, b"")])))
