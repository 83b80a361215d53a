"""A fleet of copies of the golden log: rows and events as of the single command, resumed, failing, killed."""

import json
import os
import shutil
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path

import dask
import fsspec
import pytest
from distributed import Client, Nanny
from pyarrow import parquet

from faultline.analysis.fleet import tables
from faultline.analysis.fleet.cluster import cluster, pieces_of, worked
from faultline.analysis.fleet.command import main
from faultline.analysis.fleet.diagnosing import Wish, _bundle_id, diagnosed
from faultline.analysis.fleet.drives import find_drives
from faultline.analysis.fleet.findings import Fleet, fleet_of
from faultline.analysis.fleet.page import page_of, sentence, text_of
from faultline.analysis.fleet.vehicles import Order, by_vehicle, ordered
from faultline.service.core.errors import InputError

GOLDEN = Path(__file__).parents[2] / "golden"
FAULT = "dosing unit filter"


def recording(folder: Path, vehicle: str, day: int, end: int | None = None) -> Path:
    """The golden recording as that of a vehicle on a day of March 2026; of its log the first lines only."""
    shutil.copytree(GOLDEN / "log", folder)
    described = (folder / "recording.toml").read_text().splitlines()
    own = {"vehicle": f'"{vehicle}"', "start": f"2026-03-{day:02}T08:00:00+00:00", "id": f'"{vehicle}-{day}"'}
    kept = [line for line in described if line.partition(" = ")[0] not in own]
    at = next(k for k, line in enumerate(kept) if line.startswith("["))
    kept[at:at] = [f"{key} = {value}" for key, value in own.items()]
    (folder / "recording.toml").write_text("\n".join(kept) + "\n")
    if end is not None:
        lines = (folder / "can.log").read_text().splitlines(keepends=True)
        (folder / "can.log").write_text("".join(lines[:end]))
    return folder


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Vehicle a with a fault on two days, b with a log too short to tell, c whose log is none, a bare log of d."""
    folder = tmp_path_factory.mktemp("logs")
    recording(folder / "first", "a", 1)
    recording(folder / "second", "a", 9)
    recording(folder / "short", "b", 2, end=400)
    (recording(folder / "none", "c", 3) / "can.log").write_text("no log\n")
    (folder / "d").mkdir()
    shutil.copy(GOLDEN / "log" / "can.log", folder / "d" / "drive.log")
    return folder


@pytest.fixture(scope="module")
def out(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    given = [str(logs), "--bundle", str(GOLDEN / "bundle"), "--out", str(folder), "--processes", "2"]
    assert main(["diagnose", *given]) == 1
    return folder


@pytest.fixture(scope="module")
def fleet(out: Path) -> Fleet:
    return fleet_of(tables.drives(out))


def test_a_row_of_each_drive(out: Path) -> None:
    rows = {(row["vehicle"], row["date"] and row["date"].day): row for row in tables.drives(out)}
    assert {key: row["verdict"] for key, row in rows.items()} == {
        ("a", 1): "fault",
        ("a", 9): "fault",
        ("b", 2): "open",
        ("c", None): "failed",
        ("d", 1): "fault",
    }
    assert "could never tell" in rows["b", 2]["reason"]
    assert "can.log" in rows["c", None]["reason"]
    assert rows["a", 1]["native"]
    assert rows["a", 1]["diagnoses"][0]["components"] == [FAULT]
    assert rows["a", 1]["ticks"] > 500


def test_events_are_those_of_the_single_command(out: Path) -> None:
    [file] = (out / "events" / "vehicle=d").rglob("*.parquet")
    found = [json.loads(line) for line in parquet.read_table(file, columns=["event"])["event"].to_pylist()]
    expected = [json.loads(line) for line in (GOLDEN / "events.jsonl").read_text().splitlines()]
    for event in (*found, *expected):
        del event["id"]  # it has the recording's name
    assert found == expected


def test_what_is_done_is_not_done_again(logs: Path, out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    assert main(["diagnose", str(logs), "--bundle", str(GOLDEN / "bundle"), "--out", str(out), "--processes", "1"]) == 1
    assert "5 drives" in (said := capsys.readouterr().out)
    assert "4 of them done before" in said  # what failed is tried again
    after = {path: path.stat().st_mtime_ns for path in out.rglob("*.parquet")}
    assert after.keys() == before.keys()
    assert sum(after[path] != before[path] for path in after) == 1


def test_which_vehicles_which_components_since_when_how_sure(fleet: Fleet, out: Path, tmp_path: Path) -> None:
    a, d = fleet.findings
    assert (a.vehicle, a.components, a.stands, a.number, a.of) == ("a", FAULT, True, 2, 2)
    assert a.first is not None
    assert a.first.isoformat() == "2026-03-01T08:00:00+00:00"
    assert d.vehicle == "d"
    assert set(fleet.silent) == {"b", "c"}
    assert sentence(fleet).startswith("2 of 4 vehicles have a fault")
    assert sentence(fleet).endswith("3 of 5 drives are simulated.")
    assert f"a        {FAULT}" in text_of(fleet)
    assert page_of(fleet).count(FAULT) >= 3
    assert main(["show", str(out), "--html", str(tmp_path / "fleet.html")]) == 1
    assert "could never tell" in (tmp_path / "fleet.html").read_text()


def test_a_drive_without_a_verdict_ends_no_finding(out: Path) -> None:
    rows = [row for row in tables.drives(out) if row["vehicle"] == "a"]
    later = {**rows[-1], "verdict": "open", "diagnoses": [], "reason": "too short"}
    sound = {**later, "verdict": "no fault"}
    assert fleet_of([*rows, later]).findings[0].stands
    past = fleet_of([*rows, sound])
    assert not past.findings[0].stands
    assert text_of(past).splitlines()[1].startswith("found before, and not in the last drive")
    assert FAULT in text_of(past)
    assert fleet_of([*rows, sound, rows[-1]]).findings[0].of == 4


def with_identity(folder: Path) -> Path:
    """The golden recording with a VIN in three parts, and two positions, the last of which is an error."""
    recording(folder, "a", 1)
    lines = (folder / "can.log").read_text().splitlines()
    at = lines[100].split()[:2]
    vin = b"1FAULTLINE0000017*"
    parts = [bytes([k + 1]) + vin[7 * k : 7 * k + 7].ljust(7, b"\xff") for k in range(3)]
    told = [("1CECFF00", bytes([0x20, len(vin), 0, 3, 0xFF, 0xEC, 0xFE, 0x00]))]
    told += [("1CEBFF00", part) for part in parts]
    told += [("18FEF31C", bytes.fromhex("00D5239B402B7F82")), ("18FEF31C", bytes.fromhex("FFFFFFFFFFFFFFFE"))]
    lines[101:101] = [" ".join([*at, f"{identifier}#{data.hex().upper()}"]) for identifier, data in told]
    (folder / "can.log").write_text("\n".join(lines) + "\n")
    return folder


def test_vin_and_position_are_left_out_unless_asked_for(tmp_path: Path) -> None:
    with_identity(tmp_path / "logs" / "drive")
    [drive] = find_drives([str(tmp_path / "logs")])

    def row(*asked: str) -> dict[str, object]:
        [outcome] = diagnosed([drive], Wish(str(GOLDEN / "bundle"), tmp_path / "out", asked))
        [found] = tables.drives(tmp_path / "out")
        return {"old": outcome.is_old, **{name: found[name] for name in ("vin", "latitude", "longitude")}}

    nothing = {"old": False, "vin": None, "latitude": None, "longitude": None}
    assert row() == nothing
    everything = {"old": False, "vin": "1FAULTLINE0000017", "latitude": 50.2816768, "longitude": 8.9372224}
    assert row("position", "vin") == everything
    assert row("vin", "position") == {**everything, "old": True}
    assert row("vin") == {**nothing, "vin": "1FAULTLINE0000017"}
    assert row() == nothing, "what is not asked for any more is gone"


def test_logs_of_another_file_system(tmp_path: Path) -> None:
    memory = fsspec.filesystem("memory")
    memory.put(str(GOLDEN / "log"), "/fleet/e/drive", recursive=True)
    memory.pipe("/fleet/e/notes.txt", b"no log")
    drives = find_drives(["memory://fleet/*"])
    assert [drive.url for drive in drives] == ["memory:///fleet/e/drive"]
    [outcome] = diagnosed(drives, Wish(str(GOLDEN / "bundle"), tmp_path))
    assert outcome.verdict == "fault"


def test_a_path_may_be_written_in_several_ways(logs: Path) -> None:
    one = find_drives([str(logs / "first")])
    ways = [f"{logs}//first", f"{logs}/first/", f"{logs}/./first", f"{logs}/second/../first", f"{logs}//fir*"]
    assert [drive.is_folder for drive in one] == [True]
    assert find_drives(ways) == one


def test_a_bundle_for_each_vehicle(logs: Path, tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / "bundle", tmp_path / "bundles" / "a")
    drives = find_drives([str(logs / "first"), str(logs / "short")])
    found = diagnosed(drives, Wish(str(tmp_path / "bundles" / "{vehicle}"), tmp_path / "out"))
    assert [outcome.verdict for outcome in found] == ["fault", "failed"]
    assert "bundles/b" in next(row["reason"] for row in tables.drives(tmp_path / "out") if row["vehicle"] == "b")


def test_the_same_command_for_each_vehicle(logs: Path, tmp_path: Path) -> None:
    """Any command that takes recordings and writes a file will do; this one ends with 1, as there is a fault."""
    vehicles = by_vehicle(find_drives([str(logs / "first"), str(logs / "short")]))
    assert [vehicle for vehicle, _ in vehicles] == ["a", "b"]
    extra = ("--bundle", str(tmp_path / "bundles" / "{vehicle}"))
    shutil.copytree(GOLDEN / "bundle", tmp_path / "bundles" / "a")
    order = Order("diagnose", str(GOLDEN / "log"), "--out", "ticks.parquet", extra, tmp_path / "out")
    a, b = ordered(vehicles, order)
    assert (a.code, a.is_old) == (1, False)
    assert b.code == 2
    assert "gave no verdict" in b.said
    assert "bundles/b" in (tmp_path / "out" / "vehicle=b" / "diagnose.txt").read_text()
    table = tmp_path / "out" / "vehicle=a" / "ticks.parquet"
    assert set(parquet.read_table(table)["recording"].to_pylist()) > {"a-1"}
    again, failed = ordered(vehicles, order)
    assert again.is_old
    assert not failed.is_old
    shutil.rmtree(tmp_path / "bundles" / "a")
    before = table.read_bytes()
    gone, _ = ordered(vehicles, order)
    assert gone.code == 2
    assert table.read_bytes() == before, "what was there is not lost to a command that fails"


def test_orders_take_recordings_only(logs: Path) -> None:
    with pytest.raises(InputError, match="is no recording"):
        by_vehicle(find_drives([str(logs / "d" / "drive.log")]))


def test_a_command_that_fails_for_a_vehicle_is_an_error(
    logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["no-model", str(logs / "first"), "--out", str(tmp_path), "--processes", "1"]
    with pytest.raises(InputError, match="calibrate ended with an error for 1 of 1 vehicles"):
        main(["calibrate", *given])
    assert "no-model" in capsys.readouterr().err
    assert "no-model" in (tmp_path / "vehicle=a" / "calibrate.txt").read_text()


def test_an_export_takes_the_dbc_of_its_recordings(logs: Path, tmp_path: Path) -> None:
    order = Order("export", "m/{vehicle}.toml", "--out", "bundle", ("--force",), tmp_path, takes_dbc=True)
    dbc = next((logs / "first").glob("*.dbc"))
    target = tmp_path / "vehicle=a%2Fb" / "bundle"
    expected = ["export", "m/a%2Fb.toml", "--dbc", str(dbc), "--out", str(target), "--force"]
    assert order.arguments("a/b", [logs / "first"]) == expected


def test_a_drive_that_had_no_bundle_is_one_row_once_it_has(logs: Path, tmp_path: Path) -> None:
    drives, wish = find_drives([str(logs / "first")]), Wish(str(tmp_path / "bundle"), tmp_path / "out")
    assert [outcome.verdict for outcome in diagnosed(drives, wish)] == ["failed"]
    shutil.copytree(GOLDEN / "bundle", tmp_path / "bundle")
    _bundle_id.cache_clear()
    assert [outcome.verdict for outcome in diagnosed(drives, wish)] == ["fault"]
    assert [row["verdict"] for row in tables.drives(tmp_path / "out")] == ["fault"]


def test_nothing_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no recording and no log file is there"):
        find_drives([str(tmp_path)])
    with pytest.raises(InputError, match="no drives"):
        main(["show", str(tmp_path)])
    with pytest.raises(InputError, match="no Dask scheduler answers"), cluster("tcp://127.0.0.1:1", None):
        pass
    with pytest.raises(InputError, match="--processes 0"), cluster(None, 0):
        pass


@pytest.fixture(scope="module")
def two() -> Iterator[Client]:
    with cluster(None, 2) as client:
        yield client


def once_killed(parts: Sequence[str], folder: Path) -> list[str]:
    """Work that is killed the first time that it is at a part; at `deadly` always."""
    for part in parts:
        seen = folder / part
        if part == "deadly" or not seen.exists():
            seen.touch()
            if part in ("deadly", "b"):
                os.kill(os.getpid(), signal.SIGKILL)
    return [part.upper() for part in parts]


def test_a_killed_worker_loses_and_doubles_nothing(two: Client, tmp_path: Path) -> None:
    pieces = [["a"], ["b"], ["c", "deadly", "d"]]
    found = sorted((piece, made) for piece, made in worked(two, once_killed, pieces, tmp_path))
    assert found == [(["a"], ["A"]), (["b"], ["B"]), (["c"], ["C"]), (["d"], ["D"]), (["deadly"], None)]


def test_what_waits_at_a_worker_that_is_killed_is_not_lost(tmp_path: Path) -> None:
    """Dask blames each death on all that waits there, here on everything."""
    with dask.config.set({"distributed.scheduler.worker-saturation": "inf"}), cluster(None, 1) as client:
        found = sorted(
            (piece, made) for piece, made in worked(client, once_killed, [["deadly"], ["c"], ["d"]], tmp_path)
        )
    assert found == [(["c"], ["C"]), (["d"], ["D"]), (["deadly"], None)]


async def _not_started_again(nanny: Nanny, _: int) -> None:
    """Take the worker off the scheduler only, as Dask does with one that dies while it starts."""
    await nanny._unregister()  # type: ignore[no-untyped-call]


def test_a_worker_that_is_gone_for_good_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("faultline.analysis.fleet.cluster.LOOK_S", 1.0)
    monkeypatch.setattr(Nanny, "_on_worker_exit", _not_started_again)
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "500ms"}), cluster(None, 1) as client:
        found = sorted((piece, made) for piece, made in worked(client, once_killed, [["a"], ["b"]], tmp_path))
    assert found == [(["a"], ["A"]), (["b"], ["B"])]


def test_pieces_take_all_parts_once() -> None:
    assert pieces_of([], [], 10) == []
    assert pieces_of("ab", [20, 20], 10) == [["a"], ["b"]]
