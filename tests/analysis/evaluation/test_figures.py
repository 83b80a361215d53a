"""Figures of every test: what is drawn is what the story holds, and each says what it is."""

import hashlib
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
from made_set import BUNDLE, Made, clogged
from made_story import GOLDEN, IDLE, MAXIMUM, PARTIAL, bundle, known, story
from matplotlib.axes import Axes

from faultline.analysis.evaluation.command import main
from faultline.analysis.evaluation.given import learnt_from
from faultline.analysis.evaluation.report.document import Evaluation, evaluation
from faultline.analysis.evaluation.report.figures import bundles, operating_points, overlaid, prediction
from faultline.analysis.evaluation.report.figures.axes import Pair, reference
from faultline.analysis.evaluation.report.figures.page import page
from faultline.analysis.evaluation.report.histograms import NARROWEST
from faultline.analysis.evaluation.story import tell
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.logs import open_log

K = 900


def made(fault: str = "", name: str = "free", cycle: str = "drive") -> Pair:
    """A recording of 180 s, a minute a mode; with a fault t02 is off by 3 spreads from 60 s on, t08 by 1."""
    r, sums = np.zeros((K, 2)), np.zeros((K, 2))
    r[:, 0] = np.sin(np.arange(K))
    if fault:
        r[300:] += (3.0, 1.0)
        sums[300:] = (20.0, 5.0)
    whole = story(r, sums, mode=np.repeat([IDLE, PARTIAL, MAXIMUM], K // 3))
    whole = replace(whole, recording=name, z=np.tile(np.arange(5.0), (K, 1)))
    facts = known(whole, [fault] if fault else [])
    recording = msgspec.structs.replace(facts.given.recording, id=name, cycle=cycle)
    verdict = msgspec.structs.replace(facts.verdict, recording=name)
    return whole, replace(facts, given=facts.given._replace(recording=recording), verdict=verdict)


@pytest.fixture(scope="module")
def drawn() -> list[Pair]:
    return [made(), made("fA_du", "du", "validation"), made(name="same", cycle="validation")]


@pytest.fixture(scope="module")
def e(drawn: list[Pair]) -> Evaluation:
    return evaluation(bundle(), [one for _, one in drawn])


def lines(axes: Axes) -> list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """The y of what is drawn over time."""
    return [np.asarray(each.get_ydata()) for each in axes.lines if np.size(each.get_ydata()) > 2]


def test_a_faulty_residual_lies_over_that_of_the_same_cycle(drawn: list[Pair], e: Evaluation) -> None:
    """Sensitive panels are grey: t02 knows the filter, t08 does not."""
    compared = reference(drawn, drawn[1][1])
    assert compared is not None
    assert compared.recording == "same"
    [(figure, alt, _)] = overlaid.residuals(e, drawn)
    assert figure.get_size_inches()[0] >= NARROWEST  # the page widens what is narrower, and its height with it
    first, second = figure.axes
    free, faulty = lines(first)
    scale = e.tests[0].shown(e.tests[0].rms or 0.0).size
    np.testing.assert_allclose(free, drawn[2][0].r[:, 0] / scale)
    np.testing.assert_allclose(faulty, drawn[1][0].r[:, 0] / scale)
    assert first.get_facecolor() != second.get_facecolor() == (1.0, 1.0, 1.0, 1.0)
    assert "fA_du" in alt


def test_detectors_of_a_mode_are_of_its_ticks_alone(drawn: list[Pair], e: Evaluation) -> None:
    [(figure, _, caption)] = overlaid.detectors(e, drawn, "maximum")
    free, faulty, *_ = figure.axes
    assert [len(each) for each in lines(free)] == [K // 3, K // 3]
    np.testing.assert_allclose(lines(faulty)[0], 2.0)
    assert "in mode maximum alone" in caption
    [(whole, _, _)] = overlaid.detectors(e, drawn)
    assert len(lines(whole.axes[0])[0]) == K


def test_each_fault_is_shown_by_the_test_that_it_moves_most(drawn: list[Pair], e: Evaluation) -> None:
    [(figure, alt, _)] = prediction.most_moved(e, drawn)
    assert "fA_du by t02.ode" in alt
    left, right = figure.axes
    assert len(lines(left)) == len(lines(right)) == 2
    [(whole, _, caption)] = prediction.over_cycle(e, drawn)
    assert len(whole.axes) == 4  # two generators
    assert caption.startswith("free (cycle drive)")


def test_operating_points_are_of_what_the_bundle_was_made_from(drawn: list[Pair]) -> None:
    """Without those the fault-free recordings stand for them, and the caption says so."""
    learnt = np.full((50, 5), 7.0)
    [(figure, _, caption)] = operating_points.draw(drawn, [("training", learnt)])
    panels = [panel for panel in figure.axes if panel.get_visible()]
    assert len(panels) == 5 * 4 // 2
    assert [np.size(each.get_xdata()) for each in panels[0].lines] == [50, K - 300]
    assert "that the bundle was made from: training" in caption
    [(_, _, without)] = operating_points.draw(drawn, [])
    assert "that are shown without a fault" in without
    assert not [*operating_points.draw([drawn[1]], [])]


def test_another_bundle_is_drawn_where_it_predicts_something_else(drawn: list[Pair], e: Evaluation) -> None:
    whole = drawn[0][0]
    other = replace(whole, y_hat=whole.y_hat + np.array([2.0, 0.0]))
    [(figure, alt, _)] = bundles.draw(e, drawn, {"again": [other]})
    left, _ = figure.axes  # t08 is the same in both
    assert [line.get_label() for line in left.lines[:3]] == ["measured", e.bundle, "again"]
    assert "beside those of again" in alt
    assert not [*bundles.draw(e, drawn, {"same": [whole]})]


def test_a_page_without_recordings_shown_or_without_a_fault_is_whole(drawn: list[Pair], e: Evaluation) -> None:
    for some in ([], drawn[:1], drawn[1:2]):
        text = page(e, some)
        tree = ElementTree.fromstring(text.partition("\n")[2])  # noqa: S314
        assert ("Measured, predicted and residual of every test" in text) == any(not o.case.faults for _, o in some)
        assert all(len(image.get("alt", "")) > 20 for image in tree.iter("img"))


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("set")
    made = Made(folder / "logs", folder / "truth")
    made.recording("du", stop_s=89.0, fault=clogged())
    return made


def test_what_a_bundle_was_made_from_and_other_bundles_are_about_the_report(given: Made, tmp_path: Path) -> None:
    words = [str(BUNDLE), str(given.logs / "du"), "--truth", str(given.truths)]
    for option, value in (("--made-from", GOLDEN / "log"), ("--beside", BUNDLE)):
        with pytest.raises(InputError, match=f"{option}: is about the report; give --report DIR too"):
            main([*words, option, str(value)])
    report = ["--report", str(tmp_path / "r")]
    with pytest.raises(InputError, match="was not made from this recording; leave it out"):
        main([*words, *report, "--made-from", str(GOLDEN / "log")])
    with pytest.raises(InputError, match="none"):
        main([*words, *report, "--beside", str(tmp_path / "none")])
    assert not (tmp_path / "r" / "figures.html").exists()


def test_samples_of_what_a_bundle_was_made_from_are_as_the_vehicle_takes_them() -> None:
    whole = load_bundle(BUNDLE)
    log = hashlib.sha256((GOLDEN / "log" / "can.log").read_bytes()).hexdigest()
    origin = msgspec.structs.replace(whole.manifest.origin, tune=[log])
    made_from = whole._replace(manifest=msgspec.structs.replace(whole.manifest, origin=origin))
    [(name, z)] = learnt_from(made_from, [GOLDEN / "log"])
    assert name == "golden"
    assert z.shape[1] == len(whole.manifest.inputs)
    np.testing.assert_array_equal(z, tell(whole, open_log(GOLDEN / "log")).z)
