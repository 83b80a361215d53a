"""Functions of a bundle's graphs, compiled once and kept: the next process that needs them only loads them.

They are kept in `faultline/compiled` of the user's cache (XDG_CACHE_HOME), by the digest of their text. The folder may
be deleted.
"""

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numba

from faultline.analysis.compiled.elements import NotCompiledError, program_of
from faultline.analysis.compiled.source import HEAD, NO_HYPOTHESES, hypotheses_text, numbers_of, table_of, tests_text
from faultline.service.core.signals.values import FloatArray
from faultline.writing import write_file

MOST_SCALARS = 20_000
"""Of a graph: more take minutes to compile, as those of networks would."""
WORTH_IT = 20_000
"""Ticks from which compiling is worth it: without, so many take as long as compiling does, 15 to 25 s."""

CODE = ("driver.py", "decision.py")
"""Beside this file: what is compiled with any graph. Where it changes, graphs are compiled again with it."""

Function = Callable[..., None]


class ToCompileError(NotCompiledError):
    """Raised for a graph that can be compiled, never was, and is not to be compiled by this process."""


class Kernels(NamedTuple):
    """The functions of both graphs, their constants, and what differs between the hypotheses (columns, H)."""

    tests: Function
    hypotheses: Function
    of_tests: FloatArray
    of_hypotheses: FloatArray
    table: FloatArray


def kernels_of(
    tests: bytes, hypotheses: bytes | None, rows: int, *, ticks: int = WORTH_IT, more: int = 0, compiling: bool = True
) -> Kernels:
    """Return the functions of the tests' graph, and of that of the hypotheses, which has so many rows.

    They are needed for so many `ticks` now, and for `more` later. They are compiled if that is worth it, counting those
    for which they were not before, by other processes too: at most twice the time is spent that would have been best.

    Raises:
        NotCompiledError: a graph cannot be compiled; or it never was, and is not worth it yet.
        ToCompileError: it is worth it, and nothing is to be compiled by this process.
        OSError: the user's cache cannot be written.
    """
    programs = [program_of(tests, 1), *([] if hypotheses is None else [program_of(hypotheses, rows)])]
    if (scalars := max(len(program.nodes) for program in programs)) > MOST_SCALARS:
        raise NotCompiledError(f"a graph of {scalars} scalars would take minutes to compile")
    of_tests, *others = programs
    other = others[0] if others else None
    texts = HEAD + tests_text(of_tests), HEAD + (hypotheses_text(other, rows) if other else NO_HYPOTHESES)
    worth_it = [_is_worth_it(text, ticks, more) for text in texts[: len(programs)]]
    if not all(worth_it):
        raise NotCompiledError("this was never compiled, and is needed for few ticks")
    if not (compiling or all(_place(text).exists() for text in texts)):
        raise ToCompileError("this was never compiled")
    modules = [_module(text) for text in texts]
    numbers = numbers_of(of_tests), numbers_of(other)
    return Kernels(modules[0].tests, modules[1].hypotheses, *numbers, table_of(other, rows))


def _is_worth_it(text: str, ticks: int, more: int) -> bool:
    """Return True if this was compiled, or is worth it now; if not, the ticks are counted."""
    if (path := _place(text)).exists():
        return True
    count = path.with_suffix(".ticks")
    said = count.read_text() if count.exists() else ""
    before = int(said) if said.isdigit() else 0
    if before + ticks + more >= WORTH_IT:
        return True
    if ticks:
        write_file(count, str(before + ticks))
    return False


def _place(text: str) -> Path:
    """The file of this text."""
    name = "faultline_graphs_" + hashlib.sha256(text.encode() + _code()).hexdigest()[:16]
    return folder_of_cache() / f"{name}.py"


def folder_of_cache() -> Path:
    """Return the folder in which compiled functions are kept; it may not be there yet."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "faultline" / "compiled"


@cache
def _code() -> bytes:
    """Return the compiler's version and the source that is compiled with any graph."""
    here = Path(__file__).parent
    return b"".join([numba.__version__.encode(), *((here / name).read_bytes() for name in CODE)])


def _module(text: str) -> ModuleType:
    """The module of this text, with its compiled functions beside it."""
    path = _place(text)
    known = sys.modules.get(path.stem)
    if known is not None and known.__file__ == str(path):
        return known
    if not path.exists():
        write_file(path, text)
    spec = spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[path.stem] = module_from_spec(spec)  # Numba finds what it has kept by the module's name
    spec.loader.exec_module(module)
    return module
