"""`faultline discover` from recordings to a model that every other command takes, and back."""

import contextlib
import dataclasses
import io
import json
import re
import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from made_study import LIBRARY, UDS1, with_effects

sys.path.append(str(Path(__file__).parents[1] / "calibration"))
from made_drive import frames, freed, write_recording

from faultline.analysis.discrepancy import command
from faultline.analysis.discrepancy.add.held_out import Shown, shown
from faultline.analysis.discrepancy.command import main
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.experiments import load_experiments
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.model import dump_model, load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.analysis.structure.command import main as structure
from faultline.service.core.errors import InputError
from faultline.service.logs import open_log

GAIN = 0.2
ENTRIES = ("full_open_gain", "offset_p_du", "offset_p_ap")
SPEED = (20.0, 20.0, 24.0, 28.0, 30.0, 22.0, 26.0)
DOSE = (0.0, 0.0, 0.4, 1.0, 0.7, 0.0, 1.0)
OTHER = (0.0, 0.5, 0.0, 1.0, 0.2, 0.9, 0.6)


def recording(folder: Path, effects: Mapping[str, float], seed: int, *, zero: float = 0.0, held: bool = False) -> Path:
    """Seven holds of half a minute."""
    true = with_effects(UDS1, effects)
    values = {name: p.value for name, p in true.parameters.items()}
    log = frames(true, values, seed, speed=SPEED, dose=OTHER if held else DOSE, zero={"y_p_du": zero})
    return write_recording(folder, log)


@pytest.fixture(scope="module", autouse=True)
def few_entries() -> Iterator[None]:
    """The shipped library takes minutes; one of one's own is read as ever."""

    def some(system: Path | None, own: Path | None) -> dict[str, Effect]:
        assert system == SYSTEMS / "uds"
        return load_library(system, own) if own else {name: LIBRARY[name] for name in ENTRIES}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "load_library", some)
        yield


def run(*arguments: object) -> tuple[int, str]:
    """The exit code and what it printed."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        code = main([*map(str, arguments), "--processes", "1"])
    return code, printed.getvalue()


@dataclass(frozen=True)
class Made:
    """A model file, and recordings of a valve that passes more when held open."""

    model: Path
    training: Path
    held: Path


@dataclass(frozen=True)
class Found(Made):
    """A search in them, with its files and what it printed."""

    out: Path
    code: int
    printed: str


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("discover")
    model = folder / "datasheet.toml"
    model.write_text(dump_model(UDS1))
    training, held = (
        recording(folder / name, {"full_open_gain": GAIN}, seed, held=seed == 4)
        for seed, name in ((3, "training"), (4, "held"))
    )
    return Made(model, training, held)


@pytest.fixture(scope="module")
def found(made: Made) -> Found:
    out = made.model.parent / "new" / "found"
    code, printed = run(made.model, made.training, "--held-out", made.held, "--out", out, "--apply")
    return Found(made.model, made.training, made.held, out, code, printed)


def test_what_was_found_is_said_and_written(found: Found) -> None:
    assert found.code == 0
    assert found.printed.splitlines()[0].startswith(
        "missing in the model: the dosing valve passes more when it is held open than its pulses say (full_open_gain)"
    )
    names = {path.name for path in found.out.iterdir()}
    assert names >= {"discovery.json", "report.html", "summary.md", "model.toml", "work"}
    assert "experiment.toml" not in names
    last = found.printed.splitlines()[-1]
    assert last.startswith("wrote ")
    for name in ("discovery.json", "report.html", "summary.md", "model.toml"):
        assert str(found.out / name) in last
        assert (found.out / name).stat().st_size > 500
    told = json.loads((found.out / "discovery.json").read_bytes())
    assert told["verdict"]["kind"] == "named"
    assert told["origin"]["sources"] == ["made"]
    [strength] = told["strengths"]
    assert strength["interval"][0] < GAIN < strength["interval"][1]
    assert told["refused"] == []
    assert {entry["name"] for entry in told["entries"]} == {*ENTRIES}


def test_the_same_conditions_are_the_users_word_and_the_model_keeps_its_drifts(made: Made, tmp_path: Path) -> None:
    code, _ = run(made.model, made.training, "--held-out", made.held, "--out", tmp_path, "--apply", "--same-conditions")
    assert code == 0
    assert json.loads((tmp_path / "discovery.json").read_bytes())["origin"]["same_conditions"]
    assert "is your word (--same-conditions)" in (tmp_path / "summary.md").read_text()
    assert load_model(tmp_path / "model.toml").known["y_p_du"].drift == UDS1.known["y_p_du"].drift > 0.0


def test_the_model_with_it_is_one_for_every_other_command(found: Found, capsys: pytest.CaptureFixture[str]) -> None:
    model = load_model(found.out / "model.toml")
    assert model.parameters["full_open_gain_g"].value == pytest.approx(GAIN, abs=0.03)
    entry = model.provenance[-1]
    assert entry["command"] == "discover"
    assert entry["vehicle"] == "made"
    assert entry["recordings"] == [open_log(found.training).sha256]
    assert entry["held_out"] == [open_log(found.held).sha256]
    assert structure([str(found.out / "model.toml")]) == 0
    assert "uds_production" in capsys.readouterr().out


def test_what_no_entry_describes_gets_a_formula_and_is_added_once_it_is_given_back(
    made: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without its entry the valve's effect has no name: a term is proposed, which --apply alone does not add."""
    out, again = made.model.parent / "formula", made.model.parent / "given-back"
    given = (made.model, made.training, "--held-out", made.held, "--apply")
    code, printed = run(*given, "--out", out, "--without", "full_open_gain")
    assert code == 1
    told = json.loads((out / "discovery.json").read_bytes())
    assert told["verdict"]["kind"] == "unnamed"
    proposal = told["proposal"]
    assert proposal["terms"][0]["equation"] == "e04"
    # more where it is held open, or less elsewhere: one statement, as the nozzle's area is free; rounding chooses
    assert any(form in proposal["terms"][0]["name"] for form in ("_step_dc_dose", "_between_dc_dose_0_1"))
    assert proposal["remainder"] == 0.0
    strength = proposal["strengths"][0]
    assert strength["value"] == pytest.approx(GAIN, abs=0.04)
    assert all(r["rms_after"] < r["rms_before"] for r in proposal["regimes"] if r["mode"] == "maximum")
    assert "a formula is proposed, to be reviewed: in dosed flow" in printed
    assert "proposal.toml" in printed
    assert not (out / "model.toml").exists()
    for name in ("report.html", "summary.md"):
        assert "A formula that is proposed" in (out / name).read_text()

    monkeypatch.setattr(command, "load_library", lambda _, own: load_library(None, own))
    code, printed = run(*given, "--out", again, "--library", out / "proposal.toml")
    assert (again / "model.toml").exists(), printed
    assert f"{proposal['terms'][0]['name']}_c" in load_model(again / "model.toml").parameters
    assert not (again / "proposal.toml").exists()


def test_what_makes_the_held_out_free_run_worse_is_not_written(
    found: Found, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wound: on 107 nats of the held-out recording a model was written whose error there had grown by 7 %."""

    def grown(*attempts: Any) -> Shown:
        runs = shown(*attempts)
        agreement = {
            name: {mode: dataclasses.replace(a, rms=1.075 * a.rms, expected=2.0 * a.rms) for mode, a in by_mode.items()}
            for name, by_mode in runs.before.agreement.items()
        }
        return dataclasses.replace(runs, after=dataclasses.replace(runs.after, agreement=agreement))

    monkeypatch.setattr(command, "shown", grown)
    out = tmp_path / "out"
    shutil.copytree(found.out / "work", out / "work")
    code, printed = run(found.model, found.training, "--held-out", found.held, "--out", out, "--apply")
    assert code == 1
    assert not (out / "model.toml").exists()
    told = json.loads((out / "discovery.json").read_bytes())
    assert (told["verdict"]["kind"], told["applied"]) == ("named", False)
    [reason] = told["refused"]
    assert reason.startswith("the held-out free run is not better, by its RMS error in steady operation (")
    for regime in (r for r in told["regimes"] if r["mode"] == "steady"):
        before, after = (float(f"{regime[key] / 1e5:.4g}") for key in ("rms_before", "rms_after"))
        assert f"{regime['output']} {before:g} -> {after:g} bar" in reason
    assert f"not added: {reason}" in printed
    assert reason in (out / "summary.md").read_text()


def test_undo_gives_the_bytes_that_were_there(found: Found, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(found.out / "model.toml"), "--undo", "--out", str(tmp_path / "back")]) == 0
    back = tmp_path / "back" / "model.toml"
    assert back.read_bytes() == found.model.read_bytes()
    assert capsys.readouterr().out == f"wrote {back}: uds_production as it was before its last discovery\n"
    with pytest.raises(InputError, match="provenance: is empty, there is nothing to undo"):
        main([str(back), "--undo", "--out", str(tmp_path / "back")])
    with pytest.raises(InputError, match="--undo takes a model only"):
        main([str(found.out / "model.toml"), str(found.training), "--undo"])
    with pytest.raises(NotADirectoryError, match=f"'{found.model}/o'"):
        refused(found.out / "model.toml", "--undo", "--out", found.model / "o")


def has_it(found: Found, folder: Path) -> Path:
    """A model that has the effect, and does not say from what."""
    true = folder / "true.toml"
    true.write_text(dump_model(dataclasses.replace(load_model(found.out / "model.toml"), provenance=())))
    return true


def test_where_a_model_has_it_nothing_is_missing(found: Found, tmp_path: Path) -> None:
    """Without --apply no model is written. A model that was made from the held-out recording would be refused."""
    true = has_it(found, tmp_path)
    with pytest.raises(InputError, match="uds_production was made from this recording, so it is no evidence"):
        run(found.out / "model.toml", found.training, "--held-out", found.held, "--out", tmp_path / "again")
    (tmp_path / "again").mkdir(exist_ok=True)
    for name in ("discovery.json", "model.toml", "experiment.toml"):  # left by an earlier call, and not of this one
        (tmp_path / "again" / name).write_text("schema = 1\n")
    code, told = run(true, found.training, "--held-out", found.held, "--out", tmp_path / "again", "--json")
    assert code == 0
    document = json.loads(told)
    assert document == json.loads((tmp_path / "again" / "discovery.json").read_bytes())
    assert document["verdict"]["kind"] == "nothing missing"
    entries = {entry["name"]: entry["no_place"] for entry in document["entries"]}
    assert entries["full_open_gain"] == "uds_production has full_open_gain in it already"
    assert not (tmp_path / "again" / "model.toml").exists()
    assert not (tmp_path / "again" / "experiment.toml").exists()


@pytest.mark.parametrize("kind", ["held-out", "training"])
def test_a_fault_in_a_recording_is_told_and_nothing_is_added(tmp_path: Path, kind: str) -> None:
    """The wound: in a held-out one it raised what is asked for until nothing was missing."""
    values = {name: p.value for name, p in UDS1.parameters.items()}
    healthy, faulty = (frames(UDS1, values, 10, speed=SPEED, dose=OTHER, zero={"y_p_du": off}) for off in (0.0, 4e4))
    bad = write_recording(tmp_path / "bad", [a if a.t < 90.0 else b for a, b in zip(healthy, faulty, strict=True)])
    good = recording(tmp_path / "good", {}, 9)
    training, held = (good, bad) if kind == "held-out" else (bad, good)
    code, printed = run("uds/production", training, "--held-out", held, "--out", tmp_path / "out", "--apply")
    assert code == 1
    assert printed.startswith("something set in at ")
    assert " s of bad, as faults do (" in printed
    assert not (tmp_path / "out" / "experiment.toml").exists()
    onset = json.loads((tmp_path / "out" / "discovery.json").read_bytes())["onset"]["data"]
    assert onset["t_s"] == pytest.approx(90.0, abs=10.0)
    assert not (tmp_path / "out" / "model.toml").exists()


def test_what_has_several_names_is_said_with_exit_code_1(tmp_path: Path) -> None:
    """Two sensors of one pressure."""
    training, held = (
        recording(tmp_path / name, {}, seed, zero=5000.0, held=seed == 6) for seed, name in ((5, "t"), (6, "h"))
    )
    code, printed = run("uds/production", training, "--held-out", held, "--out", tmp_path / "out")
    assert code == 1
    told = json.loads((tmp_path / "out" / "discovery.json").read_bytes())
    assert told["verdict"]["kind"] == "one of"
    [place] = told["verdict"]["places"]
    assert {c["name"] for c in place["candidates"]} == {"offset_p_du", "offset_p_ap"}
    assert "offset_p_ap" in printed
    parts = re.sub(r"-x\d+", "", told["experiment"]["data"]["name"]).split("-")  # joined of those that are shipped
    assert {*parts} <= {e.name for e in load_experiments(SYSTEMS / "uds").planned}
    assert not (tmp_path / "out" / "model.toml").exists()
    again = ("uds/production", training, "--held-out", held, "--out", tmp_path / "out", "--without", "offset_p_ap")
    code, printed = run(*again)
    assert code == 0
    assert "(offset_p_du)" in printed.splitlines()[0]
    assert "left out of the search: offset_p_ap" in printed
    document = json.loads((tmp_path / "out" / "discovery.json").read_bytes())
    assert "offset_p_ap" not in {entry["name"] for entry in document["entries"]}
    assert refused(*again, "no_such").startswith("--without no_such: the library has no such effect")


def test_what_the_recordings_lack_is_told(found: Found) -> None:
    """Two holds at maximum dose, of which the seconds after the step do not count."""
    missing = json.loads((found.out / "discovery.json").read_bytes())["origin"]["missing"]
    assert any(
        re.fullmatch(r"the training recordings have \d\d s of mode maximum; record 60 s of it", m) for m in missing
    )
    assert not any("mode idle" in m and "training" in m for m in missing)
    assert all(f"note: {m}" in found.printed for m in missing[:2])


def test_the_time_left_counts_what_was_done_now() -> None:
    """The wound: what an interrupted call had kept was taken for work of no time."""
    said: list[str] = []
    now = iter([0.0, 10.0, 20.0, 20.0, 30.0])
    clock = command._Clock(said.append, lambda: next(now))
    clock("fits", 30, 50)
    clock("fits", 31, 50)
    clock("fits", 32, 50)
    clock("fits", 0, 4)  # the same step once more
    clock("fits", 1, 4)
    assert said == [
        "fits: 30 of 50", "fits: 31 of 50, 190 s left", "fits: 32 of 50, 180 s left", "fits: 0 of 4",
        "fits: 1 of 4, 30 s left",
    ]  # fmt: skip


def refused(*arguments: object) -> str:
    with pytest.raises(InputError) as error:
        main([*map(str, arguments)])
    assert "\n" not in str(error.value)
    return str(error.value)


def test_what_is_wrong_with_the_bundles_recordings_is_said_before_a_minute_is_spent(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own.toml"
    shipped = Path(load_library(SYSTEMS / "uds")["pump_slip"].place.split(":")[0]).read_text()
    entry = shipped[shipped.index('[[effect]]\nname = "leak_laminar"') :].split("\n[[effect]]")[0]
    own.write_text("schema = 1\n" + entry.replace('"leak_laminar"', '"mine"').replace('"q_pump"', '"q_pumpe"'))
    said = refused(
        "uds/production",
        made.training,
        "--held-out",
        made.held,
        "--out",
        tmp_path / "o",
        "--library",
        own,
        "--tune",
        made.held,
    )
    assert said.startswith(f"{made.held}: this recording was used to calibrate the model or to discover its effects")
    assert not (tmp_path / "o" / "work").exists()
    noted = capsys.readouterr().err
    assert f"{own}: effect mine: " in noted
    assert "; the entry is left away" in noted


def test_the_model_is_not_written_over(found: Found) -> None:
    said = refused(found.out / "model.toml", found.training, "--held-out", found.held, "--out", found.out)
    assert said.endswith(f"--out {found.out} would write over it; give --out another place")
    assert (found.out / "model.toml").exists()


def test_evidence_needs_another_recording(made: Made, tmp_path: Path) -> None:
    said = refused("uds/production", made.training, "--held-out", made.training, "--out", tmp_path / "o")
    assert said.startswith(f"{made.training}: the same recording as {made.training}; evidence needs recordings")


def test_a_bare_log_is_refused(made: Made, tmp_path: Path) -> None:
    log = made.training / "can.log"
    assert refused("uds/production", log, "--held-out", made.held, "--out", tmp_path / "o") == (
        f"{log}: a bare log names no DBC; give its recording's folder"
    )


def test_a_recording_that_is_not_there_is_named(made: Made, tmp_path: Path) -> None:
    said = refused("uds/production", made.training, "--held-out", tmp_path / "none", "--out", tmp_path / "o")
    assert said.startswith(str(tmp_path / "none"))


def test_recordings_of_two_vehicles_are_refused(made: Made, tmp_path: Path) -> None:
    true = {name: p.value for name, p in UDS1.parameters.items()}
    other = write_recording(tmp_path / "other", frames(UDS1, true, 7, speed=SPEED[:3], dose=DOSE[:3]), "another")
    said = refused("uds/production", made.training, "--held-out", other, "--out", tmp_path / "o")
    assert said.startswith(f"{other}: recorded on vehicle 'another'")


def test_a_recording_that_is_too_short_is_named(made: Made, tmp_path: Path) -> None:
    true = {name: p.value for name, p in UDS1.parameters.items()}
    log = frames(UDS1, true, 8, speed=SPEED[:2], dose=DOSE[:2])
    short = write_recording(tmp_path / "short", [frame for frame in log if frame.t < 45.0])
    said = refused("uds/production", made.training, "--held-out", short, "--out", tmp_path / "o")
    assert said.startswith(f"{short}: in no ")


def test_a_model_without_priors_is_refused(made: Made, tmp_path: Path) -> None:
    model = tmp_path / "fixed.toml"
    model.write_text(dump_model(freed(UDS1, ())))
    said = refused(model, made.training, "--held-out", made.held, "--out", tmp_path / "o")
    assert said.startswith("uds_production: no parameter has a prior; give `prior` to those that")


@pytest.mark.parametrize("text", [None, "schema = 1\n[[effect]]\n", "schema = \n", "schema = 9\n"])
def test_a_library_that_is_wrong_is_named(made: Made, tmp_path: Path, text: str | None) -> None:
    library = tmp_path / "mine.toml"
    if text is not None:
        library.write_text(text)
    arguments = (
        "uds/production",
        made.training,
        "--held-out",
        made.held,
        "--library",
        library,
        "--out",
        tmp_path / "o",
    )
    assert refused(*arguments).startswith(str(library))


def test_a_folder_that_cannot_be_written_is_said_before_anything_else(made: Made) -> None:
    with pytest.raises(NotADirectoryError, match=f"'{made.model}'"):
        refused("uds/production", made.training, "--held-out", made.held, "--out", made.model / "out")
    assert refused(made.model, "--undo").startswith("uds_production: provenance: is empty")


def test_what_is_in_the_way_of_a_result_is_said(found: Found, tmp_path: Path) -> None:
    """A folder where the experiment of an earlier call would go: it cannot be removed."""
    (tmp_path / "discovery.json").write_text("of an earlier call")
    (tmp_path / "experiment.toml" / "mine").mkdir(parents=True)
    with pytest.raises(IsADirectoryError, match=f"'{tmp_path}/experiment.toml'"):
        refused(has_it(found, tmp_path), found.training, "--held-out", found.held, "--out", tmp_path)


def test_a_model_that_is_not_ours_is_left_alone(found: Found, tmp_path: Path) -> None:
    mine = tmp_path / "model.toml"
    mine.write_text("mine")
    code, _ = run(has_it(found, tmp_path), found.training, "--held-out", found.held, "--out", tmp_path)
    assert code == 0
    assert mine.read_text() == "mine"


def test_undo_does_not_write_over_the_model(found: Found) -> None:
    said = refused(found.out / "model.toml", "--undo", "--out", found.out)
    assert said == f"{found.out / 'model.toml'}: --out {found.out} would write over it; give --out another place"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "give recordings to fit, and others with --held-out"),
        (("--undo", "--apply"), "--undo takes MODEL and --out only"),
        (("--undo", "--without", "pump_slip"), "leave out --without"),
        (("--held-out", "b", "--scheduler", "tcp://h:1", "--processes", "2"), "--processes are of this machine"),
        (("--held-out", "b", "--evaluate", "c"), "--evaluate judges bundles, and those are tuned"),
        (("--held-out", "b", "--tune", "t", "--evaluate", "c", "--truth", "d", "e"), "give as many --truth as --"),
    ],
)
def test_what_is_left_out_is_said(options: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as error:
        main(["uds/production", "a", *options])
    assert error.value.code == 2
    assert said in capsys.readouterr().err
