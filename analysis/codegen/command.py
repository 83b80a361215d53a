"""Write residual generators of a model as code to read: Python and C99."""

import argparse
import re
from pathlib import Path

from faultline.analysis.codegen.build import residual_program
from faultline.analysis.codegen.c99 import c99_sources
from faultline.analysis.codegen.python import python_source
from faultline.analysis.codegen.sequence import ComputationSequence, Form, computation_sequence
from faultline.analysis.model import Model
from faultline.analysis.structure import Test, find_tests, over_determined, redundancy, sound_model, structure_of
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.writing import check_folder, write_files

EXAMPLE = """examples:
  faultline code uds --out code                                     (every test that can be run)
  faultline code uds --test t01 --residual e16 --filter 2 --out code   (one residual of any causality)

Files, classes and functions begin with the names of model, test and residual: uds_t01_e16.
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser(
        "faultline code", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", help="a model file, or the name of a shipped model")
    parser.add_argument("--out", type=Path, required=True, help="the folder to write into")
    parser.add_argument("--test", help="only this test, such as t02")
    parser.add_argument("--residual", help="with --test: this equation of it is the residual, whatever its causality")
    parser.add_argument(
        "--form",
        choices=["integral", "derivative"],
        help="with --residual: how a differential constraint is used that is itself the residual (default: integral)",
    )
    parser.add_argument("--period", type=float, metavar="S", help="sampling period (default: the model's)")
    parser.add_argument(
        "--filter", type=float, default=0.0, metavar="S", help="time constant for derivatives of signals"
    )
    options = parser.parse_args(argv)
    if not 0 < (options.period or 1.0) < float("inf") or not 0 <= options.filter < float("inf"):
        parser.error("--period must be a number above zero, --filter zero or more")
    if options.residual and not options.test:
        parser.error("--residual needs --test")
    if options.form and not options.residual:
        parser.error("--form needs --residual")
    if options.model.endswith(".json"):
        raise InputError(
            f"{options.model}: a structural model has no formulas, and code is made of them; "
            "write its equations as formulas in a TOML model file"
        )
    check_folder(options.out)
    model = sound_model(options.model)
    chosen = _chosen(model, options.test, options.residual, options.form)
    written = {}
    for name, sequence in chosen.items():
        program = residual_program(model, sequence, name=name, period=options.period, filter_s=options.filter)
        written[name] = {f"{name}.py": python_source(program), **c99_sources(program)}
    write_files({options.out / file: text for files in written.values() for file, text in files.items()})
    for name, files in written.items():
        print(f"wrote {', '.join(files)}: residual {chosen[name].residual}, {chosen[name].causality} causality")
    return 0


def _chosen(model: Model, test: str | None, residual: str | None, form: Form | None) -> dict[str, ComputationSequence]:
    """The computation sequences to write, by the names of their files."""
    found = {support.name: support for support in find_tests(model)}
    if not found:
        raise InputError(f"{model.name}: there is no test, because {_lacking(model)}; `faultline structure` says more")
    runnable = {name: support for name, support in found.items() if isinstance(support, Test)}
    if test is None:
        if not runnable:
            raise InputError(f"{model.name}: no test can be run; choose one with --test and --residual")
        return {
            _name(model, name): computation_sequence(model, s.equations, s.residual) for name, s in runnable.items()
        }
    if test not in found:
        raise InputError(f"{model.name}: no test {test}; those are {', '.join(found)}")
    if residual is None and test not in runnable:
        raise InputError(f"{model.name}: {test} cannot be run: {found[test].obstacle}; name another with --residual")
    equation = residual or runnable[test].residual
    constraints = [d.name for d in model.differentials if d.name in found[test].equations]
    if form and equation in found[test].equations and equation not in constraints:
        raise InputError(
            f"{model.name}: {equation} is no differential constraint, and only those have a form; "
            f"leave --form away, or take one of {test}: {', '.join(constraints) or 'it has none'}"
        )
    sequence = computation_sequence(model, found[test].equations, equation, form=form or "integral")
    parts = [test, *([equation] if residual else []), *([form] if form == "derivative" else [])]
    return {_name(model, *parts): sequence}


def _lacking(model: Model) -> str:
    structure = structure_of(model)
    if not redundancy(structure, over_determined(structure)):
        return "nothing is redundant: no unknown can be computed in two ways"
    return "no fault is in a redundant equation" if model.faults else "the model has no fault"


def _name(model: Model, *parts: str) -> str:
    """An identifier: that of one model is no other's, so that their code may be linked together."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", "_".join([model.name, *parts]))
    return name if name[:1].isalpha() else f"model_{name}"
