"""Whitelist of an ONNX file's content, checked before any runtime sees it, and without the onnx package.

The file is a Protocol Buffers message (onnx.proto, IR version 10), walked by field numbers. Only what the exporter
writes is allowed: plain nodes of operators from a list, tensors whose bytes are in the file, no functions, no graphs in
nodes, no other domain. So no file is read that the graph names, nothing loops, and no constant is larger than the file.
What a node makes of its inputs is not bounded by that: a bundle is tried where memory and time are limited.
"""

from collections.abc import Iterator
from math import prod

from faultline.service.core.errors import InputError

OPERATORS = frozenset(
    {"Abs", "Add", "Cast", "Concat", "Div", "Exp", "Expand", "Gather", "Identity", "Log", "MatMul", "Max", "Mul"}
    | {"Reciprocal", "ReduceMean", "ReduceMin", "ReduceSum", "Relu", "Reshape", "Shape", "Slice", "Sqrt", "Sub"}
    | {"Tanh", "Transpose"}
)
OPSETS = (21,)
IR_VERSIONS = (10,)
MOST_NODES, MOST_TENSORS = 10_000, 10_000

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_ITEM_BYTES = {1: 4, 2: 1, 3: 1, 5: 2, 6: 4, 7: 8, 9: 1, 10: 2, 11: 8}  # TensorProto.DataType
_PLAIN_ATTRIBUTES = {1, 2, 3, 4, 7, 8, 9, 13, 20, 21}  # name, f, i, s, floats, ints, strings, doc, type, ref

Value = int | bytes


class GraphError(InputError):
    """A graph that must not be run."""


def check_graph_file(raw: bytes, where: str) -> None:
    """Check that the file holds nothing but what is allowed.

    Raises:
        GraphError: it does not; the message says what.
    """
    try:
        _model(raw)
    except _NotAllowedError as error:
        raise GraphError(f"{where}: {error}; only graphs that `faultline export` wrote are run") from error


class _NotAllowedError(Exception):
    """Content that is not allowed, without the place."""


def _model(raw: bytes) -> None:
    graphs = 0
    for field, value in _fields(raw, {1, 2, 3, 4, 5, 6, 7, 8, 14}, "a model"):
        if field == 1 and value not in IR_VERSIONS:
            raise _NotAllowedError(f"IR version {_short(value)}, not {IR_VERSIONS[0]}")
        if field == 8:
            _opset(_bytes(value))
        if field == 7:
            graphs += 1
            _graph(_bytes(value))
    if graphs != 1:
        raise _NotAllowedError(f"{graphs} graphs in it, not one")


def _opset(raw: bytes) -> None:
    found = dict(_fields(raw, {1, 2}, "an operator set"))
    if found.get(1, b"") != b"" or found.get(2) not in OPSETS:
        raise _NotAllowedError(
            f"operators of set {_short(found.get(1, b''))} {_short(found.get(2))}, not of {OPSETS[0]}"
        )


def _graph(raw: bytes) -> None:
    nodes = tensors = 0
    for field, value in _fields(raw, {1, 2, 5, 10, 11, 12, 13}, "a graph"):
        if field == 1:
            nodes += 1
            _node(_bytes(value))
        elif field == 5:
            tensors += 1
            _tensor(_bytes(value))
    if nodes > MOST_NODES or tensors > MOST_TENSORS:
        raise _NotAllowedError(f"{nodes} nodes and {tensors} tensors, more than {MOST_NODES} and {MOST_TENSORS}")


def _node(raw: bytes) -> None:
    operator = b""
    for field, value in _fields(raw, {1, 2, 3, 4, 5, 6, 7}, "a node"):
        if field == 4:
            operator = _bytes(value)
        elif field == 5:
            _attribute(_bytes(value))
        elif field == 7 and value != b"":
            raise _NotAllowedError(f"a node of domain {_short(value)}")
    if operator.decode(errors="replace") not in OPERATORS:
        raise _NotAllowedError(f"operator {_short(operator)}")


def _attribute(raw: bytes) -> None:
    for _ in _fields(raw, _PLAIN_ATTRIBUTES, "an attribute of a node"):
        pass


def _tensor(raw: bytes) -> None:
    dims: list[int] = []
    kind, content = 0, b""
    for field, value in _fields(raw, {1, 2, 8, 9, 12, 14}, "a tensor"):
        if field == 1:
            dims += [value] if isinstance(value, int) else _varints(value)
        elif field == 2:
            kind = value if isinstance(value, int) else 0
        elif field == 9:
            content = _bytes(value)
        elif field == 14 and value != 0:
            raise _NotAllowedError("a tensor whose data are in another file")
    if kind not in _ITEM_BYTES or prod(dims) * _ITEM_BYTES[kind] != len(content):
        raise _NotAllowedError(f"a tensor of type {kind} and shape {_short(dims)} with {len(content)} bytes")


def _fields(raw: bytes, allowed: set[int], what: str) -> Iterator[tuple[int, Value]]:
    """Number and value of every field."""
    at, end = 0, len(raw)
    while at < end:
        key, at = _varint(raw, at)
        field, kind = key >> 3, key & 7
        if field not in allowed:
            raise _NotAllowedError(f"field {field} of {what}")
        value: Value
        if kind == _VARINT:
            value, at = _varint(raw, at)
        elif kind in (_FIXED64, _FIXED32):
            size = 8 if kind == _FIXED64 else 4
            value, at = raw[at : at + size], at + size
        elif kind == _BYTES:
            size, at = _varint(raw, at)
            value, at = raw[at : at + size], at + size
        else:
            raise _NotAllowedError(f"not a Protocol Buffers message: wire type {kind}")
        if at > end:
            raise _NotAllowedError("ends in the middle of a field")
        yield field, value


def _varint(raw: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 64, 7):
        if at >= len(raw):
            raise _NotAllowedError("ends in the middle of a number")
        byte = raw[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise _NotAllowedError("a number of more than 64 bits")


def _varints(raw: bytes) -> list[int]:
    found, at = [], 0
    while at < len(raw):
        value, at = _varint(raw, at)
        found.append(value)
    return found


def _bytes(value: Value) -> bytes:
    if not isinstance(value, bytes):
        raise _NotAllowedError("a number where there should be a message")
    return value


def _short(value: object) -> str:
    return repr(value)[:60]
