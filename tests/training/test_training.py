"""A training learns a system, is the same for the same seed, goes on where it was interrupted, and stops in time."""

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch
from made_samples import SHORT, circuit, dosing, rc

from faultline.analysis.model import load_model
from faultline.service.core.errors import InputError
from faultline.training.bank import networks_of
from faultline.training.checkpoint import key_of, load_checkpoint, save_checkpoint
from faultline.training.free_run import free_run
from faultline.training.layout import layout_of
from faultline.training.loop import Training
from faultline.training.recipe import DEFAULT, THESIS, Phase, Recipe
from faultline.training.reckoned import Equations, reckoned
from faultline.training.samples import Samples, Stretch
from faultline.training.saved import Saved
from faultline.training.windows import Windows

NOISE = 1e-4
QUICK = dataclasses.replace(SHORT, phases=(Phase(30, 15, 16, 60), Phase(60, 30, 8, 60)))


def training(samples: Samples, recipe: Recipe = SHORT, seed: int = 0) -> Training:
    layout = rc()
    return Training(layout, samples, recipe, seed)


def done(begun: Training) -> Training:
    begun.run(lambda _: None, lambda: None)
    return begun


def graph_of(trained: Training, samples: Samples) -> bytes:
    return networks_of(trained, samples, 0).graph


def error_on(trained: Training, other: Samples) -> float:
    """The free-run error [A] of the members' mean on other samples."""
    layout, scaling = trained.layout, trained.scaling
    windows = Windows(layout, reckoned(layout, other, Equations(layout)), [], scaling, 0, 0)
    course = free_run(trained.finish(), windows)
    left = course.y.mean(dim=0) - windows.z[course.at][:, torch.as_tensor(trained.layout.predicts)].T
    return float(left.pow(2).mean().sqrt()) * float(scaling.z_size[1])


def test_what_it_learnt_holds_on_another_recording() -> None:
    """With noise of 0.1 mA in currents of 50 mA."""
    samples = circuit(1)
    trained = done(training(samples))
    assert error_on(trained, circuit(2)) < 2.0 * NOISE
    assert trained.history.iteration == [50, 100, 150, 200]
    assert trained.history.held[-1][0] < 0.02


def test_the_same_seed_gives_the_same_bytes_and_another_one_others() -> None:
    samples = circuit(1, 800)
    first, again, other = (graph_of(done(training(samples, QUICK, seed)), samples) for seed in (3, 3, 4))
    assert hashlib.sha256(first).hexdigest() == hashlib.sha256(again).hexdigest()
    assert first != other


class PluggedOutError(Exception):
    """Somebody pulled the plug."""


def test_a_training_that_was_interrupted_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    samples = circuit(1, 800)
    whole = graph_of(done(training(samples, QUICK)), samples)
    begun = training(samples, QUICK)
    key = key_of(begun.layout, samples, QUICK, 0)

    def keep() -> None:
        save_checkpoint(tmp_path, key, begun)
        if begun.done == 100:
            raise PluggedOutError

    with pytest.raises(PluggedOutError):
        begun.run(lambda _: None, keep)
    again = training(samples, QUICK)
    assert load_checkpoint(tmp_path, key, again)
    assert again.done == 100
    assert graph_of(done(again), samples) == whole


def test_a_checkpoint_of_something_else_is_refused(tmp_path: Path) -> None:
    samples = circuit(1, 800)
    begun = training(samples)
    assert not load_checkpoint(tmp_path, "key", begun)
    save_checkpoint(tmp_path, "key", begun)
    with pytest.raises(InputError, match=r"checkpoint\.pt: is of another training .*; train without --resume"):
        load_checkpoint(tmp_path, key_of(begun.layout, samples, SHORT, 1), begun)
    for damaged in (b"PK\x03\x04 half of it", b"", b"hello"):
        (tmp_path / "checkpoint.pt").write_bytes(damaged)
        with pytest.raises(InputError, match=r"checkpoint\.pt: cannot be read, .+; train without --resume"):
            load_checkpoint(tmp_path, "key", begun)
    torch.save({"key": "key"}, tmp_path / "checkpoint.pt")
    with pytest.raises(InputError, match=r"checkpoint\.pt: cannot be read, .+; train without --resume"):
        load_checkpoint(tmp_path, "key", begun)


def test_a_checkpoint_of_the_same_model_with_other_parameters_is_another_one() -> None:
    """States that nothing measures begin where the parameters put them, and scales follow."""
    layout, samples = rc(), circuit(1, 800)
    changed = dataclasses.replace(layout, model=layout.model.with_parameters({"R": 210.0}, {}))
    assert key_of(layout, samples, SHORT, 0) != key_of(changed, samples, SHORT, 0)


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError, match=f"'{tmp_path}/file'"):
        save_checkpoint(tmp_path / "file", "key", training(circuit(1, 800)))


def test_a_training_that_diverges_is_stopped_with_the_last_good_state() -> None:
    samples = circuit(1, 800)
    begun = training(samples, dataclasses.replace(SHORT, phases=(Phase(20, 5, 16, 150),)))
    spoilt: list[int] = []

    def spoil() -> None:
        if begun.done == 100:
            spoilt.append(begun.done)
            with torch.no_grad():
                begun.networks.logit.fill_(float("nan"))

    begun.run(lambda _: None, spoil)
    assert spoilt == [100]
    assert begun.stopped == "it diverges, the loss is nan"
    assert begun.done == 101
    assert error_on(begun, circuit(2, 800)) < 10.0 * NOISE


def test_one_that_diverges_at_once_says_what_to_do() -> None:
    begun = training(circuit(1, 800))
    with torch.no_grad():
        begun.networks.logit.fill_(float("nan"))
    with pytest.raises(InputError, match=r"diverges after 1 iterations .*; train on more data, or with another --seed"):
        done(begun)


def test_the_recipe_of_the_thesis_runs_and_learns() -> None:
    """Its equation 3.6, with the old input, over whole recordings; a few epochs of its 1,500."""
    recipe = dataclasses.replace(THESIS, hidden=(32, 32), phases=(Phase(None, 0, 1, 50),), warm_up=10)
    samples = circuit(5, 300, stretches=2)
    trained = done(training(samples, recipe))
    before = error_on(training(samples, recipe), circuit(6, 300))
    assert error_on(trained, circuit(6, 300)) < 0.8 * before
    assert np.isfinite(error_on(trained, circuit(6, 300)))
    assert len(graph_of(trained, samples)) > 1000


def test_what_is_seen_from_several_starts_is_in_one_fold() -> None:
    """The wound: what a member was blind to it had seen from another start."""
    one = circuit(1, 1500)
    [z] = [stretch.z for stretch in one.stretches]
    starts = tuple(Stretch("log", z[k:], 3.0 + 0.2 * k) for k in (0, 7))
    samples = dataclasses.replace(one, stretches=(*starts, Stretch("another log", z, 3.0)))
    windows = training(samples).windows
    first, second, other = (slice(begin, end) for begin, end in windows.measured)
    assert torch.equal(windows.fold[first][7:], windows.fold[second])
    assert torch.allclose(windows.clock[first][7:], windows.clock[second])
    assert not torch.equal(windows.fold[first], windows.fold[other])


def test_a_member_never_learns_from_its_own_fold() -> None:
    windows = training(circuit(1)).windows
    batch = windows.batch(Phase(40, 0, 32, 1), SHORT, torch.Generator().manual_seed(0))
    assert {0.0, 1.0} == {*batch.counts.flatten().tolist()}
    assert not torch.equal(batch.counts[:, 0], batch.counts[:, 1])
    share = [float((windows.fold == fold).to(torch.float32).mean()) for fold in (0, 1)]
    assert share == pytest.approx([0.5, 0.5], abs=0.05)


def test_what_does_not_err_clearly_less_by_all_members_together_is_taken_from_another_training() -> None:
    """Weights, errors and names; the other tests stay."""
    layout, samples = layout_of(load_model("uds"), ["t02", "t06"]), dosing(3)
    recipe = dataclasses.replace(DEFAULT, members=2, folds=2, phases=(Phase(4, 0, 8, 1),))
    one, other = (Training(layout, samples, recipe, seed) for seed in (0, 1))
    one.best_error[:] = torch.tensor([[1.0, 1.0], [1.0, 1.0]])  # t02 errs 0.90 times as much, t06 0.71
    other.best_error[:] = torch.tensor([[1.0, 0.1], [1.2, 2.0]])
    logit = one.best["logit"].clone()
    other.best["logit"] += 1.0
    assert one.take(other, 0.8) == ["t02"]
    own = torch.as_tensor(layout.owner)
    torch.testing.assert_close(one.best["logit"], logit + (own == 0).to(logit)[None, :, None])
    torch.testing.assert_close(one.best_error, torch.tensor([[1.0, 1.0], [1.2, 1.0]]))


def test_an_adaptation_begins_with_what_it_was_given_as_the_best_so_far() -> None:
    layout, samples = layout_of(load_model("uds"), ["t02"]), dosing(3)
    recipe = dataclasses.replace(DEFAULT, members=2, folds=2, phases=(Phase(4, 0, 8, 1),))
    base = Training(layout, samples, recipe, 0)
    begin = Saved(base.best, base.scaling, recipe, ())
    assert bool(torch.isinf(base.best_error).all())
    assert bool(torch.isfinite(Training(layout, samples, recipe, 1, begin).best_error).all())
