"""Data channels of an MF4 as tables: groups with rates of their own, units, words, damage; beside CAN frames too."""

from datetime import UTC, datetime
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from asammdf import MDF, Signal

from faultline.service.core.signals.values import Quality
from faultline.service.logs import Log, LogError, open_log
from faultline.service.survey.command import survey_log

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
START_S = 1.7e9


def write(path: Path, *groups: list[Signal]) -> Path:
    """Write the groups to an MF4 that began at `START_S`."""
    mdf = MDF(version="4.10")
    mdf.header.start_time = datetime.fromtimestamp(START_S, UTC)
    for group in groups:
        mdf.append(group)
    mdf.save(path, overwrite=True)
    mdf.close()
    return path


def ramp(name: str, unit: str, period_s: float, count: int, begin_s: float = 0.0) -> Signal:
    times = begin_s + period_s * np.arange(count)
    return Signal(samples=np.arange(count, dtype=np.float64), timestamps=times, name=name, unit=unit)


def came(log: Log, units: dict[str, str]) -> dict[str, list[tuple[float, float, str]]]:
    """Return time, value and quality of what came, by signal; rows of the pieces are in order of time."""
    found: dict[str, list[tuple[float, float, str]]] = {name: [] for name in units}
    last = -np.inf
    for piece in log.signals(log.table(units, "x")).pieces():
        assert (np.diff(piece.time) >= 0).all()
        assert piece.time[0] >= last
        assert (piece.before <= piece.time).all()
        last = piece.last_s
        for name, column in piece.columns.items():
            values = zip(piece.time[column.row], column.value, column.quality, strict=True)
            found[name] += [(round(float(t), 6), float(value), Quality(worth).name) for t, value, worth in values]
    return found


def test_groups_of_several_rates_are_one_log(tmp_path: Path) -> None:
    words = Signal(np.array([b"a", b"b"]), np.array([0.0, 50.0]), name="word", encoding="utf-8")
    path = write(
        tmp_path / "x.mf4",
        [ramp("p", "kPa", 0.01, 40_000), ramp("q", "", 0.01, 40_000)],
        [ramp("n", "rpm", 1.0, 300, begin_s=0.5)],
        [words],
    )
    log = open_log(path)
    assert (log.format.name, log.report.lost) == ("MF4 with data channels", False)
    assert log.start_s == pytest.approx(START_S)
    found = came(log, {"p": "Pa", "n": "1/s", "word": "1"})
    assert found["p"] == [(round(0.01 * k, 6), 1000.0 * k, "GOOD") for k in range(40_000)]
    assert [t for t, _, _ in found["n"]] == [0.5 + k for k in range(300)]
    assert found["n"][60][1] == pytest.approx(1.0)
    assert [quality for _, _, quality in found["word"]] == ["ERROR", "ERROR"]
    columns = {each.name: each for each in survey_log(log).columns}
    assert [(columns[name].unit, columns[name].count) for name in "pn"] == [("kPa", 40_000), ("rpm", 300)]
    assert [columns[name].period_s for name in "pn"] == pytest.approx([0.01, 1.0], rel=1e-4)


def test_a_table_in_an_mf4_beside_a_log(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    copytree(GOLDEN / "log", folder)
    write(folder / "tank.mf4", [ramp("tank", "kPa", 0.1, 1000)])
    with (folder / "recording.toml").open("a") as file:
        file.write(f'\n[table]\nfile = "tank.mf4"\noffset_s = {2.0 - START_S}\nsignals = {{ y_p_tp = "tank" }}\n')
    found = came(open_log(folder), {"y_p_tp": "Pa", "y_p_du": "Pa"})
    assert found["y_p_tp"][:2] == [(2.0, 0.0, "GOOD"), (2.1, 1000.0, "GOOD")]
    assert len(found["y_p_du"]) == 635


def test_a_cut_mf4_says_so_or_is_no_log(tmp_path: Path) -> None:
    whole = write(tmp_path / "x.mf4", [ramp("p", "Pa", 0.01, 100_000)]).read_bytes()
    for part in (0.2, 0.6, 0.95):
        path = tmp_path / "cut.mf4"
        path.write_bytes(whole[: int(part * len(whole))])
        try:
            is_damaged = open_log(path).report.damaged
        except LogError as error:
            is_damaged = "cut.mf4" in str(error)
        assert is_damaged
