"""Text of a program's functions, which Numba compiles: one for the tests, one whose inner loop is the hypotheses.

The functions fill their outputs. Those of the tests are vectors; those of the hypotheses are (columns, H), so that the
compiler takes several hypotheses at once:

    tests(z, x, p, r, y_hat, sigma, x_next)
    hypotheses(z, x, p, table, r, x_next)

Constants that are no small whole numbers are in `p`, and in `table` (columns, H) where each hypothesis has its own. So
the text is that of a model's structure: vehicles that differ in their parameters share it, and what was compiled of it.
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
OF_TESTS, OF_HYPOTHESES = ", ".join([VECTOR] * 7), ", ".join([VECTOR, MATRIX, VECTOR, *[MATRIX] * 3])
"""Types of the arguments of both functions."""
LITERAL = 16
"""Whole numbers up to this are written as they are."""

_BINARY = {"add": "{} + {}", "sub": "{} - {}", "mul": "{} * {}", "div": "{} / {}", "max": "{1} if {1} > {0} else {0}"}
_UNARY = {"neg": "-{}", "abs": "abs({})", "sqrt": "sqrt({})", "exp": "exp({})", "log": "log({})", "tanh": "tanh({})"}
_TEXT = {**_BINARY, **_UNARY}


def tests_text(program: Program) -> str:
    """The function of the residual generators."""
    outputs = ("r", "y_hat", "sigma", "x_next")
    body = [*_lines(program, "{}[{}]"), *_stores(program, outputs, "{}[{}]")]
    return _function("tests", ["z", "x", "p", *outputs], OF_TESTS, body, "    ")


def hypotheses_text(program: Program) -> str:
    """The function of the generators under each assumed fault."""
    outputs = ("r", "x_next")
    body = [*_lines(program, "{}[{}, h]"), *_stores(program, outputs, "{}[{}, h]")]
    text = _function("hypotheses", ["z", "x", "p", "table", *outputs], OF_HYPOTHESES, body, "        ")
    return text.replace("\n        ", "\n    for h in range(x.shape[1]):\n        ", 1)


def numbers_of(program: Program | None) -> FloatArray:
    """The constants that are the same in all rows, `p`."""
    return np.array([node.value for node in program.nodes if _is_number(node)] if program is not None else [])


def table_of(program: Program | None, rows: int) -> FloatArray:
    """The constants that differ between the rows (columns, H); one column of nothing where none does."""
    columns = [] if program is None else [node.value for node in program.nodes if node.operator == "row"]
    return np.array(columns) if columns else np.zeros((1, rows))


def _function(name: str, arguments: Sequence[str], types: str, body: Iterable[str], indent: str) -> str:
    decorator = DECORATOR.replace("SIGNATURE", f'"void({types})"')
    return decorator + f"def {name}({', '.join(arguments)}):\n" + "\n".join(indent + line for line in body) + "\n"


NO_HYPOTHESES = _function("hypotheses", ["z", "x", "p", "table", "r", "x_next"], OF_HYPOTHESES, ["pass"], "    ")


def _is_number(node: Node) -> bool:
    return node.operator == "constant" and not (node.value == round(node.value) and abs(node.value) <= LITERAL)


def _lines(program: Program, place: str) -> Iterator[str]:
    """An assignment for each scalar; `place` is how an element of an array is written."""
    columns = numbers = 0
    for index, node in enumerate(program.nodes):
        if node.operator == "row":
            yield f"t{index} = table[{columns}, h]"
            columns += 1
        elif _is_number(node):
            yield f"t{index} = p[{numbers}]"
            numbers += 1
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
