"""`faultline evaluate` on the golden log, where a filter loses 65 % of its area at 70 s."""

import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from faultline.analysis.evaluation.command import main
from faultline.analysis.evaluation.judge import judge
from faultline.analysis.evaluation.story import Story, tell
from faultline.analysis.evaluation.truth import load_truth
from faultline.service.bundle.files import SEAL, seal
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.line import encode
from faultline.service.core.signals.gate import Gate
from faultline.service.logs import open_log

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
LOG, BUNDLE, TRUTH, EVENTS = GOLDEN / "log", GOLDEN / "bundle", GOLDEN / "truth.toml", GOLDEN / "events.jsonl"


def evaluate(*more: str | Path, truth: Path = TRUTH, bundle: Path = BUNDLE) -> int:
    return main(list(map(str, [bundle, LOG, "--truth", truth, *more])))


def lines() -> list[dict[str, Any]]:
    return [json.loads(line) for line in EVENTS.read_text().splitlines()]


def peaceful() -> list[dict[str, Any]]:
    """The golden events up to the first alarm."""
    events = lines()
    return events[: [event["transition"] for event in events].index("occurred")]


def written(path: Path, events: list[dict[str, Any]]) -> Path:
    path.write_text("".join(json.dumps(event) + "\n" for event in events))
    return path


@pytest.fixture(scope="module")
def story() -> Story:
    return tell(load_bundle(BUNDLE), open_log(LOG))


def test_the_story_is_the_monitors_with_everything_in_it(story: Story) -> None:
    """Watching must change nothing that is told."""
    bundle, log = story.bundle, open_log(LOG)
    alone = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id)
    assert story.events == list(alone.log(log.relative()))
    assert {"started", "cannot_tell", "suspected", "occurred", "refined"} == {
        event.transition for event in story.events
    }
    ticks, tests = story.r.shape
    assert tests == len(story.bundle.manifest.generators)
    assert story.sums.shape == story.usable.shape == story.y_hat.shape == (ticks, tests)
    assert story.origin_s == story.t_s[0]
    np.testing.assert_allclose(np.diff(story.t_s), story.bundle.manifest.period_s)
    signals = [channel.signal for channel in story.bundle.manifest.inputs]
    columns = [signals.index(generator.predicts) for generator in story.bundle.manifest.generators]
    gate = Gate(story.bundle.manifest.inputs)
    usable = ~np.isnan(story.z)
    passed = np.array([gate.passed(z, good) for z, good in zip(story.z, usable, strict=True)])
    assert (passed != story.z).any(axis=1).mean() < 0.1
    np.testing.assert_allclose(story.r, passed[:, columns] - story.y_hat, atol=1e-6)


def test_the_residual_that_explains_the_filter_moves_after_the_onset_alone(story: Story) -> None:
    """Below the prediction: a clogged filter takes pressure away behind it."""
    t02 = story.r[:, 0]
    before = t02[(story.t_s > 40.0) & (story.t_s < 70.0)]
    after = t02[story.t_s > 80.0]
    assert abs(before.mean()) < 1e3
    assert after.mean() < -5e3


def test_the_golden_fault_is_contained_without_a_false_alarm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "new" / "story.png"
    assert evaluate("--json", "--picture", picture) == 0
    verdict = json.loads(capsys.readouterr().out)
    assert verdict["recording"] == "golden"
    assert verdict["faults"] == ["fA_du"]
    assert verdict["contained"] is True
    assert verdict["false_alarms"] == 0
    assert verdict["first"][0] == "fA_du"
    assert 0.0 < verdict["delay_s"] < 20.0  # a dose ends with the onset: 8 s are an edge
    raw = picture.read_bytes()
    assert raw[:8] == b"\x89PNG\r\n\x1a\n"
    assert raw[-8:-4] == b"IEND"
    assert len(raw) > 20_000


def test_the_sentence_says_when_what_and_how_peacefully(capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate() == 0
    out = capsys.readouterr().out
    found = re.fullmatch(
        r"golden: fA_du from 70 s, detected after ([0-9.]+) s, isolated {(.*)}, first fA_du(?:, fy_p_ap)?; "
        r"0 false alarms before\n",
        out,
    )
    assert found is not None
    assert 0.0 < float(found[1]) < 20.0
    assert "fA_du" in found[2].split(", ")


def test_given_events_are_judged_instead_of_its_own(
    story: Story, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own.jsonl"
    own.write_bytes(b"".join(map(encode, story.events)))
    assert evaluate("--json", "--events", own) == 0
    verdict = json.loads(capsys.readouterr().out)
    tests = [generator.test for generator in story.bundle.manifest.generators]
    own_verdict = judge(load_truth(TRUTH, "golden"), story.events, tests, story.origin_s, story.end_s)
    assert verdict == {**msgspec.to_builtins(own_verdict), "apart_ticks": 0}

    wrong = lines()
    for event in wrong:
        for diagnosis in event["diagnoses"]:
            diagnosis["faults"] = ["fA_t"]
    assert evaluate("--json", "--events", written(tmp_path / "wrong.jsonl", wrong)) == 1
    verdict = json.loads(capsys.readouterr().out)
    assert (verdict["detected"], verdict["contained"], verdict["isolated"]) == (True, False, ["fA_t"])

    assert evaluate("--events", written(tmp_path / "silent.jsonl", peaceful())) == 1
    assert "fA_du from 70 s, not detected; 0 false alarms before" in capsys.readouterr().out


def test_a_false_alarm_is_a_no_even_where_the_fault_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    events, before = lines(), peaceful()
    early = {**events[len(before)], "tick": 300, "t_s": 60.0}
    assert evaluate("--json", "--events", written(tmp_path / "e.jsonl", [*before, early, *events[len(before) :]])) == 1
    verdict = json.loads(capsys.readouterr().out)
    assert (verdict["false_alarms"], verdict["contained"]) == (1, True)


def test_against_a_fault_free_truth_every_alarm_is_false(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = tmp_path / "truth.toml"
    truth.write_text('schema = 1\nrecording = "golden"\n')
    assert evaluate(truth=truth) == 1
    assert capsys.readouterr().out == "golden: fault-free, 1 false alarms\n"
    assert evaluate("--events", written(tmp_path / "quiet.jsonl", peaceful()), truth=truth) == 0
    assert capsys.readouterr().out == "golden: fault-free, 0 false alarms\n"


@pytest.mark.parametrize("part", ["calibrate", "tune"])
def test_a_recording_that_the_bundle_was_made_from_is_refused(tmp_path: Path, part: str) -> None:
    bundle = Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    manifest = json.loads((bundle / "manifest.json").read_text())
    manifest["origin"][part].append(open_log(LOG).sha256)
    raw = json.dumps(manifest).encode()
    (bundle / "manifest.json").write_bytes(raw)
    (bundle / SEAL).write_bytes(seal(raw))
    with pytest.raises(InputError, match="the bundle was made from this recording; evaluate on one it has not seen"):
        evaluate(bundle=bundle)


def test_a_recording_in_which_no_test_could_tell_is_no_peace(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sensor box is unplugged: nine tests are blind and the verdict says so, fault-free or not."""
    log = Path(shutil.copytree(LOG, tmp_path / "log"))
    lines = (log / "can.log").read_text().splitlines(keepends=True)
    (log / "can.log").write_text("".join(line for line in lines if " 18FF20F9#" not in line))
    truth = tmp_path / "truth.toml"
    truth.write_text('schema = 1\nrecording = "golden"\n')
    picture = tmp_path / "blind.png"
    assert main([str(BUNDLE), str(log), "--truth", str(truth), "--picture", str(picture)]) == 1
    assert picture.stat().st_size > 20_000
    assert "fault-free, 0 false alarms; t02, t06, t08, t09, t10, t12, t13, t19, t20 could never tell" in (
        capsys.readouterr().out
    )


def test_the_truth_of_another_recording_is_refused(tmp_path: Path) -> None:
    truth = tmp_path / "truth.toml"
    truth.write_text(TRUTH.read_text().replace('"golden"', '"silver"'))
    with pytest.raises(InputError, match="is about 'silver', not about 'golden'"):
        evaluate(truth=truth)


def test_what_a_service_told_of_the_recording_is_judged(tmp_path: Path) -> None:
    """Its ids have the run in them besides."""
    path = tmp_path / "events.jsonl"
    path.write_text(EVENTS.read_text().replace('"id":"golden-', '"id":"golden-d4ba119b-'))
    assert evaluate("--events", path) == evaluate("--events", EVENTS)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"not found; `faultline watch --json` writes events"),
        ("{}\n", "line 1: not an event: Object missing required field"),
        (EVENTS.read_text() + "half a line {", r"line \d+: not an event: JSON is malformed"),
        ("", "holds no event, not even that the service started; was it running"),
        (EVENTS.read_text().replace('"id":"golden-', '"id":"other-'), "is about 'other', not about 'golden'"),
        (EVENTS.read_text().replace('"id":"golden-', '"id":"golden-2-'), "is about 'golden-2', not about 'golden'"),
        (re.sub('"bundle":"[0-9a-f]{12}', '"bundle":"' + 12 * "0", EVENTS.read_text()), "told by bundle 000000000000"),
    ],
)
def test_a_file_that_holds_no_events_is_refused(tmp_path: Path, content: str | None, message: str) -> None:
    path = tmp_path / "events.jsonl"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=message):
        evaluate("--events", path)


def test_a_recording_of_another_dbc_is_refused(tmp_path: Path) -> None:
    log = Path(shutil.copytree(LOG, tmp_path / "log"))
    (log / "uds.dbc").write_text((log / "uds.dbc").read_text() + "\n")
    described = (log / "recording.toml").read_text()
    other = hashlib.sha256((log / "uds.dbc").read_bytes()).hexdigest()
    (log / "recording.toml").write_text(re.sub(r'dbc_sha256 = "\w+"', f'dbc_sha256 = "{other}"', described))
    with pytest.raises(InputError, match=f"recorded with DBC {other[:12]}, the bundle was made for"):
        main([str(BUNDLE), str(log), "--truth", str(TRUTH)])


@pytest.mark.parametrize("name", ["story.txt", "story", "folder/"])
def test_a_picture_is_a_png(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"no name of a picture; give one that ends in \.png"):
        evaluate("--picture", tmp_path / name)


def test_a_bare_log_is_refused() -> None:
    with pytest.raises(InputError, match="a bare log names no DBC; give its recording's folder"):
        main([str(BUNDLE), str(LOG / "can.log"), "--truth", str(TRUTH)])
