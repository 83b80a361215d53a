"""What is written about a discovery: the same in every form, for a program, a review and a page."""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
import pytest
from made_discovery import ENTRIES, GAIN, discovery

from faultline.analysis.discrepancy.add.bundle_effect import Bundled, BundleEffect
from faultline.analysis.discrepancy.add.drift import drifts
from faultline.analysis.discrepancy.add.held_out import Shown, shown
from faultline.analysis.discrepancy.add.structure_change import structure_change
from faultline.analysis.discrepancy.discover import Discovery, Kind, verdict_of
from faultline.analysis.discrepancy.effects.compiled import model_with
from faultline.analysis.discrepancy.effects.experiments import Experiment, load_experiments
from faultline.analysis.discrepancy.find.onset import Onset
from faultline.analysis.discrepancy.name.experiment import Plan
from faultline.analysis.discrepancy.name.gauge import Gauge
from faultline.analysis.discrepancy.show.abscissa import abscissa_of
from faultline.analysis.discrepancy.show.build import document_of
from faultline.analysis.discrepancy.show.document import Document, Origin, Section, Zero, encoded
from faultline.analysis.discrepancy.show.extras import Extras
from faultline.analysis.discrepancy.show.page import page
from faultline.analysis.discrepancy.show.report import files_of
from faultline.analysis.discrepancy.show.sentences import MOST, sentences
from faultline.analysis.discrepancy.show.sizes import sizes
from faultline.analysis.discrepancy.show.summary import summary
from faultline.analysis.discrepancy.show.verdicts import limits, next_steps, sentence_of
from faultline.analysis.model.display import Units
from faultline.analysis.model.file import SYSTEMS

UDS_EXPERIMENTS = load_experiments(SYSTEMS / "uds")
ORIGIN = Origin(
    training=("t-1",), held_out=("v-1",), sources=("simulated by the rig",), vehicle="truck-1", missing=("too short",)
)
KINDS: tuple[Kind, ...] = ("nothing missing", "named", "one of", "unnamed")


def described(found: Discovery, origin: Origin, extras: Extras | None = None) -> tuple[Document, Shown]:
    """The document, and the free runs that it tells of."""
    runs = shown(found.study, found.baseline, found.outcome.nominal, found.outcome.chosen)
    return document_of(found, runs, origin, extras), runs


@pytest.fixture(scope="module")
def told() -> tuple[Document, Shown]:
    found = discovery()
    nominal, chosen = found.outcome.nominal, found.outcome.chosen
    entries = [found.study.library[name] for name in chosen.effects]
    extras = Extras(
        experiments=UDS_EXPERIMENTS,
        drifts=drifts(found.study.model, nominal, chosen),
        structure=structure_change(found.study.model, model_with(found.study.model, entries), chosen),
    )
    return described(found, ORIGIN, extras)


@pytest.fixture(scope="module")
def document(told: tuple[Document, Shown]) -> Document:
    return told[0]


@pytest.fixture(scope="module")
def written(told: tuple[Document, Shown]) -> dict[str, bytes]:
    return files_of(discovery(), *told)


def as_kind(document: Document, kind: Kind) -> Document:
    """The same, as if it had come to another verdict."""
    [place] = document.verdict.places
    twin = msgspec.structs.replace(place.candidates[0], name="twin", statement="a twin of it")
    candidates = (place.candidates[0], twin) if kind == "one of" else place.candidates
    places = () if kind == "nothing missing" else (msgspec.structs.replace(place, candidates=candidates),)
    verdict = msgspec.structs.replace(
        document.verdict,
        kind=kind,
        places=places,
        remainder=300.0,
        sentence=sentence_of(kind, places, document.located.sentences[0]),
    )
    rest: dict[str, Any] = {"strengths": ()} if kind == "nothing missing" else {}
    return msgspec.structs.replace(document, verdict=verdict, **rest)


def test_a_program_reads_what_was_found(written: Mapping[str, bytes], document: Document) -> None:
    read = msgspec.json.decode(written["discovery.json"], type=Document)
    assert read.verdict == document.verdict
    assert read.regimes == document.regimes
    assert (read.verdict.kind, read.schema) == ("named", "faultline.discovery/1")
    [strength] = read.strengths
    low, high = strength.interval or (None, None)
    assert low is not None
    assert high is not None
    assert low < GAIN < high
    assert strength.parameter == "full_open_gain_g"
    assert read.located.course is not None
    assert read.left.course is not None
    assert read.located.course.equation == read.left.course.equation == read.located.equations[0]
    assert max(read.located.course.value) > 100.0 * max(np.abs(read.left.course.value))
    assert read.entries[0].name == "full_open_gain"
    assert {entry.name for entry in read.entries} == {*ENTRIES}
    assert all(zero.recording == "v-1" for zero in read.zeros)
    assert read.evidence.held_out_after > read.evidence.held_out_before
    assert b"NaN" not in written["discovery.json"]


def test_the_same_discovery_gives_the_same_bytes(written: Mapping[str, bytes], told: tuple[Document, Shown]) -> None:
    assert files_of(discovery(), *told) == dict(written)


def test_entries_that_have_no_place_say_why(document: Document) -> None:
    entry = msgspec.structs.replace(document.entries[-1], no_place="it has no <pump>")
    other = msgspec.structs.replace(document, entries=(*document.entries[:-1], entry))
    assert "no place in this model: it has no &lt;pump&gt;" in page(other, {})
    assert any("have no place in this model" in limit for limit in limits(other))


def test_an_entry_whose_model_could_not_be_run_is_not_silently_out(document: Document) -> None:
    entry = msgspec.structs.replace(document.entries[-1], gain=None, halted="u4.toml: does not converge at 3 s")
    other = msgspec.structs.replace(document, entries=(*document.entries[:-1], entry))
    said = f"{entry.name} may be it all the same: its model could not be run from everywhere"
    for text in (summary(other), "\n".join(sentences(other)), page(other, {})):
        assert re.search(f"{said}.*does not converge at 3 s", text, flags=re.IGNORECASE), text


@pytest.mark.parametrize("gain", [0.0, GAIN])
def test_an_entry_of_the_users_own_is_told_with_what_speaks_against_it(gain: float) -> None:
    """The wound: entries that promised nothing in a few steps had no evidence, and no word in the summary."""
    document, _ = described(discovery(gain, own="lag_p_du"), ORIGIN)
    [entry] = [entry for entry in document.entries if entry.own]
    assert entry.name == "lag_p_du"
    assert entry.gain is not None
    assert entry.gain < document.verdict.threshold
    assert f"{document.verdict.threshold:.1f} nats are asked for" in entry.against
    assert any(reason.startswith("full_open_gain brings ") for reason in entry.against) == bool(gain)
    said = f"your entry lag_p_du: {entry.gain:.1f} nats ("
    for text in (summary(document), "\n".join(sentences(document)), page(document, {})):
        assert re.search(f"{re.escape(said)}.*; against it: .* nats are asked for", text, flags=re.IGNORECASE), text


def test_an_entry_of_the_users_own_that_is_named_has_nothing_against_it() -> None:
    document, _ = described(discovery(GAIN, own="full_open_gain"), ORIGIN)
    assert [entry.against for entry in document.entries if entry.own] == [()]
    assert "your entry" not in summary(document)


def test_an_entry_of_the_users_own_that_is_not_its_name_or_has_no_place_says_so() -> None:
    found = discovery(GAIN, own="full_open_gain")
    unnamed = dataclasses.replace(found, verdict=dataclasses.replace(found.verdict, kind="unnamed", remainder=80.0))
    document, _ = described(unnamed, ORIGIN)
    [entry] = [entry for entry in document.entries if entry.own]
    assert entry.against == ("with it in, 80 nats of evidence for an unknown input are left",)
    elsewhere = dataclasses.replace(found, unfit={"mine": "uds_production has no q_pumpe"}, own=("mine",))
    document, _ = described(elsewhere, ORIGIN)
    assert "your entry mine: no evidence; against it: uds_production has no q_pumpe" in "\n".join(sentences(document))


@pytest.mark.parametrize("kind", KINDS)
def test_every_verdict_is_told_in_every_form(document: Document, kind: Kind) -> None:
    d = as_kind(document, kind)
    lines = sentences(d)
    assert len(lines) <= MOST
    assert lines[0] == d.verdict.sentence
    md = summary(d)
    assert md.count("\n") < 70
    assert "simulated" in md
    assert all(f"## {title}" in md for title in ("What was found", "How sure this is", "What to do next"))
    html = page(d, {})
    assert f"{d.verdict.sentence[1:]}." in html
    assert "no figure is of a real vehicle" in html


def test_what_is_next_depends_on_the_verdict(document: Document) -> None:
    assert "--apply" in next_steps(as_kind(document, "named"))[0]
    assert next_steps(as_kind(document, "one of")) == [
        "record what may tell them apart: the dose in ten steps from almost nothing to maximum"
    ]
    assert "--library" in next_steps(as_kind(document, "unnamed"))[0]
    assert "q_dos" in next_steps(as_kind(document, "unnamed"))[1]
    refused = msgspec.structs.replace(as_kind(document, "named"), refused=("its gain has run into its bound",))
    assert "its gain has run into its bound" in next_steps(refused)[0]
    assert "its gain has run into its bound" in summary(refused)
    several = msgspec.structs.replace(refused, verdict=as_kind(document, "one of").verdict)
    assert "not added: its gain has run into its bound" in sentences(several)


def test_what_cannot_be_planned_is_advised_where_no_plan_tells(document: Document) -> None:
    """Gains of two sensors: the pump's decay tells them, which no model here can plan."""
    weak = Section(sentences=("nothing that can be planned",), data={"tells": False})
    d = as_kind(document, "one of")
    place = d.verdict.places[0]
    slow = tuple(msgspec.structs.replace(c, separated_by=("pump_off_decay", "speed_ramp")) for c in place.candidates)
    verdict = msgspec.structs.replace(d.verdict, places=(msgspec.structs.replace(place, candidates=slow),))
    assert next_steps(msgspec.structs.replace(d, verdict=verdict, experiment=weak)) == [
        "nothing that can be planned",
        "record what may tell them apart: the pump switched off at a high pressure, and the pressure's fall to the end",
    ]


def test_an_unnamed_effect_is_not_called_by_the_nearest_name(document: Document) -> None:
    d = as_kind(document, "unnamed")
    assert "full_open_gain" not in d.verdict.sentence
    assert any(line.startswith("  nearest, and not its name: full_open_gain") for line in sentences(d))
    assert '<tr class="chosen">' in page(document, {})
    assert '<tr class="chosen">' not in page(d, {})


def test_what_the_held_out_recordings_show_alone_is_no_missing_physics() -> None:
    found = discovery()
    outcome, nominal = found.outcome, found.outcome.nominal
    chosen = dataclasses.replace(
        outcome.chosen, training=nominal.training + 1.0, predicted=nominal.predicted + outcome.gain
    )
    alone = dataclasses.replace(outcome, chosen=chosen)
    verdict = verdict_of(alone, found.after, found.held)
    assert verdict.kind == "recordings differ"
    nothing = dataclasses.replace(outcome, chosen=nominal, places=())
    assert verdict_of(nothing, found.after, found.before).kind == "recordings differ"
    assert verdict_of(nothing, found.before, found.after).kind == "unnamed"
    d, _ = described(dataclasses.replace(found, outcome=alone, verdict=verdict), ORIGIN, Extras())
    assert not d.named
    assert "depart from the model in a way that the training recordings do not" in d.verdict.sentence
    assert "exchanged" in " ".join(next_steps(d))


def test_what_is_left_in_the_held_out_recordings_has_a_place_too() -> None:
    found = discovery()
    assert found.left is found.after
    other = dataclasses.replace(found, held=found.before)
    assert other.left is found.before
    assert verdict_of(found.outcome, found.after, found.before).kind == "unnamed"
    assert verdict_of(found.outcome, found.after, found.held).kind == "named"
    d, _ = described(other, ORIGIN, Extras())
    assert d.left.equations == found.before.members
    assert all(sentence.startswith("in the held-out recordings, ") for sentence in d.left.sentences)
    assert other.rivals == ()


def test_a_proposed_experiment_and_a_fault_that_set_in_are_told() -> None:
    found = discovery()
    steady = Experiment("hold", "the pressure held", ((60.0, 1e6, 0.0),), UDS_EXPERIMENTS.planned[0].control)
    plan = _plan(steady, {("a", "b"): 40.0, ("b", "a"): 12.0})
    onset = Onset(100.0, "e04", (), "t-1")
    d, _ = described(found, ORIGIN, Extras(plans=[plan], onset=onset, refused=["it grew worse"]))
    assert d.experiment is not None
    assert plan.resolved == {("a", "b"): 12.0}
    assert d.experiment.data["left"] == plan.left
    assert d.experiment.data["expected"][1] == {"true": "b", "rival": "a", "nats": 12.0, "probability": 0.75}
    assert d.refused == ("it grew worse",)
    assert d.verdict.sentence.startswith("something set in at 100 s of t-1, as faults do (e04)")
    assert "faultline diagnose" in next_steps(d)[0]
    asked = msgspec.structs.replace(as_kind(d, "one of"), onset=None)
    assert next_steps(asked) == [
        "record the pressure held (hold, 100 s): at least 12 nats of evidence are expected for the right candidate, "
        "and that rules a wrong one out with a probability of at least 0.75"
    ]
    some, _ = described(
        found, ORIGIN, Extras(plans=[_plan(steady, _expected({("a", "b"): 40.0, ("a", "c"): 30.0, ("b", "c"): 0.1}))])
    )
    assert some.experiment is not None
    assert some.experiment.sentences[0].endswith("at least 30 nats of evidence are expected for the right candidate, "
        "and that rules a wrong one out with a probability of at least 0.94, but it will not tell whether it is "
        "b or c")  # fmt: skip
    weak, _ = described(found, ORIGIN, Extras(plans=[_plan(steady, _expected({("a", "b"): 1.0}))]))
    assert weak.experiment is not None
    [step, *_] = next_steps(as_kind(weak, "one of"))
    assert step == "no experiment that can be planned is expected to tell the candidates apart"


def test_a_reading_that_would_tell_is_told(document: Document) -> None:
    reading = Gauge("p_ap", "pressure after the pump", "Pa", "maximum", {"a": (1e6, 2e3), "b": (1.02e6, 3e3)}, ())
    d, _ = described(discovery(), ORIGIN, Extras(gauge=reading))
    [step] = [step for step in next_steps(as_kind(d, "one of")) if step.startswith("read ")]
    assert step == (
        "read pressure after the pump (p_ap) with a gauge of the workshop, absolute, in mode maximum on average: "
        "10 bar +- 0.02 bar if it is a; 10.2 bar +- 0.03 bar if it is b"
    )
    assert "gauge of the workshop" in page(as_kind(d, "one of"), {})


def _plan(experiment: Experiment, nats: Mapping[tuple[str, str], float]) -> Plan:
    """Each nat a sixteenth of certainty, up to all of it."""
    return Plan(
        experiment,
        nats,
        {pair: min(value / 16.0, 1.0) if value < 16.0 else 0.9375 for pair, value in nats.items()},
        0.1,
    )


def _expected(nats: Mapping[tuple[str, str], float]) -> dict[tuple[str, str], float]:
    return {pair: value for (a, b), value in nats.items() for pair in ((a, b), (b, a))}


def test_what_it_does_to_the_bundle_is_told() -> None:
    effect = BundleEffect(Bundled(tolerated=(), judged={}), Bundled(reason="it cannot be computed"))
    d, _ = described(discovery(), ORIGIN, Extras(bundle=effect))
    assert d.bundle is not None
    assert d.bundle.data["after"]["reason"] == "it cannot be computed"
    assert msgspec.json.decode(encoded(d), type=Document).bundle == d.bundle
    assert any(line.startswith("bundle: with it: there is no bundle") for line in sentences(d))
    assert "there is no bundle" in summary(d)


def test_the_page_needs_nothing_else_and_escapes_what_it_is_told(
    written: Mapping[str, bytes], document: Document
) -> None:
    html = written["report.html"].decode()
    assert html.count('src="data:image/png;base64,') == 4
    assert not re.search(r"https?://|<script|<link", html)
    assert "prefers-color-scheme:dark" in html
    assert 'name="viewport"' in html
    sly = "<script>x</script>"
    hostile = msgspec.structs.replace(
        document, model=sly, origin=msgspec.structs.replace(ORIGIN, vehicle=sly, sources=(sly,)), refused=(f"`{sly}`",)
    )
    text = page(hostile, {})
    assert "<script" not in text
    assert text.count("&lt;script&gt;x&lt;/script&gt;") >= 5
    assert "<code>&lt;script&gt;x&lt;/script&gt;</code>" in text


def test_pictures_show_what_the_effect_depends_on(written: Mapping[str, bytes], document: Document) -> None:
    assert {name for name in written if name.endswith(".png")} == {
        "free-run.png", "regimes.png", "unknown-input.png", "evidence.png",
    }  # fmt: skip
    assert all(data.startswith(b"\x89PNG") for name, data in written.items() if name.endswith(".png"))
    abscissa, course = abscissa_of(discovery()), document.located.course
    assert abscissa is not None
    assert course is not None
    assert abscissa.words == "dc_dose"
    largest = np.array(course.value) > 0.5 * max(course.value)
    assert largest.any()
    assert abscissa.value[largest] == pytest.approx(np.ones(largest.sum()))
    assert abscissa.value[~largest].max() < 0.9


def test_where_nothing_is_missing_nothing_is_drawn_that_is_not_there() -> None:
    d, runs = described(discovery(0.0), ORIGIN)
    names = {*files_of(discovery(0.0), d, runs)}
    assert {"free-run.png", "regimes.png"} <= names
    assert "unknown-input.png" not in names
    assert d.verdict.sentence == "nothing is missing in the model that these recordings could show"
    assert d.strengths == ()


def test_a_zero_error_that_is_too_large_is_said(document: Document) -> None:
    zero = Zero(recording="v-1", output="y_p_tp", before=0.0, after=-4.2)
    said = limits(msgspec.structs.replace(document, zeros=(zero,)))
    assert any("4.2 times what its datasheet says" in line for line in said)


def test_held_out_recordings_that_hardly_show_it_are_said(document: Document) -> None:
    assert not any("hardly" in line for line in limits(document))
    evidence = msgspec.structs.replace(document.evidence, held_out_after=document.evidence.held_out_before + 20.0)
    assert any("hardly show it (20 of" in line for line in limits(msgspec.structs.replace(document, evidence=evidence)))


def test_long_reports_are_cut_for_the_terminal(document: Document) -> None:
    many = Section(sentences=tuple(f"sentence {k}" for k in range(60)))
    located = msgspec.structs.replace(document.located, sentences=many.sentences)
    d = msgspec.structs.replace(document, located=located)
    lines = sentences(d)
    assert len(lines) == MOST
    assert "..." in lines
    assert f"next: {next_steps(d)[-1]}" in lines  # what to do is what the reader came for


def test_sizes_are_wider_where_more_than_noise_is_left() -> None:
    found = discovery()
    chosen, library = found.outcome.chosen, found.study.library
    [usual], [wide] = (sizes(dataclasses.replace(chosen, dispersion=left), library, Units()) for left in (1.0, 4.0))
    assert usual.interval is not None
    assert wide.interval is not None
    of_wide, of_usual = np.diff(np.array(wide.interval, float)), np.diff(np.array(usual.interval, float))
    assert of_wide == pytest.approx(2.0 * of_usual)
    outside = dataclasses.replace(chosen, inside=np.zeros(len(chosen.x), bool), curvature=np.eye(len(chosen.x)))
    [bound] = sizes(outside, library, Units())
    assert bound.interval is None
    assert bound.words.endswith("the end of what is possible")


def test_values_are_in_units_that_people_read(document: Document) -> None:
    read = [document.units.of(unit).difference(value) for value, unit in ((0.25, "1"), (2.5e4, "Pa"), (1e-7, "m3/s"))]
    assert read == ["0.25", "0.25 bar", "0.1 mL/s"]
    assert Units().of("Pa").difference(2.5e4) == "2.5e+04 Pa"


def test_the_document_says_what_it_is_of(document: Document) -> None:
    assert document.simulated
    assert encoded(document).endswith(b"}\n")
    for sources in (("a truck of ours",), ("simulated by the rig", "a truck of ours"), ()):
        assert not Origin(training=("a",), held_out=("b",), sources=sources).simulated
