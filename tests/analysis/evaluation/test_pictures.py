"""Pictures of an evaluation: as wide as a page, and named after where the recording comes from."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from faultline.analysis.evaluation.judge import Verdict
from faultline.analysis.evaluation.measure.cases import Case
from faultline.analysis.evaluation.measure.facts import BINS, Facts
from faultline.analysis.evaluation.picture import _title
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.report.histograms import NARROWEST, _grid


@pytest.mark.parametrize("faults", [1, 2, 9])
def test_a_grid_of_histograms_is_no_higher_than_twice_its_width(faults: int) -> None:
    """The page shows it as wide as itself: of one fault it was 285 pixels wide, and became 4,500 high."""
    tests = [SimpleNamespace(generator=f"t{k}.ode", faults=[]) for k in range(10)]
    evaluation = cast(Evaluation, SimpleNamespace(tests=tests, faults={}))
    of = [
        cast(Facts, SimpleNamespace(case=Case((f"f{k}",), "large"), histogram=np.zeros((2, 10, BINS), dtype=np.int64)))
        for k in range(faults)
    ]
    figure, _, _ = _grid(evaluation, of, list(range(10)), [(f"f{k}",) for k in range(faults)])
    width, height = figure.get_size_inches()
    assert width >= NARROWEST
    assert height < 2.0 * width


@pytest.mark.parametrize(
    ("source", "words"),
    [("truck 17, winter test", "d (truck 17, winter test): fault-free"), (None, "d: fault-free")],
)
def test_a_title_says_simulated_only_where_the_recording_does(source: str | None, words: str) -> None:
    verdict = cast(Verdict, SimpleNamespace(recording="d", faults=[], false_alarms=0))
    assert _title(verdict, source).startswith(words)
