"""`diagnose --out`: what the files hold is what the monitor saw and said, tick by tick."""

import sys
from pathlib import Path

import pytest
from pyarrow import parquet

from faultline.service.bundle.load import load_bundle
from faultline.service.core.decision.decision import Decision
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.line import encode
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.values import Quality
from faultline.service.diagnose.command import main
from faultline.service.diagnose.tick_table import EVENT_COLUMNS, TICK_COLUMNS, columns_of
from faultline.service.logs import open_log

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
BUNDLE, LOG = str(GOLDEN / "bundle"), str(GOLDEN / "log")
PAGE = Path(__file__).resolve().parents[2] / "docs" / "diagnose-out.md"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the golden log, and of its first 50 s, in which not every test could tell."""
    folder = tmp_path_factory.mktemp("out")
    lines = (GOLDEN / "log" / "can.log").read_text().splitlines(keepends=True)
    (folder / "begin.log").write_text("".join(lines[: 5 * len(lines) // 12]))
    path = folder / "made" / "ticks.parquet"
    assert main([LOG, str(folder / "begin.log"), "--bundle", BUNDLE, "--out", str(path)]) == 1
    return path


def test_a_row_is_a_tick_as_the_monitor_saw_it(out: Path) -> None:
    seen: list[tuple[Tick, list[str], list[float]]] = []
    came: dict[str, list[float]] = {}

    def watch(tick: Tick, decision: Decision) -> None:
        seen.append((tick, decision.alarm, decision.sums.tolist()))

    bundle, log = load_bundle(GOLDEN / "bundle"), open_log(GOLDEN / "log")
    events = list(Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id, watch).log(log.relative()))
    for frame in log.relative():
        for name, _, quality in bundle.table.decode(frame.can_id, frame.is_extended, frame.data):
            came.setdefault(name, []).extend([frame.t] if quality is Quality.GOOD else [])
    rows = [row for row in parquet.read_table(out).to_pylist() if row["recording"] == "golden"]
    assert len(rows) == len(seen) == 635
    for row, (tick, alarm, sums) in zip(rows, seen, strict=True):
        assert (row["tick"], row["log_s"], row["alarm"]) == (tick.number, tick.t_s, alarm)
        assert row["t_s"] == pytest.approx(0.2 * tick.number)
        for k, channel in enumerate(bundle.manifest.inputs):
            assert row[channel.signal] == tick.z[k]
            assert (row[f"{channel.signal}.quality"] == "good") == tick.usable[k]
            newest = max((t for t in came[channel.signal] if t <= tick.t_s), default=None)
            age = None if newest is None else pytest.approx(tick.t_s - newest, abs=1e-6)
            assert row[f"{channel.signal}.age_s"] == age
        for k, generator in enumerate(bundle.manifest.generators):
            assert row[f"{generator.name}.residual"] == tick.residuals.r[k]
            assert row[f"{generator.name}.usable"] == tick.residuals.usable[k]
            assert row[f"{generator.name}.detector"] == sums[k]
    told = parquet.read_table(out.with_suffix(".events.parquet")).to_pylist()
    expected = [encode(event).decode().strip() for event in events]
    assert [row["event"] for row in told if row["recording"] == "golden"] == expected
    last = next(row for row in rows[::-1] if row["diagnoses"])["diagnoses"]
    assert [one["faults"] for one in last] == [one.faults for one in events[-1].diagnoses]


def test_several_recordings_are_in_it_one_after_another(out: Path) -> None:
    table = parquet.read_table(out)
    names = table.column("recording").to_pylist()
    assert names == ["golden"] * 635 + ["begin"] * (len(names) - 635)
    assert 260 <= len(names) - 635 <= 280


def test_units_and_meanings_are_in_the_schema_and_on_the_page(out: Path) -> None:
    manifest = load_bundle(GOLDEN / "bundle").manifest
    schema = parquet.read_schema(out)
    assert schema.names == [name for name, *_ in columns_of(manifest)]
    unit = {name: schema.field(name).metadata[b"unit"].decode() for name in schema.names}
    assert (unit["y_p_du"], unit["n_p"], unit["t02.ode.residual"], unit["log_s"]) == ("Pa", "1/s", "Pa", "s")
    assert all(schema.field(name).metadata[b"meaning"] for name in schema.names)
    for name, _, unit_of, meaning in (*TICK_COLUMNS, *EVENT_COLUMNS):
        assert any(
            line.startswith(f"| `{name}` |") and f"| {unit_of} |".replace("|  |", "| |") in line
            for line in PAGE.read_text().splitlines()
        ), (name, meaning)


def test_one_log_without_a_verdict_is_written_too_and_is_an_error(tmp_path: Path) -> None:
    lines = (GOLDEN / "log" / "can.log").read_text().splitlines(keepends=True)
    short = tmp_path / "short.log"
    short.write_text("".join(lines[: len(lines) // 12]))
    with pytest.raises(InputError, match="could never tell"):
        main([str(short), "--bundle", BUNDLE, "--out", str(tmp_path / "t.parquet")])
    assert 40 < parquet.read_table(tmp_path / "t.parquet").num_rows < 60


def test_of_several_logs_those_that_cannot_be_read_are_named_and_the_others_diagnosed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    absent = tmp_path / "absent.log"
    assert main([str(absent), LOG, "--bundle", BUNDLE]) == 1
    said = capsys.readouterr()
    assert f"faultline diagnose: {absent}: " in said.err
    assert "a fault was found" in said.out
    with pytest.raises(InputError, match="2 of 2 logs gave no verdict"):
        main([str(absent), str(absent), "--bundle", BUNDLE])


def test_a_log_is_never_written_over(tmp_path: Path) -> None:
    log = tmp_path / "x.log"
    log.write_bytes((GOLDEN / "log" / "can.log").read_bytes())
    with pytest.raises(InputError, match="is a folder or a log; give another file with --out"):
        main([str(log), "--bundle", BUNDLE, "--out", str(log)])


def test_without_pyarrow_it_is_said_before_the_log_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ModuleNotFoundError) as error:
        main([str(tmp_path / "absent.log"), "--bundle", BUNDLE, "--out", str(tmp_path / "t.parquet")])
    assert error.value.name == "pyarrow"
    assert not (tmp_path / "t.parquet").exists()


def test_recordings_of_one_name_are_told_apart(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "can.log").write_bytes((GOLDEN / "log" / "can.log").read_bytes())
    logs = [str(tmp_path / name / "can.log") for name in "ab"]
    out = tmp_path / "ticks.parquet"
    assert main([*logs, "--bundle", BUNDLE, "--out", str(out)]) == 1
    counts = parquet.read_table(out).group_by("recording").aggregate([("tick", "count")]).to_pydict()
    assert counts["recording"] == ["can", logs[1]]
    assert len(set(counts["tick_count"])) == 1
