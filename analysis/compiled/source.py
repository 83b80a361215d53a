"""Text of a program's functions, which Numba compiles: one for the tests, one whose inner loop is the hypotheses.

The functions fill their outputs. Those of the tests are vectors; those of the hypotheses are (columns, H), so that the
compiler takes several hypotheses at once. It does so only where it can show cheaply that no output overlaps an input:
in the loop these are vectors with H written as a number, and what all hypotheses have in common is read before it.

    tests(z, x, p, r, y_hat, sigma, x_next)
    hypotheses(z, x, p, table, r, x_next)

Constants that are no small whole numbers are in `p`, and in `table` (columns, H) where each hypothesis has its own. So
the text is that of a model's structure: vehicles that differ in their parameters share it, and what was compiled of it.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence

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
Place = Callable[[str, int], str]
"""Function from an array's name and a column to the text of that element."""


def tests_text(program: Program) -> str:
    """The function of the residual generators."""
    outputs = ("r", "y_hat", "sigma", "x_next")
    place = "{}[{}]".format
    body = [*(text for _, text in _lines(program, place)), *_stores(program, outputs, place)]
    return _function("tests", ["z", "x", "p", *outputs], OF_TESTS, body)


def hypotheses_text(program: Program, rows: int) -> str:
    """The function of the generators under each of so many assumed faults."""
    inputs, outputs = ("x", "table"), ("r", "x_next")

    def place(name: str, column: int) -> str:
        return f"all_{name}[{column * rows} + h]"

    lines = list(_lines(program, place, _repeated_divisors(program)))
    body = [f"all_{name} = {name}.reshape(-1)" for name in (*inputs, *outputs)]
    body += [text for node, text in lines if _is_common(node)]
    inner = [*(text for node, text in lines if not _is_common(node)), *_stores(program, outputs, place)]
    body += [f"for h in range({rows}):", *("    " + each for each in inner)]
    return _function("hypotheses", ["z", "x", "p", "table", *outputs], OF_HYPOTHESES, body)


def numbers_of(program: Program | None) -> FloatArray:
    """The constants that are the same in all rows, `p`."""
    return np.array([node.value for node in program.nodes if _is_number(node)] if program is not None else [])


def table_of(program: Program | None, rows: int) -> FloatArray:
    """The constants that differ between the rows (columns, H); one column of nothing where none does."""
    columns = [] if program is None else [node.value for node in program.nodes if node.operator == "row"]
    return np.array(columns) if columns else np.zeros((1, rows))


def _function(name: str, arguments: Sequence[str], types: str, body: Iterable[str]) -> str:
    decorator = DECORATOR.replace("SIGNATURE", f'"void({types})"')
    return decorator + f"def {name}({', '.join(arguments)}):\n" + "".join(f"    {line}\n" for line in body)


NO_HYPOTHESES = _function("hypotheses", ["z", "x", "p", "table", "r", "x_next"], OF_HYPOTHESES, ["pass"])


def _is_number(node: Node) -> bool:
    return node.operator == "constant" and not (node.value == round(node.value) and abs(node.value) <= LITERAL)


def _is_common(node: Node) -> bool:
    """Return True for a constant or a sample: it is the same in all hypotheses."""
    return node.operator == "constant" or (node.operator == "input" and node.value[0] == "z")


def _repeated_divisors(program: Program) -> frozenset[int]:
    """Return the scalars that several are divided by."""
    count = Counter(node.operands[1] for node in program.nodes if node.operator == "div")
    return frozenset(divisor for divisor, times in count.items() if times > 1)


def _lines(program: Program, place: Place, inverted: frozenset[int] = frozenset()) -> Iterator[tuple[Node, str]]:
    """Each scalar with its assignment. In place of dividing by one that is `inverted`, its reciprocal is a factor."""
    columns = numbers = 0
    known: set[int] = set()
    for index, node in enumerate(program.nodes):
        if node.operator == "div" and (divisor := node.operands[1]) in inverted:
            if divisor not in known:
                yield node, f"u{divisor} = 1.0 / t{divisor}"
                known.add(divisor)
            yield node, f"t{index} = t{node.operands[0]} * u{divisor}"
            continue
        if node.operator == "row":
            yield node, f"t{index} = {place('table', columns)}"
            columns += 1
        elif _is_number(node):
            yield node, f"t{index} = p[{numbers}]"
            numbers += 1
        else:
            yield node, f"t{index} = {_text(node, place)}"


def _text(node: Node, place: Place) -> str:
    match node.operator:
        case "constant":
            return repr(node.value)
        case "input" if node.value[0] == "z":
            return f"z[{node.value[1]}]"
        case "input":
            return place(*node.value)
    return _TEXT[node.operator].format(*(f"t{each}" for each in node.operands))


def _stores(program: Program, outputs: Sequence[str], place: Place) -> Iterator[str]:
    for name in outputs:
        for column, index in enumerate(program.outputs[name]):
            yield f"{place(name, column)} = t{index}"
