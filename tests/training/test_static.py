"""A test without a state needs no formula either: its network is a function of the signals of the moment."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from faultline.analysis.export import main as export
from faultline.analysis.graph.network_bank import network_bank
from faultline.analysis.graph.networks import load_networks
from faultline.analysis.model import load_model
from faultline.analysis.tuning.command import main as tune
from faultline.analysis.tuning.few import ranked_few
from faultline.service.core.errors import InputError
from faultline.service.core.residuals.generators import Graph
from faultline.service.diagnose.command import main as diagnose
from faultline.training.bank import networks_of
from faultline.training.command import main as train
from faultline.training.layout import layout_of
from faultline.training.loop import Training
from faultline.training.recipe import DEFAULT, Phase
from faultline.training.samples import Samples, Stretch
from faultline.training.unseen import UNSEEN, left_open

sys.path.insert(0, str(Path(__file__).parents[1] / "campaigns"))
from pump_loop import MODEL, SIZES, Array, samples, written

QUICK = replace(DEFAULT, hidden=(12,), phases=(Phase(4, 0, 64, 150),))

LOOP = 1
"""A loop of development: the campaign judges others."""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("loop") / "loop.toml"
    path.write_text(MODEL)
    return path


def trained(folder: Path, model: Path, values: Array) -> Path:
    """Networks of a recording of these values."""
    training = written(folder / "training", model, values, LOOP)
    with patch.dict("faultline.training.command.RECIPES", {"default": QUICK}):
        assert train([str(model), str(training), "--out", str(folder / "networks")]) == 0
    return folder / "networks"


@pytest.fixture(scope="module")
def networks(model: Path) -> Path:
    return trained(model.parent, model, samples(LOOP, 1, 1200))


def test_networks_of_static_tests_alone_isolate_a_fault(
    model: Path, networks: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = model.parent
    drives = [written(folder / f"drive-{seed}", model, samples(LOOP, seed, 900), LOOP) for seed in (2, 3)]
    given = [str(model), "--networks", str(networks)]
    assert tune([*given, *map(str, drives), "--out", str(folder / "tuning.json")]) == 0
    assert export([*given, "--tuning", str(folder / "tuning.json"), "--out", str(folder / "bundle")]) == 0
    for seed, fault in enumerate(("", "f_y_q", "f_pump", "f_rotor"), start=4):
        values = samples(LOOP, seed, 900, fault, 2.5 * SIZES.get(fault, 0.0), 400)
        drive = written(folder / f"judged-{seed}", model, values, LOOP)
        capsys.readouterr()
        assert diagnose([str(drive), "--bundle", str(folder / "bundle"), "--json"]) == bool(fault)
        events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        told = [event for event in events if event["diagnoses"]]
        assert all(event["t_s"] > 400.0 for event in told)
        named = [each["faults"] for each in told[-1]["diagnoses"] if each["rank"] == 1] if told else []
        assert not fault or any(fault in faults for faults in named)  # alone or in a pair


def test_few_tests_are_as_many_as_the_redundancy_and_reach_every_fault(model: Path, networks: Path) -> None:
    """Seven equations less three unknowns leave four directions; three tests of six equations have three."""
    bank = network_bank(load_model(model), load_networks(networks, load_model(model)))
    for seed in range(5):
        rows = ranked_few(bank, np.random.default_rng(seed).normal(size=(500, len(bank.generators))))
        assert len(rows) == 4
        assert {fault for row in rows for fault in bank.generators[row].faults} == {*SIZES}


def test_sigma_grows_where_signals_do_not_move_together_any_more(model: Path, networks: Path, tmp_path: Path) -> None:
    """Speed and flow moved together where the valve never did: what each does alone is not known."""
    tied, free = samples(LOOP, 8, 300, valve=False), samples(LOOP, 8, 300)

    def grown(folder: Path, usual: Array) -> Array:
        graph = Graph(load_networks(folder, load_model(model)).graph)
        inside, outside = (graph(z=z, x=np.zeros((len(z), 0)))[2] for z in (usual, free))
        return np.asarray(np.median(outside, axis=0) / np.median(inside, axis=0))

    assert np.median(grown(trained(tmp_path, model, samples(LOOP, 1, 1200, valve=False)), tied)) > 2.0
    assert np.median(grown(networks, samples(LOOP, 9, 300))) < 1.2


def test_of_a_prior_is_left_what_did_not_move_by_itself() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-1.7, 1.7, (2, 2000))
    noise = 0.2 * rng.normal(size=2000)
    free = left_open(np.column_stack([a, b]), np.zeros(2))
    assert np.abs(free).max() < 2.0 * UNSEEN**2
    for follows, of_follows in ((a, 0.0), (a + 0.2 * a**2, 0.0), (a + noise, 0.2)):
        tied = left_open(np.column_stack([a, follows]), np.array([0.0, of_follows]))
        assert np.trace(tied) > 0.5


def test_where_formulas_are_known_a_static_test_is_computed_by_them(tmp_path: Path) -> None:
    text = """
schema = 1
name = "twice"
[known.y_1]
unit = "m"
min = 0.0
max = 1.0
noise = 0.001
[known.y_2]
unit = "m"
min = 0.0
max = 1.0
noise = 0.001
[unknown.h]
unit = "m"
[[equation]]
name = "e1"
expr = "y_1 - h"
[equation.fault]
name = "f_y_1"
component = "sensor"
description = "biased"
enters = "h -> h + f_y_1"
sizes = [0.1]
[[equation]]
name = "e2"
expr = "y_2 - h"
"""
    file = tmp_path / "model.toml"
    file.write_text(text)
    for wanted, message in ((None, "there is no network to train"), (["t01"], "its equations alone compute the resid")):
        with pytest.raises(InputError, match=message):
            layout_of(load_model(file), wanted)


def test_beside_static_tests_a_measured_state_is_predicted_as_it_is(tmp_path: Path) -> None:
    warms = """
[known.y_T]
[unknown.T]
[unknown.dT]
[[equation]]
name = "e8"
variables = ["dT", "T", "i"]
[[equation]]
name = "e9"
variables = ["y_T", "T"]
fault = {name = "f_y_T", component = "thermometer"}
[[differential]]
name = "e10"
state = "T"
derivative = "dT"
[edges]"""
    file = tmp_path / "model.toml"
    file.write_text(MODEL.replace("[edges]", warms))
    layout = layout_of(load_model(file))
    z = samples(LOOP, 1, 700)
    warmth = np.convolve(z[:, 4], np.exp(-np.arange(60) / 10.0) / 10.0)[: len(z)]
    stretch = Stretch("made", np.column_stack([z, warmth])[60:], 0.0)
    held = Samples(layout.signals, (stretch,), ("",), None, 640.0)
    training = Training(layout, held, replace(QUICK, phases=(Phase(4, 0, 32, 20),)), seed=0)
    training.run(lambda _: None, lambda: None)
    outputs, direct = training.finish().outputs, [bool(test.states) for test in layout.tests]
    assert 0 < sum(direct) < len(direct)
    last = outputs.weights[-1].view(outputs.members, outputs.functions, -1)
    assert [bool((last[:, t] == 0.0).all()) for t in range(len(direct))] == direct
    gain = outputs.first.view(outputs.members, outputs.functions, -1, outputs.arguments)[:, direct, 0]
    assert ((gain != 0.0).sum(dim=2) == 1).all()


def test_what_is_predicted_is_no_argument(tmp_path: Path) -> None:
    """A signal that is in a second equation too would be predicted to be what it is."""
    file = tmp_path / "model.toml"
    equations = (["y", "h"], ["y", "u", "h"], ["u", "q"], ["y_2", "q"])
    text = 'schema = 1\nname = "twice"\n' + "".join(f"[known.{name}]\n" for name in ("u", "y", "y_2"))
    text += "[unknown.h]\n[unknown.q]\n"
    for k, names in enumerate(equations, start=1):
        text += f'[[equation]]\nname = "e{k}"\nvariables = {json.dumps(names)}\n'
        text += f'fault = {{name = "f_{k}", component = "c{k}"}}\n'
    file.write_text(text)
    layout = layout_of(load_model(file))
    [row] = [t for t, test in enumerate(layout.tests) if test.predicts == "y"]
    used = layout.outputs[row]
    assert used[used != layout.padding].tolist() == [layout.signals.index("u")]


def test_a_sensor_alone_is_predicted_to_be_constant(tmp_path: Path) -> None:
    file = tmp_path / "model.toml"
    fault = 'fault = {name = "f", component = "sensor"}'
    equations = [
        f'[[equation]]\nname = "e1"\nvariables = ["y", "h"]\n{fault}',
        '[[equation]]\nname = "e2"\nvariables = ["h"]',
    ]
    file.write_text('schema = 1\nname = "tank"\n[known.y]\n[unknown.h]\n' + "\n".join(equations))
    layout = layout_of(load_model(file))
    z = 5.0 + np.random.default_rng(0).normal(size=(700, 1))
    held = Samples(layout.signals, (Stretch("made", z, 0.0),), ("",), None, 700.0)
    training = Training(layout, held, QUICK, seed=0)
    training.run(lambda _: None, lambda: None)
    made = networks_of(training, held, seed=0)
    _, predicted, sigma, _ = Graph(made.graph)(z=z, x=np.zeros((len(z), 0)))
    assert np.ptp(predicted) < 1e-6
    assert predicted[0] == pytest.approx(z.mean(), abs=0.1)
    assert sigma[0] == pytest.approx(1.0, abs=0.2)
