"""Attempts made side by side and kept: the same wherever they are made, made once, and never taken for another's."""

import dataclasses
import socket
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from distributed import LocalCluster
from made_study import Inline, study
from made_threads import threads

from faultline.analysis import processes
from faultline.analysis.discrepancy.name import work
from faultline.analysis.discrepancy.name.attempt import Attempt, Baseline, Begin, Glance, Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.kept import keep, kept
from faultline.analysis.discrepancy.name.work import Crew, Order, workers
from faultline.service.core.errors import InputError

ENTRIES = ("full_open_gain", "offset_p_du")


class Counting(Inline):
    """Inline, and it counts; from the `last` on it is out of order."""

    def __init__(self, last: int = 99) -> None:
        self.calls, self._last = 0, last

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> "Future[Any]":
        if self.calls == self._last:
            raise KeyboardInterrupt
        self.calls += 1
        return super().submit(fn, *args, **kwargs)


@cache
def made() -> tuple[Study, Baseline, list[Order]]:
    found = study(ENTRIES, {"full_open_gain": 0.1})
    baseline = baseline_of(found)
    nominal = Judge(found, baseline).attempt(())
    begin = Begin(nominal.unknowns, nominal.x)
    return found, baseline, [Order((name,), begin) for name in ENTRIES]


def attempts(executor: Executor, folder: Path | None = None, of: Study | None = None) -> list[Attempt]:
    found, baseline, orders = made()
    return Crew(executor, of or found, baseline, folder).attempts(orders, lambda *_: None)


@cache
def inline() -> list[Attempt]:
    return attempts(Inline())


def same(one: Sequence[Attempt | Glance], other: Sequence[Attempt | Glance]) -> bool:
    return [msgspec.json.encode(a, enc_hook=np.ndarray.tolist) for a in one] == [
        msgspec.json.encode(a, enc_hook=np.ndarray.tolist) for a in other
    ]


def test_an_attempt_that_is_read_back_is_the_same(tmp_path: Path) -> None:
    [first, _] = inline()
    place = tmp_path / "new" / "first.json"
    keep(place, first)
    back = kept(place, Attempt)
    assert back is not None
    assert same([back], [first])
    for field in dataclasses.fields(Attempt):
        was, now = getattr(first, field.name), getattr(back, field.name)
        assert type(was) is type(now), field.name
        if isinstance(was, np.ndarray):
            assert (was.dtype, was.shape) == (now.dtype, now.shape), field.name
            assert (was == now).all(), field.name
    assert back.values == first.values
    assert back.spreads == first.spreads
    assert back.unknowns.theta_by_x(back.x) == pytest.approx(first.unknowns.theta_by_x(first.x), rel=1e-15)


def test_what_is_no_attempt_is_not_there(tmp_path: Path) -> None:
    place = tmp_path / "a.json"
    assert kept(place, Attempt) is None
    for text in ("", "{}", '{"effects": 3}', "\xff"):
        place.write_text(text, encoding="latin-1")
        assert kept(place, Attempt) is None, text


def test_what_cannot_be_kept_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FileExistsError, match=f"'{tmp_path}/file'"):
        keep(tmp_path / "file" / "first.json", inline()[0])


def test_an_interrupted_crew_does_only_what_is_missing(tmp_path: Path) -> None:
    heard: list[tuple[int, int]] = []
    found, baseline, orders = made()
    whole, rest = Counting(), Counting()
    first = Crew(whole, found, baseline, tmp_path).attempts(orders[:1], lambda *n: heard.append(n))
    again = Crew(rest, found, baseline, tmp_path).attempts(orders, lambda *n: heard.append(n))
    assert (whole.calls, rest.calls) == (1, 1)
    assert same(again, inline())
    assert same(again[:1], first)
    assert heard == [(0, 1), (1, 1), (1, 2), (2, 2)]
    third = Counting()
    assert same(attempts(third, tmp_path), inline())
    assert third.calls == 0


def test_a_glance_is_kept_beside_an_attempt_from_there(tmp_path: Path) -> None:
    found, baseline, orders = made()
    first, second = Counting(), Counting()
    glance = [dataclasses.replace(orders[0], steps=1)]
    [one] = Crew(first, found, baseline, tmp_path).glances(glance, lambda *_: None)
    [other] = Crew(second, found, baseline, tmp_path).glances(glance, lambda *_: None)
    assert same([one], [other])
    assert (first.calls, second.calls) == (1, 0)
    assert isinstance(Crew(second, found, baseline, tmp_path).attempts(orders[:1], lambda *_: None)[0], Attempt)
    further = [dataclasses.replace(orders[0], steps=2)]
    assert not same(Crew(second, found, baseline, tmp_path).glances(further, lambda *_: None), [one])
    assert second.calls == 2


def test_another_recording_or_library_entry_is_not_taken_for_this_one(tmp_path: Path) -> None:
    attempts(Inline(), tmp_path)
    found, _, _ = made()
    counting = Counting()
    attempts(counting, tmp_path, dataclasses.replace(found, key="another"))
    assert counting.calls == 2
    entry = found.library["full_open_gain"]
    [change] = entry.changes
    weaker = dataclasses.replace(change, replacement=change.replacement.replace("g*", "0.5*g*"))
    assert weaker != change
    other = {**found.library, "full_open_gain": dataclasses.replace(entry, changes=(weaker,))}
    [first, second] = attempts(counting, tmp_path, dataclasses.replace(found, library=other))
    assert counting.calls == 3  # the other entry is as it was
    assert first.values["full_open_gain_g"] == pytest.approx(2 * inline()[0].values["full_open_gain_g"], rel=0.1)
    assert same([second], inline()[1:])


def test_a_model_that_cannot_be_run_is_left_out_and_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, baseline, orders = made()
    whole = Judge.attempt

    def attempt(self: Judge, effects: Sequence[str], begin: Begin | None = None) -> Attempt:
        if "full_open_gain" in effects:
            raise InputError("the run leaves the range in which the model holds")
        return whole(self, effects, begin)

    monkeypatch.setattr(Judge, "attempt", attempt)
    heard: list[tuple[int, int]] = []
    crew = Crew(Inline(), found, baseline, tmp_path)
    [only] = crew.attempts(orders, lambda *n: heard.append(n))
    assert only.effects == ("offset_p_du",)
    assert crew.failures == {("full_open_gain",): "the run leaves the range in which the model holds"}
    assert heard[-1] == (2, 2)
    assert len([*tmp_path.iterdir()]) == 1


def test_directions_are_the_judges() -> None:
    found, baseline, _ = made()
    told = Crew(Inline(), found, baseline, None).directions(ENTRIES, {})
    for direction in told:
        assert (direction.visible == Judge(found, baseline).direction(direction.effect).visible).all()
    assert [direction.effect for direction in told] == [*ENTRIES]


def test_two_processes_come_to_the_same() -> None:
    with workers(None, 2) as executor:
        assert same(attempts(executor), inline())


def test_a_dask_cluster_comes_to_the_same() -> None:
    local = LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None)  # type: ignore[no-untyped-call]
    with local as cluster, workers(cluster.scheduler_address) as executor:
        assert same(attempts(executor), inline())
        other = study(("offset_p_du",), {})  # the cluster's process has a judge of another library with this key
        again = dataclasses.replace(other, key=made()[0].key)
        crew = Crew(executor, again, baseline_of(again), None)
        [found] = crew.attempts(made()[2][1:], lambda *_: None)
        assert found.effects == ("offset_p_du",)
        assert not same([found], inline()[1:])


@pytest.mark.parametrize("count", [0, -1])
def test_no_processes_are_refused(count: int) -> None:
    said = f"^--processes {count}: nobody would work; give at least 1$"
    with pytest.raises(InputError, match=said), workers(None, count):
        raise AssertionError


def test_an_address_where_nobody_answers_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "ANSWERS_S", 0.5)
    with socket.socket() as silent:  # bound, so that no other test's scheduler gets the port, and not listening
        silent.bind(("127.0.0.1", 0))
        port = silent.getsockname()[1]
        for address in (f"tcp://127.0.0.1:{port}", "nowhere", f"http://127.0.0.1:{port}"):
            said = f"^{address}: no Dask scheduler answers .*; check address and port$"
            with pytest.raises(InputError, match=said) as error, workers(address):
                raise AssertionError
            assert "\n" not in str(error.value)


def test_what_another_version_has_kept_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    attempts(Inline(), tmp_path)
    monkeypatch.setattr(work, "_code", lambda: "another version")
    counting = Counting()
    attempts(counting, tmp_path)
    assert counting.calls == len(ENTRIES)


def test_directions_leave_away_what_cannot_be_run(monkeypatch: pytest.MonkeyPatch) -> None:
    direction = Judge.direction

    def some(self: Judge, effect: str, place: Any = None) -> Any:
        if effect == ENTRIES[0]:
            raise InputError("it does not converge")
        return direction(self, effect, place)

    monkeypatch.setattr(Judge, "direction", some)
    found, baseline, _ = made()
    crew = Crew(Inline(), found, baseline, None)
    assert [d.effect for d in crew.directions(ENTRIES, {})] == [ENTRIES[1]]
    assert crew.failures == {(ENTRIES[0],): "it does not converge"}


def test_a_process_has_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in processes.THREADS:
        monkeypatch.delenv(name, raising=False)
    with workers(None, 1) as executor:
        assert executor.submit(threads).result() == 1
