"""Every entry that was tried is told: its evidence or what was in sight, its best size, what speaks against it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from made_discovery import GAIN, discovery

from faultline.analysis.discrepancy.add.held_out import shown
from faultline.analysis.discrepancy.discover import Discovery
from faultline.analysis.discrepancy.name.attempt import Attempt, Glance
from faultline.analysis.discrepancy.name.tried import Tried
from faultline.analysis.discrepancy.show.build import document_of
from faultline.analysis.discrepancy.show.document import Entry, Origin, nats
from faultline.analysis.discrepancy.show.entries import entries
from faultline.analysis.discrepancy.show.page import page
from faultline.analysis.discrepancy.show.summary import summary

OTHER = "lag_p_du"


def told(found: Discovery, name: str = OTHER) -> Entry:
    return next(entry for entry in entries(found) if entry.name == name)


def with_single(name: str = OTHER, **changes: Any) -> Discovery:
    """The discovery with an attempt of an entry alone that has come to something else."""
    found = discovery(GAIN, own=OTHER)
    singles = [dataclasses.replace(a, **changes) if a.effects == (name,) else a for a in found.outcome.singles]
    return dataclasses.replace(found, outcome=dataclasses.replace(found.outcome, singles=tuple(singles)))


def with_tried(tried: Tried) -> Discovery:
    """The discovery in which an entry was not fitted to the end, and searched like this."""
    found = discovery(GAIN, own=OTHER)
    singles = tuple(a for a in found.outcome.singles if a.effects != (OTHER,))
    outcome = dataclasses.replace(found.outcome, singles=singles, tried={**found.outcome.tried, OTHER: tried})
    return dataclasses.replace(found, outcome=outcome)


def single_of(name: str = OTHER) -> Attempt:
    return next(a for a in discovery(GAIN, own=OTHER).outcome.singles if a.effects == (name,))


def test_every_entry_has_a_best_size_and_all_but_the_named_have_something_against_them() -> None:
    found = discovery(GAIN, own=OTHER)
    for entry in entries(found):
        assert entry.starts == 3, entry.name
        assert entry.best, entry.name
        assert {strength.parameter for strength in entry.best} >= {*found.study.library[entry.name].strengths}
        assert (entry.against == ()) == (entry.name == "full_open_gain"), entry.against
    named = told(found, "full_open_gain")
    low, high = named.best[0].interval or (None, None)
    assert low is not None
    assert high is not None
    assert low < GAIN < high
    assert named.sizes == 0  # the local search settled it


def test_what_is_wrong_with_where_a_fit_ended_is_said() -> None:
    single = single_of()
    k = single.unknowns.parameters.index("lag_p_du_tau")
    far, inside = single.x.copy(), single.inside.copy()
    far[k], inside[k] = 4.2, True
    assert "lag_p_du_tau goes 4 standard deviations from its prior" in told(with_single(x=far, inside=inside)).against
    inside[k] = False
    assert "lag_p_du_tau has gone to where its bound is" in told(with_single(x=far, inside=inside)).against
    nothing = np.where(np.arange(len(far)) == k, 0.0, far)
    assert "lag_p_du_tau has gone to where it does nothing" in told(with_single(x=nothing, inside=inside)).against
    assert "its fit is not at its end: 12 nats more are in sight" in told(with_single(promised=12.3)).against
    held = told(with_single(predicted=discovery(GAIN).outcome.nominal.predicted - 7.0)).against
    assert "worse in the held-out recordings by 7.0 nats" in held


def test_an_entry_that_is_named_is_told_with_what_is_doubtful_of_its_fit() -> None:
    single = single_of("full_open_gain")
    far = single.x.copy()
    far[single.unknowns.parameters.index("full_open_gain_g")] = 5.0
    named = told(with_single("full_open_gain", x=far), "full_open_gain")
    assert named.against == ("full_open_gain_g goes 5 standard deviations from its prior",)


def test_an_entry_that_promised_nothing_is_told_with_how_it_was_searched() -> None:
    single = single_of()
    glance = Glance((OTHER,), single.unknowns, single.x, single.cost, 0.0)
    local = told(with_tried(Tried(3, 0.0006, glance)))
    assert local.gain is None
    assert local.against == ("promised at most 0.0006 nats from 3 starts",)
    assert local.best[0].interval is None
    assert local.best[0].words.endswith("after a few steps")
    wide = told(with_tried(Tried(1, 0.1, glance, sizes=64, failed=5)))
    assert wide.against == (
        "promised at most 0.1 nats from 1 start and a global search of 64 sizes",
        "its model could not be run with 5 of 64 sizes",
    )
    assert (wide.starts, wide.sizes, wide.promised) == (1, 64, 0.1)
    nowhere = told(with_tried(Tried(3, sizes=16, failed=16)))
    assert nowhere.against == ("its model could not be run", "its model could not be run with 16 of 16 sizes")
    assert nowhere.best == ()


def test_page_and_summary_have_the_entries_that_were_tried() -> None:
    single = single_of()
    glance = Glance((OTHER,), single.unknowns, single.x, single.cost, 0.0)
    found = with_tried(Tried(3, 0.1, glance, sizes=64))
    runs = shown(found.study, found.baseline, found.outcome.nominal, found.outcome.chosen)
    document = document_of(found, runs, Origin(training=("t",), held_out=("v",), sources=()))
    text, html = summary(document), page(document, {})
    assert "| full_open_gain | " in text
    assert "Left behind after a few steps: 1, with at most 0.1 nats in sight; searched globally: 1 of them." in text
    for said in ("promised at most 0.1 nats from 3 starts and a global search of 64 sizes", "after a few steps"):
        assert said in html
    assert document.entries[0].best[0].words in html


@pytest.mark.parametrize(("value", "words"), [(0.00063, "0.00063 nats"), (3.14, "3.1 nats"), (2345.6, "2346 nats")])
def test_evidence_in_words(value: float, words: str) -> None:
    assert nats(value) == words
