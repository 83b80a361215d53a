"""A diagnosis needs the names of variables in each equation, and recordings; it needs no formula."""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import msgspec
import numpy as np
import pytest

from faultline.analysis.export import main as export
from faultline.analysis.graph.network_bank import NetworkBank, biased_signals, network_bank
from faultline.analysis.graph.networks import load_networks
from faultline.analysis.model import ModelError, dump_model, load_model, parse_model
from faultline.analysis.model.names import without_formulas
from faultline.analysis.structure import Test, find_tests, structure_of
from faultline.analysis.structure.command import main as structure
from faultline.analysis.tuning.command import main as tune
from faultline.service.bundle.load import load_bundle, verify_golden
from faultline.service.core.decision.hypotheses import without_sizes
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Disturbance
from faultline.service.core.residuals.generators import Graph
from faultline.service.diagnose.command import main as diagnose
from faultline.testbench import tanks
from faultline.testbench.bus import load_dbc
from faultline.testbench.cycles import CYCLES
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.vehicles import VEHICLES
from faultline.training.command import main as train
from faultline.training.layout import layout_of, nearest_sensor
from faultline.training.recipe import DEFAULT, Phase

sys.path.insert(0, str(Path(__file__).parents[1] / "analysis" / "another_system"))
import recorded_tanks

QUICK = replace(DEFAULT, hidden=(16,), phases=(Phase(4, 0, 64, 150), Phase(40, 10, 24, 250)))

NAMES = """
schema = 1
name = "tank"
[known.u]
[known.y]
[unknown.h]
[unknown.dh]
[unknown.q]
[[equation]]
name = "e1"
variables = ["q", "h"]
fault = {name = "f_clogged", component = "outlet"}
[[equation]]
name = "e2"
variables = ["dh", "u", "q"]
[[equation]]
name = "e3"
variables = ["y", "h"]
fault = {name = "fy", component = "level sensor"}
[[differential]]
name = "e4"
state = "h"
derivative = "dh"
"""


def matrix(path: Path) -> Path:
    """The same as a structural model."""
    path.write_text(
        json.dumps(
            {
                "X": [[1, 1, 0], [0, 1, 1], [1, 0, 0], [2, 0, 3]],
                "F": [[1, 0], [0, 0], [0, 1], [0, 0]],
                "Z": [[0, 0], [1, 0], [0, 1], [0, 0]],
                "names": {
                    "equations": ["e1", "e2", "e3", "e4"],
                    "unknowns": ["h", "q", "dh"],
                    "faults": ["f_clogged", "fy"],
                    "knowns": ["u", "y"],
                },
            }
        )
    )
    return path


@dataclass(frozen=True)
class Made:
    """The model's file, its networks, and the bundle of these alone."""

    model: Path
    networks: Path
    tuning: Path
    bundle: Path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("names")
    model = folder / "tanks.toml"
    assert structure(["three-tank", "--model", str(model), "--without-formulas"]) == 0
    logs = [recorded_tanks.record(folder / f"steps-{seed}", seed, 400.0) for seed in (1, 2, 3)]
    networks, tuning, bundle = folder / "networks", folder / "tuning.json", folder / "bundle"
    with patch.dict("faultline.training.command.RECIPES", {"default": QUICK}):
        assert train([str(model), str(logs[0]), "--out", str(networks), "--members", "2"]) == 0
    given = [str(model), "--networks", str(networks)]
    assert tune([*given, *map(str, logs[1:]), "--out", str(tuning)]) == 0
    dbc = str(logs[0] / "tanks.dbc")
    assert export([*given, "--tuning", str(tuning), "--dbc", dbc, "--out", str(bundle)]) == 0
    return Made(model, networks, tuning, bundle)


def test_a_bundle_has_networks_alone_and_knows_no_size(made: Made) -> None:
    bundle = load_bundle(made.bundle)
    verify_golden(bundle)
    manifest = bundle.manifest
    assert [graph.file for graph in manifest.graphs] == ["rnn.onnx"]
    assert {*manifest.evidence.sigma} == {each.name for each in manifest.generators}
    assert {*manifest.evidence.generators} <= {each.name for each in manifest.generators}
    hypotheses = manifest.evidence.hypotheses
    assert {each.fault for each in hypotheses} == {"f_y1", "f_y2", "f_y3"}
    largest = {each.fault: max(abs(h.size) for h in hypotheses if h.fault == each.fault) for each in hypotheses}
    # what a network answers to a bias is not linear in it: a drive may seem to have any of the others
    assert all((each.usual is not None) == (abs(each.size) < largest[each.fault]) for each in hypotheses)
    assert manifest.evidence.networks == []
    assert {fault.name for fault in manifest.faults} == {*load_model("three-tank").faults}


def test_it_is_quiet_without_a_fault_and_names_the_one_there_is(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    healthy = recorded_tanks.record(tmp_path / "healthy", 4, 300.0)
    assert diagnose([str(healthy), "--bundle", str(made.bundle), "--json"]) == 0
    capsys.readouterr()
    leak = recorded_tanks.record(tmp_path / "leak", 5, 480.0, tanks.Fault("f_leak1", 5e-6, 270.0))
    assert diagnose([str(leak), "--bundle", str(made.bundle), "--json"]) == 1
    told = [event for event in map(json.loads, capsys.readouterr().out.splitlines()) if event["diagnoses"]]
    assert 270.0 < told[0]["t_s"] < 300.0
    assert ["f_leak1"] in [d["faults"] for d in told[-1]["diagnoses"] if d["rank"] == 1]


def test_a_bias_is_what_the_networks_show_of_corrected_samples(made: Made) -> None:
    model = load_model(made.model)
    bank = network_bank(model, load_networks(made.networks, model))
    z = np.random.default_rng(0).uniform(0.2, 0.4, (5, len(model.known)))
    [fault, signal], *_ = biased_signals(model).items()
    bias = np.zeros(len(model.known))
    bias[[*model.known].index(signal)] = 0.05
    for rows in ([*range(len(bank.tests))], [len(bank.tests) - 1, 0]):
        some = bank.only(rows)
        own = np.concatenate([np.arange(*_columns(bank, row)) for row in rows])
        graph = Graph(some.graph_of([{}, {fault: 0.05}]))
        x = np.tile(bank.start(z[0])[own], (2, 1))
        expected = bank.simulate([{}, {}], np.stack([z, z - bias], axis=1), bank.start(z[0]))[..., rows]
        for sample, r in zip(z, expected, strict=True):
            found, _, _, x = graph(z=np.tile(sample, (2, 1)), x=x)
            np.testing.assert_allclose(found, r, rtol=0, atol=1e-6)
        np.testing.assert_allclose(bank.simulate([{}, {fault: 0.05}], z, bank.start(z[0]))[..., rows], expected)


def _columns(bank: NetworkBank, row: int) -> tuple[int, int]:
    counts = np.cumsum([0, *(len(each.states) for each in bank.generators)])
    return int(counts[row]), int(counts[row + 1])


def test_what_is_no_component_s_fault_stays_near_its_equation() -> None:
    """A disturbance without a formula may move whatever has its equation."""
    text = NAMES.replace('["dh", "u", "q"]', '["dh", "u", "q"]\ndisturbance = {name = "leak", description = "a leak"}')
    model = parse_model(text, "tank.toml")
    assert parse_model(dump_model(model), "again") == model
    assert (model.disturbances["leak"].component, [*model.faults]) == ("", ["f_clogged", "fy"])
    assert [*without_formulas(load_model("uds")).disturbances] == ["fq_leak"]


def test_a_disturbance_without_sizes_may_shift_what_has_its_equation(made: Made) -> None:
    manifest = load_bundle(made.bundle).manifest
    first = manifest.generators[0]
    equation = first.equations[0]
    leak = Disturbance(name="leak", equation=equation, description="")
    found = without_sizes(msgspec.structs.replace(manifest, disturbances=[leak]))["leak"]
    assert found == {g.name: g.predicts for g in manifest.generators if equation in g.equations}
    assert first.name in found


def test_what_computes_says_that_a_formula_is_missing(made: Made, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"equation\.\w+: has no formula, which this needs; write `expr`"):
        tune([str(made.model), str(tmp_path), "--out", str(tmp_path / "tuning.json")])


@pytest.mark.parametrize("name", ["uds", "three-tank"])
def test_structure_needs_no_formula(name: str, tmp_path: Path) -> None:
    """The same tests with the same signatures, though whether an equation has one solution is not known."""
    whole = load_model(name)
    names = without_formulas(whole)
    file = tmp_path / "model.toml"
    file.write_text(dump_model(names))
    assert load_model(file) == names
    assert structure_of(names) == structure_of(whole)
    assert {test.name for test in find_tests(whole) if isinstance(test, Test)} <= {
        test.name for test in find_tests(names) if isinstance(test, Test)
    }


def test_latent_states_begin_at_the_nearest_sensor() -> None:
    names = without_formulas(load_model("uds"))
    by_name = {test.name: test for test in find_tests(names) if isinstance(test, Test)}

    def starts(test: str) -> dict[str, str]:
        return {s: nearest_sensor(structure_of(names), by_name[test], s) for s in by_name[test].states}

    assert starts("t21") == dict.fromkeys(("p_tp", "p_bp", "p_ap", "p_du"), "y_p_du")
    assert starts("t08") == dict.fromkeys(by_name["t08"].states, "y_p_tp")
    layout = layout_of(names, ["t02"])
    assert layout.sensed == layout_of(load_model("uds"), ["t02"]).sensed


def test_a_model_of_names_needs_neither_units_nor_ranges_and_may_be_a_matrix(tmp_path: Path) -> None:
    model = parse_model(NAMES, "tank.toml")
    assert parse_model(dump_model(model), "again") == model
    assert model.without_formula == ["e1", "e2", "e3"]
    [test] = find_tests(model)
    assert isinstance(test, Test)
    assert (test.predicts, test.faults) == ("y", ("f_clogged", "fy"))
    layout = layout_of(model)
    assert (layout.sensed, layout.starts[0].gain) == (("y",), {"y": 1.0})
    with pytest.raises(InputError, match="cannot be read"):
        train([str(matrix(tmp_path / "tank.json")), str(tmp_path / "nowhere")])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('variables = ["q", "h"]', "variables = []", r"equation\[0\]\.variables: is empty"),
        ('variables = ["q", "h"]', 'variables = ["q", "x"]', r"equation\[0\]\.variables: x is declared nowhere"),
        ('variables = ["q", "h"]', 'variables = ["q", "q"]', r"equation\[0\]\.variables: q is there twice"),
        ('component = "outlet"', 'sizes = [0.1], component = "outlet"', r"fault.*sizes"),
        ('name = "f_clogged"', 'name = "q"', r"q is declared already"),
        ('variables = ["q", "h"]', 'expr = "q"\nvariables = ["q"]', r"equation\[0\].*expr"),
    ],
)
def test_what_names_cannot_say_is_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        parse_model(NAMES.replace(old, new, 1), "tank.toml")


@pytest.mark.parametrize(("cycle", "excites"), [("training", False), ("excite", True)])
def test_training_says_what_a_loop_hides(
    cycle: str, excites: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A recording in which only the controller moves speed and pressure does not show what the speed does by itself."""
    asked = Request("made", VEHICLES["bench"], CYCLES[cycle], (), seed=1, duration=480.0, kind="instrumented")
    record(asked, load_dbc(), tmp_path / "logs", tmp_path / "truth", force=False, progress=lambda _: None)
    model = tmp_path / "names.toml"
    model.write_text(dump_model(without_formulas(load_model("uds"))))
    with patch.dict("faultline.training.command.RECIPES", {"default": QUICK}):
        given = [str(model), str(tmp_path / "logs" / "made"), "--tests", "t12", "--members", "3"]
        assert train([*given, "--out", str(tmp_path / "networks")]) == 0
    said = capsys.readouterr().err
    assert ("never moves alone: what it does to y_p_ap by itself is not seen" in said) is not excites
    assert ("--cycle excite" in said) is not excites
