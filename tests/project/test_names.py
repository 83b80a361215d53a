"""The engine names nothing of a system: no name in a shipped model is in a file of analysis, training or service."""

import ast
import subprocess
from collections.abc import Iterator
from pathlib import Path

from faultline.analysis.model.file import load_model, shipped_models
from faultline.analysis.model.model import EDGE, ONE_MODE

ROOT = Path(__file__).resolve().parents[2]
ENGINE = ("analysis", "training", "service")
SHORTEST = 3
"""Shorter names stand for something else everywhere: h, A_p."""

EXCEPTIONS = {
    "idle": "English: a bus, an address, a connection without work",
    "maximum": "English: of an array, of a signal's range",
    "partial": "English: a span of a log, `functools.partial`",
}


def names_of_systems() -> set[str]:
    """What stands in `systems/*/` as a name of a signal, variable, parameter, curve, equation, fault or mode."""
    found: set[str] = set()
    for shipped in shipped_models():
        model = load_model(shipped)
        found |= {*model.known, *model.unknown, *model.parameters, *model.curves, *model.equations, *model.assumable}
        found |= {each.name for each in model.differentials} | {*model.modes.names}
    return {name for name in found if len(name) >= SHORTEST} - {EDGE, *ONE_MODE.names}


def names_in(text: str) -> Iterator[tuple[int, str]]:
    """Line and text of every identifier and whole string in Python source."""
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Name(id=name) | ast.arg(arg=name) | ast.Attribute(attr=name):
                yield node.lineno, name
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield node.lineno, name
            case ast.keyword(arg=str(name)) | ast.Constant(value=str(name)) | ast.alias(asname=str(name)):
                yield node.lineno, name


def named(texts: dict[str, str]) -> list[str]:
    """Where files, by name, name something of a system."""
    forbidden = names_of_systems() - {*EXCEPTIONS}
    return [
        f"{file}:{line}: {name}" for file, text in texts.items() for line, name in names_in(text) if name in forbidden
    ]


def test_the_engine_names_nothing_of_a_system() -> None:
    tracked = subprocess.run(["git", "ls-files", *ENGINE], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [name for name in tracked.split() if name.endswith(".py") and (ROOT / name).exists()]
    assert len(files) > 300
    assert named({name: (ROOT / name).read_text() for name in files}) == []


def test_a_planted_name_is_found() -> None:
    planted = {
        "a string": 'SIGNAL = "y_p_ap"',
        "a variable": "n_p = 1.0",
        "an argument": "def f(dc_dose): ...",
        "a function": "def p_tp(): ...",
        "a keyword": "f(fA_du=1.0)",
        "an attribute": "x.rho",
        "in a formatted string": 'f"{a}y_p_du"',
        "another system's": 'X = "y_i"',
    }
    assert [place.partition(":")[0] for place in named(planted)] == [*planted]
    assert named({"in a docstring": '"""As p_tp is."""', "longer": "p_tp_V = 1"}) == []


def test_the_exceptions_are_few_and_needed() -> None:
    assert {"q12", "u_R", "p_tank", "fq_pump", "e01", *EXCEPTIONS} <= names_of_systems()
    assert len(EXCEPTIONS) <= 10
