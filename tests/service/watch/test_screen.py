"""The screen shows what is known, fits any terminal, and lets nothing of others onto it but what can be printed."""

import re
from typing import Any

import msgspec
import pytest
from watched_service import FAULTY, STATE, SYSTEM, TICK

from faultline.service.protocol.answers import ServiceState
from faultline.service.protocol.live import LiveTick, SystemDescription
from faultline.service.watching.lines import Look
from faultline.service.watching.screen import screen
from faultline.service.watching.table import bar
from faultline.service.watching.view_model import ViewModel

SIZES = [(80, 24), (40, 20), (200, 60), (20, 5), (1, 1)]


def seen(tick: dict[str, Any] | None = None, **fields: Any) -> ViewModel:
    known: dict[str, Any] = {
        "connection": "live",
        "state": msgspec.convert(STATE, ServiceState),
        "system": msgspec.convert(SYSTEM, SystemDescription),
        "tick": None if tick is None else msgspec.convert(tick, LiveTick),
        "events": ("210.0 s  FAULT; 1. fA_du",),
    }
    return ViewModel(**{**known, **fields})


def text(shown: ViewModel, columns: int = 80, rows: int = 24, look: Look = Look()) -> str:  # noqa: B008
    lines = screen(shown, columns, rows, look)
    assert len(lines) <= rows
    assert all(len(line) <= columns for line in lines) or look.colour
    return "\n".join(lines)


@pytest.mark.parametrize(("columns", "rows"), SIZES)
@pytest.mark.parametrize("tick", [None, TICK, FAULTY])
def test_it_fits(columns: int, rows: int, tick: dict[str, Any] | None) -> None:
    text(seen(tick), columns, rows)
    text(seen(tick), columns, rows, Look(unicode=False)).encode("ascii")


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (40, 20), (200, 60)])
def test_the_verdict_the_alarm_and_what_is_live_are_on_every_screen(columns: int, rows: int) -> None:
    shown = text(seen(FAULTY), columns, rows)
    assert shown.startswith("LIVE  truck-17  uds")
    assert "FAULT fA_du (dosing unit filter)" in shown
    assert "▶ t02" in shown
    assert "ALARM" in shown
    assert "y_p_ap" in shown  # the condition
    assert "9.012 bar" in shown


def test_a_fault_is_told_with_what_is_known_of_it() -> None:
    shown = text(seen(FAULTY), 100, 40)
    assert "FAULT fA_du (dosing unit filter), or 1 more; cannot tell: t05" in shown
    assert " 1.  p = 0.700  fA_du (dosing unit filter)  filter clogged" in shown
    assert "fA_du or fy_p_du: told apart by t05 (cannot tell now)" in shown
    assert "! y_p_ap has not changed for longer than a sensor can, since 2026-03-01T10:00:00Z" in shown
    assert "y_p_du    9.012 bar good  pred 8.980 to 9.034" in shown
    assert "*fA_du" in shown  # the candidate's column
    row = next(line for line in shown.splitlines() if line.startswith("▶ t02"))
    assert "██████│████··" in row or "████████████│███████·····" in row
    assert "+1.60" in row
    assert row.count("■") == 2
    blind = next(line for line in shown.splitlines() if line.startswith("  t05"))
    assert "cannot tell" in blind
    assert blind.count("?") == 1
    assert "event  210.0 s  FAULT; 1. fA_du" in shown


def test_verdicts_never_look_alike() -> None:
    quiet = text(seen(TICK)).splitlines()[1]
    blind = text(seen(TICK | {"cannot_tell": ["t02"]})).splitlines()[1]
    suspected = text(seen(TICK | {"anomaly": True})).splitlines()[1]
    alarmed = text(seen(TICK | {"anomaly": True, "alarm": ["t02"]})).splitlines()[1]
    nothing = text(seen(None, connection="waiting", why="nothing has come yet")).splitlines()[1]
    assert quiet == "no fault: every test is quiet"
    assert blind == "cannot tell: no alarm, but t02 cannot tell"
    assert suspected == "suspected and not confirmed: the residuals together have changed"
    assert alarmed == "suspected and not confirmed: alarm of t02"
    assert nothing == "cannot tell: no live values"


def test_unknown_faults_say_where_they_are() -> None:
    diagnoses = [{"faults": [], "rank": 1, "p": None, "near": ["e03"]}]
    shown = text(seen(FAULTY | {"diagnoses": diagnoses, "separating": []}))
    assert "FAULT unknown, near e03 (flow of the pump)" in shown
    assert "p = ?" in shown


def test_away_shows_no_value() -> None:
    shown = text(seen(None, connection="away", why="/run/c: No such file; trying again"))
    assert shown.splitlines()[0].startswith("AWAY  truck-17  uds")
    assert "/run/c: No such file; trying again" in shown
    assert "NO VALUE" in shown
    assert "9.012" not in shown
    assert "no fault" not in shown
    assert "y_p_ap" not in shown  # a condition that stood then
    shown = text(ViewModel(connection="away", why="connecting"))
    assert [each for each in shown.splitlines() if each] == ["AWAY", "cannot tell: no live values", "connecting"]


def test_values_that_are_not_known_have_a_place_and_a_word() -> None:
    nothing = [None, None]
    tick = TICK | {"z": nothing, "quality": ["not_available", "late"], "y_hat": nothing, "sums": nothing}
    shown = text(seen(tick))
    assert "y_p_du        - bar NOT AVAILABLE  pred -" in shown
    assert "LATE" in shown
    short = TICK | {"z": [], "quality": [], "y_hat": [], "usable": [], "sums": []}  # fewer than the system has
    assert "y_p_du        - bar ?" in text(seen(short))


HOSTILE = [
    *("x" * 5000, "\x1b[2J\x1b]0;owned\x07", "\r\n\n\t\x00\x7f\x9b", "\u202e\u2066\u200f\u200b"),
    *("\u4e2d\u6587" * 40, "e" + "\u0301" * 50, "\ud800"),
]


@pytest.mark.parametrize("hostile", HOSTILE)
@pytest.mark.parametrize(("columns", "rows"), SIZES)
def test_nothing_that_is_told_moves_the_cursor(hostile: str, columns: int, rows: int) -> None:
    """Every text that comes from elsewhere."""
    system = {
        "name": hostile,
        "bundle": hostile,
        "period_s": 0.2,
        "inputs": [{"signal": hostile, "unit": hostile}],
        "generators": [{"test": hostile, "predicts": hostile, "faults": [hostile]}],
        "faults": [{"name": hostile, "component": hostile, "description": hostile}],
        "equations": [{"name": hostile, "description": hostile}],
    }
    standing = {"kind": hostile, "of": hostile, "since": hostile}
    state = STATE | {"source": hostile, "systems": [{"name": hostile}] * 2, "conditions": [standing]}
    tick = FAULTY | {"mode": hostile, "quality": [hostile], "alarm": [hostile], "cannot_tell": [hostile]}
    unknown = {"faults": [], "rank": 1, "p": 0.5, "near": [hostile]}
    tick["diagnoses"] = [{"faults": [hostile], "rank": 1, "p": 0.5}, unknown]
    tick["separating"] = [{"between": [[hostile], [hostile]], "telling": [hostile], "waiting": [hostile]}]
    given: dict[str, Any] = {
        "state": msgspec.convert(state, ServiceState),
        "system": msgspec.convert(system, SystemDescription),
        "events": (hostile,),
    }
    for shown in (seen(tick, **given), seen(None, connection="away", why=hostile, **given)):
        lines = screen(shown, columns, rows)
        assert len(lines) <= rows
        assert all(len(line) <= columns for line in lines)
        assert all(line.isprintable() for line in lines)
        assert not set("\u4e2d\u6587\u0301\ud800") & set("".join(lines))
        "\n".join(screen(shown, columns, rows, Look(unicode=False))).encode("ascii")
        coloured = "".join(screen(shown, columns, rows, Look(colour=True)))
        assert re.sub(r"\x1b\[[0-9;]*m", "", coloured).isprintable()


def test_colours_are_only_where_there_may_be_any() -> None:
    assert "\x1b" not in text(seen(FAULTY))
    coloured = screen(seen(FAULTY), 80, 24, Look(colour=True))
    assert any("\x1b[1;31m" in line for line in coloured)
    assert [line.count("\x1b[") % 2 for line in coloured] == [0] * len(coloured)  # each is ended


def test_many_tests_are_cut_and_those_that_alarm_stay() -> None:
    names = [f"t{k:02d}" for k in range(80)]
    generators = [{"test": name, "predicts": "y_p_du", "faults": ["fA_du"]} for name in names]
    tick = TICK | {"sums": [0.0] * 80, "alarm": ["t77"], "anomaly": True}
    shown = text(seen(tick, system=msgspec.convert(SYSTEM | {"generators": generators}, SystemDescription)))
    assert "▶ t77" in shown
    assert "more" in shown
    assert shown.splitlines()[-1].startswith("event")


def test_bars_have_their_threshold_in_the_middle() -> None:
    ascii_look = Look(unicode=False)
    assert [bar(value, 8, ascii_look) for value in (0.0, 1.0, 5.0, None)] == [
        "....|....",
        "####|....",
        "####|####",
        "    |    ",
    ]
