"""What is refused before a recording is run: one line that names the place and what to do."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from made_set import BUNDLE, Made, clogged, edited

from faultline.analysis.evaluation.command import detailed, main
from faultline.analysis.evaluation.given import check_reportable, given
from faultline.analysis.evaluation.measure.cases import size_text
from faultline.analysis.evaluation.truth import TrueFault
from faultline.analysis.model import load_model
from faultline.analysis.model.display import units_of
from faultline.service.bundle.files import SEAL, seal
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError


@pytest.fixture
def made(tmp_path: Path) -> Made:
    return Made(tmp_path / "logs", tmp_path / "truth")


def evaluate(made: Made, *recordings: Path, more: tuple[str, ...] = (), bundle: Path = BUNDLE) -> int:
    return main([str(bundle), *map(str, recordings), "--truth", str(made.truths), *more])


def remade(folder: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """The golden bundle with another manifest, sealed."""
    bundle = Path(shutil.copytree(BUNDLE, folder / "bundle"))
    manifest = json.loads((bundle / "manifest.json").read_text())
    change(manifest)
    raw = json.dumps(manifest).encode()
    (bundle / "manifest.json").write_bytes(raw)
    (bundle / SEAL).write_bytes(seal(raw))
    return bundle


def refused(made: Made, *recordings: Path, more: tuple[str, ...] = (), bundle: Path = BUNDLE) -> str:
    with pytest.raises(InputError) as caught:
        evaluate(made, *recordings, more=more, bundle=bundle)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("change", [lambda m: m.update(detectors=[]), lambda m: m.pop("detectors")])
def test_a_bundle_without_thresholds_is_refused(
    made: Made, tmp_path: Path, change: Callable[[dict[str, Any]], None]
) -> None:
    bundle = remade(tmp_path, change)
    message = refused(made, made.recording("free"), bundle=bundle)
    assert "manifest.json: detectors: there are none, so the bundle has no thresholds; run `faultline tune`" in message
    assert message.endswith("then `faultline export`")


def test_a_recording_of_too_few_sensors_is_refused(made: Made) -> None:
    log = edited(made.recording("few"), 'sensor_set = "instrumented"', 'sensor_set = "production"')
    message = refused(made, log)
    assert message.startswith(f"{log / 'recording.toml'}: sensor_set is 'production', the bundle ")
    assert "needs 'instrumented'; give recordings of an instrumented vehicle" in message


def test_a_bundle_that_was_made_for_another_vehicle_is_said(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def other(manifest: dict[str, Any]) -> None:
        manifest["origin"]["vehicle"] = "truck-9"

    log = made.recording("free", stop_s=66.0)
    assert evaluate(made, log, bundle=remade(tmp_path, other)) == 0
    assert f"{log}: of vehicle 'bench', the bundle was made for 'truck-9'" in capsys.readouterr().err


def test_a_bundle_for_few_sensors_takes_recordings_of_more(made: Made, tmp_path: Path) -> None:
    bundle = remade(tmp_path, lambda manifest: manifest.update(sensor_set="production"))
    assert evaluate(made, made.recording("free", stop_s=66.0), bundle=bundle) == 0


def test_the_same_recording_twice_is_refused(made: Made, tmp_path: Path) -> None:
    first, second = made.recording("first", stop_s=20.0), made.recording("second", stop_s=20.0)
    assert f"{first}: the same recording as {first}; give each once" in refused(made, first, first)
    assert f"{second}: the same recording as {first}; give each once" in refused(made, first, second)
    other = Made(tmp_path / "others", tmp_path / "truth").recording("first", stop_s=21.0)
    assert "id 'first' is another recording's too; each needs one of its own" in refused(made, first, other)


@pytest.mark.parametrize("part", ["calibrate", "train", "tune"])
def test_what_the_bundle_was_made_from_is_refused_among_others(made: Made, tmp_path: Path, part: str) -> None:
    from faultline.service.logs import open_log

    unseen, seen = made.recording("unseen", stop_s=20.0), made.recording("seen", stop_s=21.0)

    def change(manifest: dict[str, object]) -> None:
        origin = manifest["origin"]
        assert isinstance(origin, dict)
        origin[part].append(open_log(seen).sha256)
        if part != "tune":
            origin["tune"] = [sha for sha in origin["tune"] if sha != open_log(seen).sha256]

    bundle = remade(tmp_path, change)
    assert f"{seen}: the bundle was made from this recording; evaluate on one it has not seen" in refused(
        made, unseen, seen, bundle=bundle
    )


def ingested(log: Path, sha256: str) -> Path:
    """The recording as if it had been ingested from a bench's CAN log of this hash."""
    return edited(log, r"\Z", f'bench_sha256 = "{sha256}"\n')


def test_a_bench_recording_ingested_again_is_the_same_drive(made: Made, tmp_path: Path) -> None:
    """With another clock its log is another one."""
    first, second = (ingested(made.recording(name, stop_s=20.0 + k), "0" * 64) for k, name in enumerate("ab"))
    assert f"{second}: the same recording as {first}; give each once" in refused(made, first, second)
    bundle = remade(tmp_path, lambda manifest: manifest["origin"]["tune"].append("0" * 64))
    assert f"{first}: the bundle was made from this recording; evaluate on one" in refused(made, first, bundle=bundle)


def test_a_recording_without_a_truth_is_refused(made: Made) -> None:
    first, second = made.recording("first", stop_s=20.0), made.recording("second", stop_s=21.0)
    (made.truths / "second.toml").unlink()
    message = refused(made, first, second)
    assert message == (f"{made.truths}: no truth about 'second'; give its file, or a folder with second.toml")


def test_truths_are_found_in_files_and_folders(made: Made) -> None:
    first, second = made.recording("first", stop_s=66.0), made.recording("second", stop_s=67.0)
    files = [str(made.truths / "second.toml"), str(made.truths / "first.toml")]
    assert main([str(BUNDLE), str(first), str(second), "--truth", *files]) == 0


def test_a_fault_to_filter_by_must_be_known(made: Made) -> None:
    log = made.recording("leaky", stop_s=20.0, fault=clogged(name="leak_ap"))
    message = refused(made, log, more=("--fault", "fA_dou"))
    assert message.startswith("--fault fA_dou: no fault of the bundle or of these recordings; those are ")
    assert message.endswith("leak_ap")
    message = refused(made, log, more=("--fault", "fA_du"))
    assert message == "--fault fA_du: no recording has it or is fault-free; give one that has it"


def test_a_filter_keeps_the_fault_and_what_is_fault_free(made: Made, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [
        made.recording("free", stop_s=66.0),
        made.recording("du", fault=clogged()),
        made.recording("leaky", stop_s=65.0, fault=clogged(60.0, name="leak_ap")),
    ]
    assert evaluate(made, *logs, more=("--fault", "fA_du")) == 0
    told = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in told[:2]] == ["free", "du"]
    assert told[2].startswith("2 recordings, 0.1 h: 1 of 1 faults detected, the true diagnosis among those told of 1,")
    assert len(told) == 3


def test_a_fault_that_the_bundle_does_not_know_is_no_error(made: Made, capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate(made, made.recording("leaky", fault=clogged(name="leak_ap"))) == 1
    assert capsys.readouterr().out.startswith("leaky: leak_ap from 70 s, detected after ")


def test_several_verdicts_are_lines_of_json(made: Made, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [made.recording("a", stop_s=66.0), made.recording("b", stop_s=67.0)]
    assert evaluate(made, *logs, more=("--json",)) == 0
    told = capsys.readouterr()
    assert [json.loads(line)["recording"] for line in told.out.splitlines()] == ["a", "b"]
    assert "2 recordings, 0.0 h: 0 of 0 faults detected" in told.err


@pytest.mark.parametrize(("option", "value"), [("--picture", "x.png"), ("--events", "e.jsonl")])
def test_what_is_of_one_recording_is_refused_with_several(made: Made, option: str, value: str) -> None:
    logs = [made.recording("a", stop_s=20.0), made.recording("b", stop_s=21.0)]
    message = refused(made, *logs, more=(option, value))
    assert message == f"{option}: of one recording, here are 2; give one, or --report"


def test_a_recording_to_detail_must_be_among_them(made: Made) -> None:
    log = made.recording("a", stop_s=20.0)
    message = refused(made, log, more=("--detail", "b", "--report", str(made.truths / "report")))
    assert message == "--detail b: is none of the recordings; those are a"


@pytest.mark.parametrize(("option", "value"), [("--detail", "a"), ("--require", "fA_du")])
def test_what_is_about_the_report_needs_one(made: Made, option: str, value: str) -> None:
    message = refused(made, made.recording("a", stop_s=20.0), more=(option, value))
    assert message == f"{option}: is about the report; give --report DIR too"


def test_a_requirement_names_faults_of_the_bundle(made: Made) -> None:
    report = str(made.truths / "report")
    message = refused(made, made.recording("a", stop_s=20.0), more=("--require", "fA_tt:fA_du", "--report", report))
    assert message.startswith("--require fA_tt:fA_du: 'fA_tt' is no fault of the bundle; those are ")


def test_shown_over_time_is_the_largest_of_each_fault(made: Made) -> None:
    sizes = {"small": 0.2, "large": 0.6, "middle": 0.4}
    logs = [made.recording("free", stop_s=20.0), made.recording("free-too", stop_s=19.0)]
    logs += [made.recording(n, stop_s=21.0 + k, fault=clogged(size=size)) for k, (n, size) in enumerate(sizes.items())]
    chosen = given(load_bundle(BUNDLE), logs, [made.truths])
    assert detailed([], chosen) == ["free", "large"]
    assert detailed(["small"], chosen) == ["small"]


def test_a_report_is_a_folder(made: Made, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match=f"'{tmp_path}/file'"):
        refused(made, made.recording("a", stop_s=20.0), more=("--report", str(tmp_path / "file")))


def refused_at_once(made: Made, *logs: Path, more: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> str:
    """The message; no verdict was told before it, and no folder is left."""
    folder = made.truths / "new" / "report"
    message = refused(made, *logs, more=("--report", str(folder), *more))
    assert capsys.readouterr().out == ""
    assert not folder.parent.exists()
    return message


@pytest.mark.parametrize("onset_s", [0.0, 25.0])
def test_a_report_needs_a_fault_free_part(onset_s: float, made: Made, capsys: pytest.CaptureFixture[str]) -> None:
    log = made.recording("faulty", fault=clogged(onset_s=onset_s))
    message = refused_at_once(made, log, more=(), capsys=capsys)
    assert message.startswith(f"{log}: without a fault-free part of 30 s; a report needs one, add a recording without")


def test_a_report_needs_a_phase_of_maximum_dose(made: Made, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [made.recording("free", stop_s=60.0), made.recording("too", stop_s=59.0)]
    message = refused_at_once(made, *logs, more=(), capsys=capsys)
    assert message.startswith(f"{logs[0]}: like the others, never in mode maximum; a report needs every mode, ")
    assert message.endswith("add a recording that has it")


def test_a_system_without_a_mode_of_maximum_dose_is_reported_without_one(made: Made) -> None:
    whole = load_bundle(BUNDLE)
    steady = [mode for mode in whole.manifest.modes.steady if mode.name != "maximum"]
    modes = msgspec.structs.replace(whole.manifest.modes, steady=steady)
    bundle = whole._replace(manifest=msgspec.structs.replace(whole.manifest, modes=modes))
    check_reportable(given(bundle, [made.recording("free", stop_s=60.0)], [made.truths]), bundle)


@pytest.mark.parametrize(
    ("required", "words"),
    [
        ("fA_dos:fA_ori", "no generator isolates fA_dos from fA_ori by structure, in any recording; leave it out"),
        ("fA_t", "no recording has fA_t alone; add one, or leave it out"),
    ],
)
def test_what_cannot_be_required_is_told_at_once(
    required: str, words: str, made: Made, capsys: pytest.CaptureFixture[str]
) -> None:
    log = made.recording("dos", fault=clogged(name="fA_dos"))
    message = refused_at_once(made, log, more=("--require", required), capsys=capsys)
    assert message == f"--require {required}: {words}"


def test_what_no_generator_does_is_said_and_the_work_is_kept(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Structure allows it, but the fault moves none of those tests so far."""
    log, report = made.recording("du", fault=clogged()), tmp_path / "report"
    assert evaluate(made, log, more=("--report", str(report), "--require", "fA_du:fy_p_ap")) == 1
    assert "--require: fA_du isolated from fy_p_ap: by no generator in these recordings" in capsys.readouterr().err
    assert "Required, and done by no generator in these recordings: fA_du isol" in (report / "report.html").read_text()


@pytest.mark.parametrize(
    ("size", "unit", "words"),
    [(0.65, "1", "65 %"), (-0.1, "1", "-10 %"), (3000.0, "Pa", "30 mbar"), (-2e4, "Pa", "-0.2 bar"), (2.0, "", "2")],
)
def test_sizes_are_in_units_that_people_read(size: float, unit: str, words: str) -> None:
    fault = TrueFault(name="f", size=size, onset_s=1.0, profile="abrupt", unit=unit)
    assert size_text(fault, units_of(load_model("uds"))) == words
