"""`faultline evaluate` on the golden log, where a filter loses 65 % of its area at 70 s."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from analysis.evaluation.command import main
from analysis.evaluation.judge import judge
from analysis.evaluation.story import Story, tell
from analysis.evaluation.truth import load_truth
from service.bundle import load_bundle
from service.core.errors import InputError
from service.core.events import encode
from service.core.monitor import Monitor
from service.logs import open_log

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
LOG, BUNDLE, TRUTH, EVENTS = GOLDEN / "log", GOLDEN / "bundle", GOLDEN / "truth.toml", GOLDEN / "events.jsonl"


def evaluate(*more: str | Path, truth: Path = TRUTH, bundle: Path = BUNDLE) -> int:
    return main(list(map(str, [LOG, "--bundle", bundle, "--truth", truth, *more])))


def lines() -> list[dict[str, Any]]:
    return [json.loads(line) for line in EVENTS.read_text().splitlines()]


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
    assert [event.transition for event in story.events[:3]] == ["started", "cannot_tell", "occurred"]
    ticks, tests = story.r.shape
    assert tests == len(story.bundle.manifest.generators)
    assert story.sums.shape == story.usable.shape == story.y_hat.shape == (ticks, tests)
    assert story.origin_s == story.t_s[0]
    np.testing.assert_allclose(np.diff(story.t_s), story.bundle.manifest.period_s)
    signals = [channel.signal for channel in story.bundle.manifest.inputs]
    columns = [signals.index(generator.predicts) for generator in story.bundle.manifest.generators]
    np.testing.assert_allclose(story.r, story.z[:, columns] - story.y_hat, atol=1e-6)


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
    assert verdict["first"] == ["fA_du"]
    assert 0.0 < verdict["delay_s"] < 15.0
    raw = picture.read_bytes()
    assert raw[:8] == b"\x89PNG\r\n\x1a\n"
    assert raw[-8:-4] == b"IEND"
    assert len(raw) > 20_000


def test_the_sentence_says_when_what_and_how_peacefully(capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate() == 0
    out = capsys.readouterr().out
    found = re.fullmatch(
        r"golden: fA_du from 70 s, detected after ([0-9.]+) s, isolated {(.*)}, first fA_du; 0 false alarms before\n",
        out,
    )
    assert found is not None
    assert 0.0 < float(found[1]) < 15.0
    assert "fA_du" in found[2].split(", ")


def test_given_events_are_judged_instead_of_its_own(
    story: Story, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own.jsonl"
    own.write_bytes(b"".join(map(encode, story.events)))
    assert evaluate("--json", "--events", own) == 0
    verdict = json.loads(capsys.readouterr().out)
    assert verdict == msgspec.to_builtins(judge(load_truth(TRUTH, "golden"), story.events, story.origin_s))

    wrong = lines()
    for event in wrong:
        for diagnosis in event["diagnoses"]:
            diagnosis["faults"] = ["fA_t"]
    assert evaluate("--json", "--events", written(tmp_path / "wrong.jsonl", wrong)) == 1
    verdict = json.loads(capsys.readouterr().out)
    assert (verdict["detected"], verdict["contained"], verdict["isolated"]) == (True, False, ["fA_t"])

    assert evaluate("--events", written(tmp_path / "silent.jsonl", lines()[:2])) == 1
    assert "fA_du from 70 s was not detected; 0 false alarms before" in capsys.readouterr().out


def test_a_false_alarm_is_a_no_even_where_the_fault_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    events = lines()
    early = {**events[2], "tick": 200, "t_s": 40.0}
    assert evaluate("--json", "--events", written(tmp_path / "e.jsonl", [*events[:2], early, *events[2:]])) == 1
    verdict = json.loads(capsys.readouterr().out)
    assert (verdict["false_alarms"], verdict["contained"]) == (1, True)


def test_against_a_fault_free_truth_every_alarm_is_false(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = tmp_path / "truth.toml"
    truth.write_text('schema = 1\nrecording = "golden"\n')
    assert evaluate(truth=truth) == 1
    assert capsys.readouterr().out == "golden: fault-free, 1 false alarms\n"
    assert evaluate("--events", written(tmp_path / "quiet.jsonl", lines()[:2]), truth=truth) == 0
    assert capsys.readouterr().out == "golden: fault-free, 0 false alarms\n"


@pytest.mark.parametrize("part", ["calibrate", "tune"])
def test_a_recording_that_the_bundle_was_made_from_is_refused(tmp_path: Path, part: str) -> None:
    bundle = Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    manifest = json.loads((bundle / "manifest.json").read_text())
    manifest["origin"][part].append(open_log(LOG).sha256)
    (bundle / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="the bundle was made from this recording; evaluate on one it has not seen"):
        evaluate(bundle=bundle)


def test_the_truth_of_another_recording_is_refused(tmp_path: Path) -> None:
    truth = tmp_path / "truth.toml"
    truth.write_text(TRUTH.read_text().replace('"golden"', '"silver"'))
    with pytest.raises(InputError, match="is about 'silver', not about 'golden'"):
        evaluate(truth=truth)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"not found; `faultline watch --json` writes events"),
        ("{}\n", "line 1: not an event: Object missing required field"),
        (EVENTS.read_text() + "half a line {", "line 7: not an event: JSON is malformed"),
    ],
)
def test_a_file_that_holds_no_events_is_refused(tmp_path: Path, content: str | None, message: str) -> None:
    path = tmp_path / "events.jsonl"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=message):
        evaluate("--events", path)


def test_a_bare_log_is_refused() -> None:
    with pytest.raises(InputError, match="a bare log names no DBC; give its recording's folder"):
        main([str(LOG / "can.log"), "--bundle", str(BUNDLE), "--truth", str(TRUTH)])
