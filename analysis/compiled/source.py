"""Text of a program's functions, which Numba compiles: one for the tests, one whose inner loop is the hypotheses.

tests(z, x, r, y_hat, sigma, x_next)         vectors; the outputs are filled
hypotheses(z, x, table, r, x_next)           x, r, x_next: (columns, H), so that the compiler takes several h at once
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from faultline.analysis.compiled.elements import Node, Program
from faultline.service.core.signals.values import FloatArray

HEAD = '''"""Written by faultline from the graphs of a bundle; it may be deleted."""

from math import exp, log, sqrt, tanh

from numba import njit
'''
DECORATOR = '\n\n@njit(SIGNATURE, cache=True, error_model="numpy", boundscheck=False)\n'
VECTOR, MATRIX = "float64[::1]", "float64[:, ::1]"
OF_TESTS, OF_HYPOTHESES = ", ".join([VECTOR] * 6), ", ".join([VECTOR, *[MATRIX] * 4])
"""Types of the arguments of both functions."""
_BINARY = {"add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "div": "{} / {}", "max": "{1} if {1} > {0} else {0}"}
_UNARY = {"neg": "-{}", "abs": "abs({})", "sqrt": "sqrt({})", "exp": "exp({})", "log": "log({})", "tanh": "tanh({})"}
_TEXT = {**_BINARY, **_UNARY}


def tests_text(program: Program) -> str:
    """The function of the residual generators."""
    outputs = ("r", "y_hat", "sigma", "x_next")
    body = [*_lines(program, "{}[{}]"), *_stores(program, outputs, "{}[{}]")]
    return _function("tests", ["z", "x", *outputs], OF_TESTS, body, "    ")


def hypotheses_text(program: Program) -> str:
    """The function of the generators under each assumed fault."""
    outputs = ("r", "x_next")
    body = [*_lines(program, "{}[{}, h]"), *_stores(program, outputs, "{}[{}, h]")]
    text = _function("hypotheses", ["z", "x", "table", *outputs], OF_HYPOTHESES, body, "        ")
    return text.replace("\n        ", "\n    for h in range(x.shape[1]):\n        ", 1)


def table_of(program: Program | None, rows: int) -> FloatArray:
    """The constants that differ between the rows (columns, H); one column of nothing where none does."""
    columns = [] if program is None else [node.value for node in program.nodes if node.operator == "row"]
    return np.array(columns) if columns else np.zeros((1, rows))


def _function(name: str, arguments: Sequence[str], types: str, body: Iterable[str], indent: str) -> str:
    decorator = DECORATOR.replace("SIGNATURE", f'"void({types})"')
    return decorator + f"def {name}({', '.join(arguments)}):\n" + "\n".join(indent + line for line in body) + "\n"


NO_HYPOTHESES = _function("hypotheses", ["z", "x", "table", "r", "x_next"], OF_HYPOTHESES, ["pass"], "    ")


def _lines(program: Program, place: str) -> Iterator[str]:
    """An assignment for each scalar; `place` is how an element of an array is written."""
    columns = 0
    for index, node in enumerate(program.nodes):
        if node.operator == "row":
            yield f"t{index} = table[{columns}, h]"
            columns += 1
        else:
            yield f"t{index} = {_text(node, place)}"


def _text(node: Node, place: str) -> str:
    match node.operator:
        case "constant":
            return repr(node.value)
        case "input" if node.value[0] == "z":
            return f"z[{node.value[1]}]"
        case "input":
            return place.format(*node.value)
    return _TEXT[node.operator].format(*(f"t{each}" for each in node.operands))


def _stores(program: Program, outputs: Sequence[str], place: str) -> Iterator[str]:
    for name in outputs:
        for column, index in enumerate(program.outputs[name]):
            yield f"{place.format(name, column)} = t{index}"
