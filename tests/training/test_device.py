"""A training on another device than the CPU: no operation mixes the two, which is what fails first on a GPU.

No machine of ours has one. The device here is torch's `meta`, which computes shapes only: whatever is fetched from it
reads as zeros, so that what is learnt says nothing, but every operation of a training has been there.
"""

import re
from collections.abc import Iterator
from typing import Any

import pytest
import torch
from made_samples import SHORT, circuit, dosing, rc
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from faultline.analysis.model import load_model
from faultline.service.core.errors import InputError
from faultline.training.device import CPU, device_of
from faultline.training.layout import layout_of
from faultline.training.loop import Training
from faultline.training.recipe import DEFAULT, THESIS

META = torch.device("meta")

MAY_MIX = ("_to_copy", "copy_")


class OneDevice(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Refuses operations on tensors of both devices; a number fetched from `META` is zero."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        given = [leaf for leaf in tree_leaves((args, kwargs)) if isinstance(leaf, torch.Tensor)]
        name = func.overloadpacket.__name__
        if name == "_local_scalar_dense" and given[0].is_meta:
            return 0.0
        if name == "_to_copy" and given[0].is_meta and kwargs.get("device") == CPU:
            return torch.zeros(given[0].shape, dtype=kwargs.get("dtype") or given[0].dtype)
        where = {tensor.device.type for tensor in given if tensor.dim()}  # a number may lie on the CPU
        if len(where) > 1 and name not in MAY_MIX:
            raise AssertionError(f"{name} takes tensors of {sorted(where)}")
        return func(*args, **(kwargs or {}))


@pytest.fixture
def one_device() -> Iterator[None]:
    with OneDevice():  # type: ignore[no-untyped-call]
        yield


def test_the_check_sees_a_product_of_two_devices(one_device: None) -> None:
    """Which torch itself lets pass on this device."""
    with pytest.raises(AssertionError, match=re.escape("mm takes tensors of ['cpu', 'meta']")):
        torch.ones(2, 3, device=META) @ torch.ones(3, 2)


@pytest.mark.parametrize("recipe", [DEFAULT, THESIS], ids=lambda recipe: recipe.name)
def test_a_training_stays_on_its_device(one_device: None, recipe: Any) -> None:
    samples, looks = dosing(1, 250), []
    begun = Training(layout_of(load_model("uds"), ["t02"]), samples, recipe, 0, device=META)
    for phase in recipe.phases:  # the first iteration of each
        assert begun.step().device == META
        begun.done += phase.iterations
    begun.done = begun.iterations - 1
    begun.run(lambda report: looks.append(report.done), lambda: None)
    assert looks == [begun.iterations]
    assert {value.device for value in begun.best.values()} == {META}
    assert {parameter.device for parameter in begun.finish().parameters()} == {CPU}


@pytest.mark.filterwarnings("ignore:.*copying from a non-meta parameter")  # the check's device takes no values
def test_a_training_goes_on_on_another_device(one_device: None) -> None:
    samples = circuit(1, 800)
    begun = Training(rc(), samples, SHORT, 0)
    begun.step()
    other = Training(rc(), samples, SHORT, 0, device=META)
    other.restore(begun.state())
    assert other.step().device == META


def test_the_device_is_the_cpu_where_there_is_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert device_of(None) == device_of("cpu") == CPU
    with pytest.raises(InputError, match=r"--device cuda: this build of torch finds no CUDA device; leave it out"):
        device_of("cuda")
