"""Bundles whose graphs pass every look and do not run, or take all there is; made with the onnx package."""

import shutil
import sys
from pathlib import Path

import onnx
import pytest
from onnx import TensorProto, helper

from faultline.service.bundle.trial import trial
from faultline.service.core.errors import InputError

sys.path.append(str(Path(__file__).parents[2] / "service" / "bundle"))
from made_bundle import GOLDEN, put, refused


def test_a_graph_that_does_not_run_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    bundle = Path(shutil.copytree(GOLDEN, tmp_path / "bundle"))
    graph = onnx.load_model_from_string((bundle / "ode.onnx").read_bytes())
    graph.graph.node[0].input[0] = "nothing"
    put(bundle, "ode.onnx", graph.SerializeToString())
    refused(bundle, r"ode\.onnx: no graph that onnxruntime .* runs: .*; export the bundle again")
    assert capfd.readouterr() == ("", "")


def hungry(folder: Path) -> Path:
    """A graph that passes every look and asks for 512 GiB when it is run."""
    bundle = Path(shutil.copytree(GOLDEN, folder / "bundle"))
    graph = onnx.load_model_from_string((bundle / "ode.onnx").read_bytes())
    shape = helper.make_tensor("huge", TensorProto.INT64, [1], (2**36).to_bytes(8, "little"), raw=True)
    one = helper.make_tensor("one", TensorProto.DOUBLE, [1], bytes(8), raw=True)
    axes = helper.make_tensor("axes", TensorProto.INT64, [1], bytes(8), raw=True)
    graph.graph.initializer.extend([shape, one, axes])
    first = graph.graph.node[0].input[0]
    graph.graph.node.insert(0, helper.make_node("Expand", ["one", "huge"], ["wide"]))
    graph.graph.node.insert(1, helper.make_node("ReduceSum", ["wide", "axes"], ["nothing"], keepdims=0))
    graph.graph.node.insert(2, helper.make_node("Add", [first, "nothing"], ["fed"]))
    graph.graph.node[3].input[0] = "fed"
    put(bundle, "ode.onnx", graph.SerializeToString())
    return bundle


def test_a_graph_that_takes_all_memory_ends_its_trial_and_nothing_else(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="failed its trial"):
        trial(hungry(tmp_path))
