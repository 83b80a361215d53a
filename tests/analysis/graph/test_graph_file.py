"""Graphs that must not be run are refused by a walk through the file, whatever is in it; made with the onnx package."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from faultline.service.core.residuals.graph_file import MOST_NODES, OPERATORS, GraphError, check_graph_file

GOLDEN = Path(__file__).parents[2] / "golden" / "bundle"


def model(*nodes: onnx.NodeProto, tensors: tuple[onnx.TensorProto, ...] = (), **options: Any) -> onnx.ModelProto:
    """A model of these nodes, as the exporter's but for what is in `options`."""
    x, y = (helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["B", 1]) for name in "xy")
    graph = helper.make_graph([*nodes], "g", [x], [y], list(tensors))
    options = {"opset_imports": [helper.make_opsetid("", 21)], "ir_version": 10, **options}
    return helper.make_model(graph, **options)


def refused(made: onnx.ModelProto | bytes, message: str) -> None:
    with pytest.raises(GraphError, match=message) as caught:
        check_graph_file(made if isinstance(made, bytes) else made.SerializeToString(), "g.onnx")
    assert str(caught.value).startswith("g.onnx: ")
    assert "\n" not in str(caught.value)


IDENTITY = helper.make_node("Identity", ["x"], ["y"])
BODY = helper.make_graph([IDENTITY], "b", [], [])


@pytest.mark.parametrize("name", ["ode.onnx", "faults.onnx"])
def test_what_the_exporter_writes_is_allowed(name: str) -> None:
    check_graph_file((GOLDEN / name).read_bytes(), name)
    check_graph_file(model(IDENTITY).SerializeToString(), "g.onnx")


@pytest.mark.parametrize(
    "operator", ["Loop", "Scan", "If", "ConstantOfShape", "Tile", "Range", "Constant", "Resize", ""]
)
def test_other_operators_are_refused(operator: str) -> None:
    refused(model(helper.make_node(operator, ["x"], ["y"])), f"operator b'{operator}'")


def test_every_allowed_operator_is_standard() -> None:
    standard = {schema.name for schema in onnx.defs.get_all_schemas() if schema.domain == ""}
    assert standard >= OPERATORS


def external() -> onnx.TensorProto:
    tensor = TensorProto(name="c", data_type=TensorProto.DOUBLE, dims=[1], data_location=TensorProto.EXTERNAL)
    tensor.external_data.add(key="location", value="../../etc/passwd")
    return tensor


def with_function(made: onnx.ModelProto) -> onnx.ModelProto:
    made.functions.add(name="Relu", domain="")
    return made


def two_graphs() -> bytes:
    raw: bytes = model(IDENTITY).SerializeToString()
    return raw + raw


def huge() -> onnx.TensorProto:
    return TensorProto(name="c", data_type=TensorProto.DOUBLE, dims=[2**33], raw_data=b"")


def tensor(**fields: Any) -> onnx.TensorProto:
    return TensorProto(name="c", data_type=TensorProto.DOUBLE, dims=[1], **fields)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: model(helper.make_node("Relu", ["x"], ["y"], domain="com.microsoft")), "domain b'com.microsoft'"),
        (lambda: model(helper.make_node("Identity", ["x"], ["y"], body=BODY)), "field 6 of an attribute"),
        (lambda: model(helper.make_node("Identity", ["x"], ["y"], value=huge())), "field 5 of an attribute"),
        (lambda: model(IDENTITY, tensors=(external(),)), "field 13 of a tensor|in another file"),
        (lambda: model(IDENTITY, tensors=(tensor(data_location=1),)), "in another file"),
        (lambda: model(IDENTITY, tensors=(huge(),)), r"shape \[8589934592\] with 0 bytes"),
        (lambda: model(IDENTITY, tensors=(tensor(double_data=[1.0]),)), "field 10 of a tensor"),
        (lambda: model(IDENTITY, tensors=(tensor(raw_data=bytes(7)),)), "with 7 bytes"),
        (
            lambda: model(IDENTITY, opset_imports=[helper.make_opsetid("ai.onnx.ml", 3)]),
            "operators of set b'ai.onnx.ml'",
        ),
        (lambda: model(IDENTITY, opset_imports=[helper.make_opsetid("", 7)]), "not of 21"),
        (lambda: model(IDENTITY, ir_version=3), "IR version 3"),
        (lambda: with_function(model(IDENTITY)), "field 25 of a model"),
        (two_graphs, "2 graphs in it"),
        (lambda: b"", "0 graphs in it"),
        (lambda: model(*[IDENTITY] * (MOST_NODES + 1)), "10001 nodes"),
        (lambda: b"\x0b", "wire type 3"),
        (lambda: b"\x3a\x7f", "in the middle of a field"),
        (lambda: b"\xff" * 20, "more than 64 bits"),
    ],
)
def test_what_might_do_harm_is_refused(made: Callable[[], onnx.ModelProto | bytes], message: str) -> None:
    refused(made(), message)


def test_bytes_of_a_string_tensor_are_none() -> None:
    strings = TensorProto(name="c", data_type=TensorProto.STRING, dims=[1], raw_data=b"a")
    refused(model(IDENTITY, tensors=(strings,)), "a tensor of type 8")
    check_graph_file(
        model(IDENTITY, tensors=(numpy_helper.from_array(np.zeros((2, 3)), "c"),)).SerializeToString(), "g.onnx"
    )


@given(st.data())
def test_damage_is_refused_or_harmless_and_never_an_exception_of_another_kind(data: st.DataObject) -> None:
    raw = bytearray(model(IDENTITY, tensors=(tensor(raw_data=bytes(8)),)).SerializeToString())
    for _ in range(data.draw(st.integers(1, 5))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    try:
        check_graph_file(bytes(raw[: data.draw(st.integers(0, len(raw)))]), "g.onnx")
    except GraphError:
        return
    assert b"Identity" in raw or any(name.encode() in raw for name in OPERATORS)
