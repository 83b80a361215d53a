"""`faultline train` on a system that no line of the product knows, and its networks in a bundle."""

import json
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from faultline.analysis.export import main as export
from faultline.analysis.graph.bank import inputs_of
from faultline.analysis.graph.networks import load_networks
from faultline.analysis.model import load_model
from faultline.analysis.tuning.command import main as tune
from faultline.analysis.tuning.file import load_tuning
from faultline.service.bundle.load import load_bundle, verify_golden
from faultline.service.core.errors import InputError
from faultline.service.core.residuals.generators import Graph
from faultline.service.diagnose.command import main as diagnose
from faultline.service.logs import open_log
from faultline.testbench import tanks
from faultline.training.command import main as train
from faultline.training.recipe import DEFAULT, Phase
from faultline.training.samples import load_samples

sys.path.insert(0, str(Path(__file__).parents[1] / "analysis" / "another_system"))
import recorded_tanks

QUICK = replace(DEFAULT, hidden=(8,), phases=(Phase(4, 0, 64, 50), Phase(30, 10, 16, 100)))
"""Every xdist worker makes its own: seconds instead of a minute."""


@dataclass(frozen=True)
class Made:
    """The recordings, the networks' folder, and a bundle that has them besides the equations."""

    logs: tuple[Path, ...]
    networks: Path
    tuning: Path
    bundle: Path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("networks")
    logs = tuple(recorded_tanks.record(folder / f"steps-{seed}", seed, 400.0) for seed in (1, 2, 3))
    networks, tuning, bundle = folder / "networks", folder / "tuning.json", folder / "bundle"
    with patch.dict("faultline.training.command.RECIPES", {"default": QUICK}):
        assert train(["three-tank", str(logs[0]), "--out", str(networks), "--members", "2"]) == 0
    given = ["three-tank", "--networks", str(networks)]
    assert tune([*given, *map(str, logs[1:]), "--out", str(tuning)]) == 0
    dbc = str(logs[0] / "tanks.dbc")
    assert export([*given, "--tuning", str(tuning), "--dbc", dbc, "--out", str(bundle)]) == 0
    return Made(logs, networks, tuning, bundle)


def test_the_bundle_runs_both_and_says_what_was_trained_on_what(made: Made) -> None:
    bundle = load_bundle(made.bundle)
    verify_golden(bundle)
    networks = load_networks(made.networks, load_model("three-tank")).description
    manifest = bundle.manifest
    assert [graph.file for graph in manifest.graphs] == ["ode.onnx", "rnn.onnx"]
    names = [generator.name for generator in manifest.generators]
    left_out = load_tuning(made.tuning).left_out  # the training is a quick one
    kept = [generator.name for generator in networks.generators if generator.name not in left_out]
    assert [name for name in names if name.endswith(".rnn")] == kept
    assert 0 < len(left_out) < len(networks.generators)
    twins = {each.generator: each.twin for each in manifest.evidence.networks}
    assert twins == {name: name.replace(".rnn", ".ode") for name in names if name.endswith(".rnn")}, (
        "one level for both"
    )
    assert manifest.origin.train == networks.recordings
    assert not {*manifest.origin.train} & {*manifest.origin.tune}
    assert (made.networks / "training.png").read_bytes().startswith(b"\x89PNG")
    assert not (made.networks / "checkpoint.pt").exists()


def test_a_leak_keeps_its_name_beside_networks(made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It brings the tanks where networks err: their alarms are no conflicts, which would cost the right name."""
    healthy = recorded_tanks.record(tmp_path / "healthy", 4, 300.0)
    leak = recorded_tanks.record(tmp_path / "leak", 5, 480.0, tanks.Fault("f_leak1", 5e-6, 270.0))
    assert diagnose([str(healthy), "--bundle", str(made.bundle), "--json"]) == 0
    capsys.readouterr()
    assert diagnose([str(leak), "--bundle", str(made.bundle), "--json"]) == 1
    told = [event for event in map(json.loads, capsys.readouterr().out.splitlines()) if event["diagnoses"]]
    assert 270.0 < told[0]["t_s"] < 285.0
    for event in (told[0], told[-1]):
        assert ["f_leak1"] in [d["faults"] for d in event["diagnoses"] if d["rank"] == 1]


def test_tuning_and_export_must_have_the_same_networks(made: Made, tmp_path: Path) -> None:
    dbc, out = str(made.logs[0] / "tanks.dbc"), str(tmp_path / "bundle")
    with pytest.raises(InputError, match=r"tuning\.json: was made with networks that are not those of --netw"):
        export(["three-tank", "--tuning", str(made.tuning), "--dbc", dbc, "--out", out])
    with pytest.raises(InputError, match=r"used to train the networks; tune on fault-free recordings of their own"):
        tune(["three-tank", "--networks", str(made.networks), str(made.logs[0]), "--out", out])


def test_networks_of_another_model_or_damaged_are_refused(made: Made, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"was trained on the signals .*; train for uds anew"):
        load_networks(made.networks, load_model("uds"))
    with pytest.raises(InputError, match=r"nowhere: no networks: .*; `faultline train` writes them"):
        load_networks(tmp_path / "nowhere", load_model("three-tank"))
    damaged = tmp_path / "damaged"
    shutil.copytree(made.networks, damaged)
    graph = bytearray((damaged / "rnn.onnx").read_bytes())
    graph[1000] ^= 1
    (damaged / "rnn.onnx").write_bytes(graph)
    with pytest.raises(InputError, match=r"rnn\.onnx: is not the graph that networks\.json is of; copy the"):
        load_networks(damaged, load_model("three-tank"))


def test_networks_are_adapted_and_remember_what_they_have_seen(made: Made, tmp_path: Path) -> None:
    short = recorded_tanks.record(tmp_path / "short", 7, 160.0)
    given = ["three-tank", str(short), "--from", str(made.networks), "--out", str(tmp_path / "adapted")]
    with patch("faultline.training.saved.PHASES", QUICK.phases):
        assert train(given) == 0
    model = load_model("three-tank")
    before, after = (load_networks(folder, model).description for folder in (made.networks, tmp_path / "adapted"))
    assert after.recordings == [*before.recordings, open_log(short).sha256]
    assert (after.members, after.recipe) == (before.members, before.recipe)
    with pytest.raises(InputError, match=r"used to train the networks; tune on"):
        tune(["three-tank", "--networks", str(tmp_path / "adapted"), str(made.logs[0]), "--out", str(tmp_path / "t")])
    with pytest.raises(InputError, match=r"--recipe: networks that are adapted have their own; leave it out"):
        train([*given, "--recipe", "thesis"])
    with pytest.raises(InputError, match=r"weights\.pt: is of other tests or of another model; give the same --tests"):
        train([*given, "--tests", before.generators[0].test])
    damaged = tmp_path / "damaged"
    shutil.copytree(made.networks, damaged)
    for content in (b"", b"hello"):
        (damaged / "weights.pt").write_bytes(content)
        with pytest.raises(InputError, match=r"weights\.pt: cannot be read, .+; train the networks anew"):
            train(["three-tank", str(short), "--from", str(damaged)])
    shutil.copy(tmp_path / "adapted" / "weights.pt", damaged)
    with pytest.raises(InputError, match=r"weights\.pt: is not of the graph beside it; copy the whole folder"):
        train(["three-tank", str(short), "--from", str(damaged)])


def test_what_cannot_be_trained_on_is_refused_with_the_remedy(made: Made, tmp_path: Path) -> None:
    short = recorded_tanks.record(tmp_path / "short", 6, 60.0)
    out = ["--out", str(tmp_path / "never")]
    with pytest.raises(InputError, match=r"short: \d+ s in which all signals can be used .*; \d+ s more are needed"):
        train(["three-tank", str(short), *out])
    with pytest.raises(InputError, match=r"this recording is named twice; name it once"):
        train(["three-tank", str(made.logs[0]), str(made.logs[0]), *out])
    with pytest.raises(InputError, match=r"--tests t99: three_tank has no such test"):
        train(["three-tank", str(made.logs[0]), "--tests", "t99", *out])
    with pytest.raises(InputError, match=r"--members 0: at least 1"):
        train(["three-tank", str(made.logs[0]), "--members", "0", *out])
    t = np.arange(0.0, 200.0, tanks.FRAME_S)
    u = np.interp(t, [0.0, 60.0, 120.0, 200.0], [0.5, 0.7, 0.45, 0.6])
    levels = tanks.levels(t, u, None)
    levels[:, 1] = 0.31
    stuck = recorded_tanks.write(tmp_path / "stuck", tanks.Run(t, u, levels))
    with pytest.raises(InputError, match=r"stuck: y2 hardly moves .*: a sensor that is stuck, or an input"):
        train(["three-tank", str(stuck), *out])
    assert not (tmp_path / "never").exists()


@pytest.mark.parametrize("period_s", [40.0, 1000.0])
def test_an_input_of_two_values_must_have_been_thrown_more_than_once(tmp_path: Path, period_s: float) -> None:
    t = np.arange(0.0, 400.0, tanks.FRAME_S)
    u = np.where((t + 300.0) % period_s < period_s / 2, 0.5, 0.6)
    log = recorded_tanks.write(tmp_path / "switched", tanks.Run(t, u, tanks.levels(t, u, None)))
    model = load_model("three-tank")
    if period_s < t[-1]:
        assert load_samples(model, inputs_of(model), [log], print).seconds > 300.0
        return
    with pytest.raises(InputError, match=r"switched: u hardly moves"):
        load_samples(model, inputs_of(model), [log], print)


def test_networks_that_are_left_out_leave_the_others_as_they_were(made: Made) -> None:
    """Cut once or twice, with a batch of any size."""
    whole = load_networks(made.networks, load_model("three-tank"))
    names = [generator.name for generator in whole.description.generators]
    once = whole.without(names[:1])
    twice = whole.without(names[:1]).without(names[3:4])
    rows = [k for k in range(len(names)) if k not in (0, 3)]
    counts = np.cumsum([0, *(len(generator.states) for generator in whole.description.generators)])
    columns = np.concatenate([np.arange(counts[k], counts[k + 1]) for k in rows])
    rng = np.random.default_rng(1)
    z, x = rng.uniform(0.1, 0.4, (3, len(whole.description.signals))), rng.uniform(0.1, 0.4, (3, counts[-1]))
    every, some = Graph(whole.graph)(z=z, x=x), Graph(twice.graph)(z=z, x=x[:, columns])
    for all_of_it, cut in zip(every[:3], some[:3], strict=True):
        np.testing.assert_allclose(cut, all_of_it[:, rows], rtol=1e-6)
    np.testing.assert_allclose(some[3], every[3][:, columns], rtol=1e-6)
    assert [generator.name for generator in twice.description.generators] == [names[k] for k in rows]
    assert once.description.error == whole.description.error[1:]
    assert whole.without([]) is whole
