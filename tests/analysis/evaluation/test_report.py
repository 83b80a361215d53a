"""The report of a small set: whole, readable without sight, the same each time, and its data keep their shape."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
from made_set import BUNDLE, Made, clogged
from made_story import bundle, event, known, story
from matplotlib.patches import Rectangle

from faultline.analysis.evaluation.command import main
from faultline.analysis.evaluation.report import traces
from faultline.analysis.evaluation.report.document import SCHEMA, Evaluation, evaluation
from faultline.analysis.evaluation.report.page import page
from faultline.analysis.evaluation.report.pictures import pictures
from faultline.service.core.manifest import Detector, LowPassDetector


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Fault-free, with a clogged filter, and with a fault that the bundle does not know."""
    folder = tmp_path_factory.mktemp("set")
    made = Made(folder / "logs", folder / "truth")
    made.recording("free", stop_s=69.0)
    made.recording("du", fault=clogged())
    made.recording("leaky", stop_s=119.0, fault=clogged(name="leak_ap", size=0.02))
    return made


@pytest.fixture(scope="module")
def report(made: Made, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(made, tmp_path_factory.mktemp("report"))


def written(made: Made, folder: Path) -> Path:
    logs = [str(made.logs / name) for name in ("free", "du", "leaky")]
    assert main([str(BUNDLE), *logs, "--truth", str(made.truths), "--report", str(folder)]) == 1  # the leak is named
    return folder


@pytest.fixture(scope="module")
def data(report: Path) -> Evaluation:
    return msgspec.json.decode((report / "report.json").read_bytes(), type=Evaluation)


@pytest.fixture(scope="module")
def tree(report: Path) -> ElementTree.Element:
    text = (report / "report.html").read_text()
    assert text.startswith("<!doctype html>\n")
    return ElementTree.fromstring(text.partition("\n")[2])  # noqa: S314 (it is ours); it raises where a tag is open


def test_the_page_is_one_file_that_needs_nothing_else(tree: ElementTree.Element, report: Path) -> None:
    assert tree.get("lang") == "en"
    assert not [*tree.iter("script"), *tree.iter("link"), *tree.iter("iframe")]
    assert all(image.get("src", "").startswith("data:image/png;base64,") for image in tree.iter("img"))
    assert "http" not in "".join(tree.itertext())
    assert sorted(path.name for path in report.iterdir()) == ["figures.html", "report.html", "report.json"]


def test_every_picture_has_words_and_every_table_heads(tree: ElementTree.Element) -> None:
    images, tables = [*tree.iter("img")], [*tree.iter("table")]
    assert len(images) >= 5  # histograms, curves, and three recordings over time
    assert all(len(image.get("alt", "")) > 20 for image in images)
    assert all((figure.findtext("figcaption") or "").strip() for figure in tree.iter("figure"))
    assert len(tables) >= 10
    for found in tables:
        assert (found.findtext("caption") or "").strip()
        assert all(th.get("scope") in ("col", "row") for th in found.iter("th"))
        columns = len(found.findall("thead/tr/th"))
        assert all(len(row) == columns and row[0].tag == "th" for row in found.findall("tbody/tr"))


def test_the_page_says_what_was_judged(tree: ElementTree.Element, data: Evaluation) -> None:
    text = " ".join("".join(tree.itertext()).split())
    assert "All data are simulated; no figure is of a real vehicle." in text
    contained = sum(case.contained.hits for case in data.isolation)
    assert f"2 of 2 faults were detected; at the end the true diagnosis was among those told of {contained}" in text
    assert "on 3 recordings of 0.09 h" in text
    assert ("Where diagnoses have no probability (before residuals have settled" in text) == data.told.shared
    headings = [heading.text for heading in tree.iter("h2")]
    assert "Equations and networks side by side" not in headings  # the bundle has equations alone
    assert headings[0] == "At a glance"
    assert headings[-2:] == ["What the terms mean", "What this does not say"]


FIELDS = {
    "recordings": "id source vehicle cycle case fault_free_hours faulty_hours detection_s isolation_s size verdict",
    "tests": "generator test predicts unit display faults states rms alarms blocks cannot_tell equals",
    "cells": "generator case sensitive alarm recordings standing delays_s median_delay_s cannot_tell auc",
    "isolation": "case true recordings detected delays_s median_delay_s contained alone ranks p sizes told scores",
    "told": "false_alarms scores shared",
    "selection": "keep drop alternatives false_blocks all_false_blocks free_blocks cost all_cost requirements unmet",
}


def test_the_data_keep_their_shape(report: Path) -> None:
    """A field that is renamed or taken away needs another schema."""
    raw = json.loads((report / "report.json").read_text())
    assert raw["schema"] == SCHEMA == "faultline.evaluation/1"
    plain = "schema bundle bundle_id sensor_set made_for model simulated faults modes mode_hours methods limits reached"
    assert sorted(raw) == sorted([*plain.split(), *FIELDS])
    found = {name: raw[name][0] if isinstance(raw[name], list) else raw[name] for name in FIELDS}
    assert {name: " ".join(entry) for name, entry in found.items()} == FIELDS
    assert [*raw["told"]["scores"]] == ["tdr", "far", "fia", "true_isolation", "false_isolation"]
    assert [*raw["cells"][0]["alarm"]] == ["hits", "trials", "p", "low", "high"]
    assert [*raw["tests"][0]["alarms"]] == ["events", "hours", "per_hour", "low", "high"]


def test_the_data_say_what_was_told(data: Evaluation) -> None:
    """One block of a minute after each onset; only t02 and its like have alarmed in it."""
    assert [one.case for one in data.recordings] == ["fault-free", "fA_du", "leak_ap"]
    du, leak = data.isolation
    assert (du.true, leak.true) == ("fA_du", "unknown")
    assert du.contained.hits == 1
    assert sum(du.told.values()) == pytest.approx(1.0, abs=2e-3)
    assert du.told["fA_du"] > 0.0
    assert du.scores.fia is not None
    assert 0.0 < du.scores.fia <= 1.0
    cells = {(cell.generator, cell.case): cell for cell in data.cells}
    assert len(cells) == 2 * len(data.tests) == 20
    assert cells["t02.ode", "fA_du"].sensitive is True
    assert cells["t08.ode", "fA_du"].sensitive is False
    assert cells["t02.ode", "leak_ap"].sensitive is None
    assert cells["t02.ode", "fA_du"].alarm.hits == 1
    assert cells["t08.ode", "fA_du"].alarm.hits == 0
    assert (data.told.false_alarms.events, data.simulated) == (0, True)
    warm_up_s = 20.0  # of each recording: no test can tell there, so its silence is no peace
    assert data.told.false_alarms.hours == pytest.approx((69 + 70 + 70 - 3 * warm_up_s) / 3600, abs=1 / 3600)
    assert {test.generator: test.equals for test in data.tests}["t20.ode"] in ("t08.ode", "t10.ode")


def test_the_same_recordings_give_the_same_bytes(made: Made, report: Path, tmp_path: Path) -> None:
    again = written(made, tmp_path / "again")
    for name in ("report.html", "report.json", "figures.html"):
        assert (again / name).read_bytes() == (report / name).read_bytes()


def test_a_report_without_a_fault_leaves_out_what_needs_one(made: Made, tmp_path: Path) -> None:
    arguments = [str(BUNDLE), str(made.logs / "free"), "--truth", str(made.truths), "--report", str(tmp_path / "r")]
    assert main(arguments) == 0
    text = (tmp_path / "r" / "report.html").read_text()
    ElementTree.fromstring(text.partition("\n")[2])  # noqa: S314
    assert "No recording has a fault." in text
    assert "No generator reaches a fault of these recordings" in text
    assert "Fault signature matrix" not in text


def test_a_short_recording_and_a_fault_that_does_not_come_are_no_obstacle(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Twelve seconds have no block; a fault that begins behind the log's end is in neither verdict nor report."""
    short = made.recording("short", stop_s=12.0)
    late = made.recording("late", stop_s=68.0, fault=clogged(onset_s=500.0, name="fA_t"))
    arguments = [str(BUNDLE), str(short), str(late), "--truth", str(made.truths), "--report", str(tmp_path / "r")]
    assert main(arguments) == 1
    found = msgspec.json.decode((tmp_path / "r" / "report.json").read_bytes(), type=Evaluation)
    assert [(one.case, one.faulty_hours, one.verdict.faults) for one in found.recordings] == 2 * [("fault-free", 0, [])]
    assert not found.cells
    assert not found.isolation
    told = capsys.readouterr()
    assert "late: fault-free, 0 false alarms" in told.out
    assert f"{late}: fA_t begins at 500 s, the log ends before; left out" in told.err
    ElementTree.fromstring((tmp_path / "r" / "report.html").read_text().partition("\n")[2])  # noqa: S314


def test_a_folder_that_cannot_be_written_is_told(made: Made, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    arguments = [str(BUNDLE), str(made.logs / "free"), "--truth", str(made.truths)]
    with pytest.raises(NotADirectoryError, match=f"'{tmp_path}/file'"):
        main([*arguments, "--report", str(tmp_path / "file" / "below")])


def test_networks_are_shown_beside_equations() -> None:
    """Made: both generators are taken as ones of t02, in two graphs; unknown and a pair are told."""
    r, sums = np.zeros((1200, 2)), np.zeros((1200, 2))
    r[600:, 0] = 3.0
    sums[650:, 0] = 11.0
    mode = np.repeat([0.0, 2.0, 1.0, 2.0], 300)
    whole = replace(story(r, sums, mode=mode), events=[event(700, ("", 1), ("fA_du+fA_t", 2))])
    one = known(whole, ["fA_du"], 120.0, whole.events)
    made = bundle()
    first, second = made.manifest.generators
    network = msgspec.structs.replace(second, test="t02", name="t02.rnn", faults=first.faults)
    made = made._replace(manifest=msgspec.structs.replace(made.manifest, generators=[first, network]))
    found = evaluation(made, [one])
    assert [method.generator for method in found.methods] == ["t02.ode", "t02.rnn", "together"]
    assert found.isolation[0].told == {"unknown": 1.0}
    drawn = pictures(found, [one], [whole])
    assert len(drawn["methods"]) == 1
    text = page(found, drawn)
    ElementTree.fromstring(text.partition("\n")[2])  # noqa: S314
    assert "Equations and networks side by side" in text


def test_traces_say_what_tests_what_is_not_drawn_and_what_was_told() -> None:
    """Made: two generators with the same residual and low-pass detectors; one diagnosis, from 140 s on."""
    r, sums = np.full((1200, 2), 3.0), np.zeros((1200, 2))
    made = bundle()
    detectors: list[Detector] = [
        LowPassDetector(generator=d.generator, offset=d.offset, scale=d.scale, J=1.0, hold_s=1.0, time_s=1.0)
        for d in made.manifest.detectors
    ]
    made = made._replace(manifest=msgspec.structs.replace(made.manifest, detectors=detectors))
    whole = replace(story(r, sums), bundle=made, events=[event(0), event(700, ("fA_du", 1), ("fA_t", 2))])
    one = known(whole, ["fA_du"], 120.0, whole.events)
    figure, alt, caption = traces.draw(evaluation(made, [one]), whole, one)
    told, *panels = figure.axes
    assert [panel.get_title() for panel in panels] == ["residual", "low-pass in parts of its threshold"]
    assert "detectors (low-pass)" in alt
    assert caption.endswith("Not drawn, being the same signal as another: t08.ode (as t02.ode).")
    assert [label.get_text() for label in told.get_yticklabels()] == ["fA_du", "fA_t"]
    bars = [bar for bar in told.patches if isinstance(bar, Rectangle) and bar.get_height() == 0.7]
    assert {bar.get_x() for bar in bars} == {140.0}


def test_hostile_names_are_text_and_no_markup(data: Evaluation) -> None:
    sly = "<script>alert('1')</script>&"
    one, *rest = data.recordings
    recordings = [msgspec.structs.replace(one, id=sly, vehicle=sly), *rest]
    made = msgspec.structs.replace(data, bundle=sly, recordings=recordings, faults={sly: sly})
    tree = ElementTree.fromstring(page(made, {}).partition("\n")[2])  # noqa: S314
    assert not [*tree.iter("script")]
    texts = {*tree.itertext()}
    assert {sly, f"What bundle {sly} tells, against the truth", f"Evaluation of bundle {sly}"} <= texts
